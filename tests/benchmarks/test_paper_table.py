import math

import numpy as np
import pytest
import torch
from paper_table import EXPOSURE, PAPER, draw_scene, expected, flight, gaps, upright_plane

from toolkit import Measurement
from toolkit.measurement import PathSamples


@pytest.mark.parametrize("seed", range(5))
def test_the_ball_bounces_once_within_the_second_and_not_in_the_arc(seed):
    path = flight(seed)
    assert EXPOSURE["arc"] < path.bounce_time < EXPOSURE["bounce"] - 0.4
    time = torch.linspace(0, 1, 2001, dtype=torch.float64)
    position = path.position(time)
    assert (position[:, 1] <= path.contact_height + 1e-9).all()  # no second bounce is missed
    normal, distance = upright_plane(position.numpy())
    assert np.abs(position.numpy() @ normal - distance).max() < 1e-12


@pytest.mark.parametrize("scale", PAPER)
def test_streaks_are_as_wide_as_the_paper_s_and_inside_the_picture(scale):
    scene = draw_scene("bounce", scale, 0)
    ends = scene.path.position(torch.tensor([0.0, 1.0]))
    near, far = 2 * scene.camera.fx * scene.ball_radius / ends.norm(dim=-1)
    assert float(near) == pytest.approx(1.55 * scale, rel=0.08)  # 150 to 130 px at full size
    assert float(far) == pytest.approx(1.35 * scale, rel=0.08)
    time = torch.linspace(0, 1, 201, dtype=torch.float64)
    pixels = scene.camera.project(scene.path.position(time))
    size = torch.tensor([scene.camera.width, scene.camera.height])
    assert torch.minimum(pixels, size - pixels).min() > float(near)


def test_the_plane_is_upright_and_the_nearest():
    generator = np.random.default_rng(1)
    u, y = generator.uniform(-1, 1, size=(2, 200))
    off = generator.normal(scale=0.01, size=200)
    points = np.stack([0.6 * u - 0.8 * off, y, 0.8 * u + 0.6 * off + 3], axis=-1)
    normal, distance = upright_plane(points)
    assert normal[1] == 0
    assert abs(normal @ [-0.8, 0, 0.6]) == pytest.approx(1, abs=1e-4)
    assert np.abs(points @ normal - distance).mean() == pytest.approx(np.abs(off).mean(), rel=0.02)


def test_gaps_are_measured_across_the_path():
    scene = draw_scene("arc", 25, 0)
    time = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    velocity = scene.path.velocity(time).numpy()
    across = np.cross(velocity, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    aside = scene.path.position(time).numpy() + 0.002 * across
    assert gaps(aside, scene) == pytest.approx([0.1, 0.1, 0.1], rel=1e-2)


def test_what_is_expected_leaves_out_what_lies_along_the_path():
    samples = PathSamples(
        time_s=(0.0, 1.0),
        position_m=((0.0, 0.0, 1.0), (1.0, 0.0, 1.0)),
        velocity_m_s=((1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        position_std_m=((9.0, 0.0, 0.002), (9.0, 0.0, 0.002)),
    )
    found = expected(Measurement(trajectory=samples))
    assert found == pytest.approx(math.sqrt(2 / math.pi) * 0.1)
