import math

import numpy as np
import paper_table
import pytest
import torch
from paper_table import (
    DRAWS,
    EXPOSURE,
    PAPER,
    Row,
    draw_scene,
    expected,
    find_possible,
    flight,
    gaps,
    ratio,
    upright_plane,
    verdict,
)
from sweep_scenes import render

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


def test_gaps_know_the_very_bounce():
    scene = draw_scene("bounce", 25, 1)
    instant = torch.tensor([scene.path.bounce_time], dtype=torch.float64)
    lowest = scene.path.position(instant).numpy()
    assert gaps(lowest, scene)[0] < 1e-9
    assert gaps(np.add(lowest, [0.0, 0.002, 0.0]), scene)[0] == pytest.approx(0.1, rel=1e-6)


def test_an_error_bound_is_what_the_likeliest_paths_reach():
    clean = render(draw_scene("arc", 25, 0), 0)
    found = [find_possible(clean.with_noise(seed), [seed, 37]) for seed in range(3)]
    drawn = np.array([[gaps(path, clean.scene).mean() for path in each.drawn] for each in found])
    assert drawn.shape == (3, DRAWS)
    reached = np.array([gaps(each.likeliest, clean.scene).mean() for each in found])
    # each is a draw of its own: the mean of three has about a third of their scatter
    assert abs(reached.mean() - drawn.mean()) < 4 * drawn.std() / math.sqrt(3)
    assert len(set(reached)) == 3
    assert not np.allclose(found[0].drawn, found[1].drawn, atol=1e-5)


def test_every_picture_draws_its_own_errors(monkeypatch):
    seeds = []
    monkeypatch.setattr(paper_table, "render", lambda *_: None)
    monkeypatch.setattr(paper_table, "print_rows", lambda *_: None)
    monkeypatch.setattr(paper_table, "measure_shot", lambda shot, seed, *_: seeds.append(seed))
    paper_table.run("arc", [50, 25], 3, None, "sweep")
    assert len({tuple(seed) for seed in seeds}) == 6


def test_the_standard_error_of_a_ratio_is_the_scatter_of_such_ratios():
    generator = np.random.default_rng(4)
    bounds = generator.uniform(0.9, 1.1, size=(2000, 16))
    values = 1.3 * bounds * generator.gamma(4, 1 / 4, size=bounds.shape)
    found = np.array([ratio(v, b) for v, b in zip(values, bounds, strict=True)])
    assert found[:, 0].mean() == pytest.approx(1.3, rel=0.01)
    assert found[:, 1].mean() == pytest.approx(found[:, 0].std(), rel=0.06)
    share, error = ratio(np.array([1.0]), np.array([2.0]))
    assert share == 0.5
    assert math.isnan(error)


@pytest.mark.parametrize(
    ("off_plane", "error", "expected"),
    [
        (0.009, 0.009, "a tenth"),
        (0.009, 0.059, "the bound"),
        (0.047, 0.009, "the bound"),
        (0.049, 0.009, "missed"),
        (0.009, 0.061, "missed"),
    ],
)
def test_a_row_must_reach_a_tenth_or_the_bound_in_both(off_plane, error, expected):
    row = Row(
        off_plane=off_plane,
        off_plane_bound=0.04,
        error=error,
        error_bound=0.05,
        likeliest=0.05,
        told=0.05,
        largest=0.2,
        seconds=1.0,
    )
    assert verdict(row, 0.01) == expected
