import math
from dataclasses import replace

import pytest
import torch
from sweep_scenes import draw_scene, facts, render, sweep_shot

from toolkit.synthetic import PlainBall

SMALL = 5  # the seed of a small picture


@pytest.fixture(scope="module")
def shot():
    return sweep_shot(SMALL)


def test_a_seed_draws_one_scene():
    first, again, other = draw_scene(3), draw_scene(3), draw_scene(4)
    assert first.path == again.path
    assert torch.equal(first.background, again.background)
    assert first.path != other.path


@pytest.mark.parametrize("seed", range(20, 40))
def test_scenes_are_drawn_from_the_ranges_named(seed):
    scene = draw_scene(seed)
    camera, colour = scene.camera, torch.tensor(scene.appearance.colour)
    distance = scene.path.position(torch.tensor([0.01])).norm() / scene.ball_radius
    width = 2 * camera.fx / (distance**2 - 1).sqrt()
    assert 30 <= width <= 150
    assert 15 <= distance <= 100
    assert (scene.background - colour[:, None, None]).norm(dim=0).min() >= 0.4
    assert 0.005 <= math.sqrt(scene.noise.read**2 + 0.5 * scene.noise.gain) <= 0.03
    assert camera.covariance.count_nonzero() == 0
    # all of the ball, and its surroundings, in the picture
    ends = camera.project(scene.path.position(torch.tensor([0.0, scene.exposure])))
    size = torch.tensor([camera.width, camera.height])
    assert torch.minimum(ends, size - ends).min() > 0.25 * float(width)


def test_facts_are_those_of_the_shot(shot):
    told = facts(shot)
    scene = shot.scene
    ends = scene.camera.project(
        scene.path.position(torch.tensor([0.0, scene.exposure], dtype=torch.float64))
    )
    travel = float((ends[1] - ends[0]).norm())
    # the picture stretches what is off the axis, and so the width there
    assert told["length_widths"] * told["width_px"] == pytest.approx(travel, rel=0.25)
    assert abs(told["tilt_deg"]) < 60
    assert told["speed_m_s"] == pytest.approx(float(shot.velocity.norm()))


def test_a_cached_rendering_is_the_rendering(shot, tmp_path):
    first, again = sweep_shot(SMALL, tmp_path), sweep_shot(SMALL, tmp_path)
    assert torch.equal(first.image.rgb, again.image.rgb)
    assert torch.allclose(first.image.rgb, shot.image.rgb, atol=1e-6)
    assert torch.equal(first.background.rgb, shot.background.rgb)
    assert torch.equal(first.alpha, shot.alpha)
    assert len(list(tmp_path.iterdir())) == 1


def test_the_cache_tells_scenes_apart(shot, tmp_path):
    render(shot.scene, 0, tmp_path)
    render(replace(shot.scene, appearance=PlainBall(colour=(0.1, 0.2, 0.8))), 0, tmp_path)
    render(replace(shot.scene, blur=0.4), 0, tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("seed", [5, 9, 13, 26])
def test_a_readout_leaves_the_streak_in_its_picture(seed):
    plain, scene = draw_scene(seed), draw_scene(seed, 1e-5)
    assert scene.readout > 0
    camera = scene.camera

    def places(scene):
        time = [scene.own_time(share) for share in (0.0, 0.5, 1.0)]
        return camera.project(scene.path.position(torch.tensor(time, dtype=torch.float64)))

    # the ball is at the same place when its own row is exposed
    assert torch.allclose(places(scene)[1], places(plain)[1], atol=0.02)
    size = torch.tensor([camera.width, camera.height])
    width = facts(render(scene, 0))["width_px"]
    assert torch.minimum(places(scene), size - places(scene)).min() > 0.6 * width
