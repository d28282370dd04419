import math

import pytest
import torch

from toolkit.errors import ConfigError
from toolkit.synthetic import ParabolicPath, StraightPath, benchmark_scene
from toolkit.synthetic.sharp import project_limb


def centres(scene, shares):
    return scene.path.position(torch.tensor(shares, dtype=torch.float64) * scene.exposure)


@pytest.mark.parametrize("tilt", [0.0, 0.7, -1.1])
@pytest.mark.parametrize("distance", [15.0, 50.0])
def test_the_ball_has_the_size_length_and_distance_asked_for(tilt, distance):
    scene = benchmark_scene(width_px=80, length_widths=4, distance_R=distance, tilt=tilt, seed=3)
    first, middle, last = centres(scene, [0, 0.5, 1])
    assert middle.norm() / scene.ball_radius == pytest.approx(distance)
    limb = project_limb(scene.camera, middle[None], scene.ball_radius)[0]
    assert (limb.amax(dim=0) - limb.amin(dim=0)).tolist() == pytest.approx([80, 80], rel=0.002)
    ends = scene.camera.project(torch.stack([first, last]))
    assert ends.diff(dim=0).norm() == pytest.approx(320, rel=0.01)
    velocity = scene.path.velocity(torch.zeros(1))[0]
    assert math.asin(velocity[2] / velocity.norm()) == pytest.approx(tilt)


def test_the_arc_has_the_height_asked_for():
    scene = benchmark_scene(width_px=60, sagitta_widths=0.5, heading=0.4, seed=1)
    assert isinstance(scene.path, ParabolicPath)
    first, middle, last = scene.camera.project(centres(scene, [0, 0.5, 1]))
    assert (middle - (first + last) / 2).norm() == pytest.approx(30, rel=0.01)
    assert isinstance(benchmark_scene().path, StraightPath)


@pytest.mark.parametrize("seed", range(5))
def test_the_ball_stands_out_everywhere_and_stays_in_the_picture(seed):
    scene = benchmark_scene(seed=seed, sagitta_widths=0.3 * (seed % 2))
    colour = torch.tensor(scene.appearance.colour)[:, None, None]
    assert (scene.background - colour).norm(dim=0).min() >= 0.4
    time = torch.linspace(0, scene.exposure, 9)
    limb = project_limb(scene.camera, scene.path.position(time), scene.ball_radius)
    assert limb.min() > 5
    assert (limb < scene.camera.width - 6).all()


def test_the_heading_is_free_or_fixed():
    velocity = benchmark_scene(heading=0.3).path.start_velocity
    assert math.atan2(velocity[1], velocity[0]) == pytest.approx(0.3)
    assert benchmark_scene(seed=1).path != benchmark_scene(seed=2).path
    assert benchmark_scene(seed=1).path == benchmark_scene(seed=1).path


def test_the_lens_may_have_a_rational_model():
    lens = (0.31, -0.12, 6e-4, -9e-4, 0.02, 0.66, -0.07, 0.03)
    assert benchmark_scene(distortion=lens).camera.model == "rational"


def test_impossible_benchmarks_are_refused():
    with pytest.raises(ConfigError, match="ask for less contrast"):
        benchmark_scene(contrast=1.5)
    with pytest.raises(ConfigError, match="farther away"):
        benchmark_scene(distance_R=0.9)
