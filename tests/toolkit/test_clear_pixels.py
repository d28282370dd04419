"""Telling the background from the ball before and after it is found."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit import LinearImage, MismatchError
from toolkit.clear_pixels import clear_light, grown, is_changed, is_lit_otherwise
from toolkit.synthetic import NoiseLevel, benchmark_scene, render_shot
from toolkit.view import observe_streak


def still_ball(width, noise=0.01, **scene):
    level = NoiseLevel(read=noise)
    scene = benchmark_scene(width_px=width, length_widths=0, noise=level, **scene)
    return render_shot(scene, seed=1, step=1.0)


@pytest.mark.parametrize("reach", [2.0, 10.0, 37.0])
def test_the_grown_mask_holds_all_within_reach_and_little_more(reach):
    mask = torch.zeros(1, 1, 211, 257, dtype=torch.bool)
    mask[..., 90:130, 60:200] = True
    wide = grown(mask, reach)
    assert (wide.shape, wide.dtype) == (mask.shape, torch.bool)
    outside = (~mask[0, 0]).numpy().astype(np.uint8)
    distance = torch.from_numpy(cv2.distanceTransform(outside, cv2.DIST_L2, 5))
    assert wide[0, 0][distance <= reach].all()
    assert distance[wide[0, 0]].max() < 2.5 * reach + 3


@pytest.mark.parametrize("light", [(0.8, 1.0, 1.3), (1.5, 1.5, 1.5)])
def test_another_light_is_followed_behind_a_still_ball(light):
    shot = still_ball(60, size=(220, 180))
    share = torch.tensor(light)[:, None, None]
    ground = LinearImage(rgb=shot.background.rgb / share, clipped=shot.background.clipped)
    view = observe_streak(shot.image, ground, Uniform())
    assert torch.allclose(view.drift.float(), torch.tensor(light), rtol=0.01)
    assert float(view.streak.half_width) == pytest.approx(30, rel=0.1)


def test_a_wrong_light_is_not_followed():
    shot = still_ball(150)
    doubled, certain = torch.full((3,), 2.0, dtype=torch.float64), torch.zeros(3)
    assert not is_lit_otherwise(shot.image, shot.background, doubled, certain)
    half = LinearImage(rgb=shot.background.rgb / 2, clipped=shot.background.clipped)
    assert is_lit_otherwise(shot.image, half, doubled, certain)
    assert not is_lit_otherwise(shot.image, half, doubled, torch.ones(3))


def in_other_light(shot, light):
    share = torch.tensor(light)[:, None, None]
    return replace(shot.background, rgb=shot.background.rgb / share)


@pytest.mark.parametrize("noise", [0.005, 0.03])
@pytest.mark.parametrize("light", [(0.97, 0.97, 0.97), (1.03, 0.99, 1.0)])
def test_a_small_change_of_the_light_is_seen_past_the_streak(noise, light):
    """A faint streak over a fifth of the picture, well within single pixels' noise."""
    level, size = NoiseLevel(read=noise), (500, 200)
    scene = benchmark_scene(width_px=60, length_widths=6, heading=0.0, noise=level, size=size)
    shot = render_shot(scene, seed=3, step=1.0)
    assert float((shot.alpha > 0.01).float().mean()) > 0.15
    ground = in_other_light(shot, light)
    found, std = clear_light(shot.image, ground)
    assert ((found - torch.tensor(light)).abs() < 5 * std + 3e-4).all()
    assert is_changed(found, std)
    view = observe_streak(shot.image, ground, Uniform())
    assert float(view.streak.half_width) == pytest.approx(30, rel=0.2)
    tips = shot.scene.camera.project(
        shot.scene.path.position(torch.tensor([0.0, shot.scene.exposure]))
    )
    assert torch.cdist(view.streak.axis[0, [0, -1]], tips).amin(0).max() < 45


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_no_change_of_the_light(seed):
    scene = benchmark_scene(width_px=40, length_widths=3, noise=NoiseLevel(read=0.02))
    shot = render_shot(scene, seed=seed, step=1.0)
    assert not is_changed(*clear_light(shot.image, shot.background))


def test_a_picture_that_met_white_tells_nothing_of_the_light():
    shot = still_ball(60)
    white = replace(shot.image, clipped=torch.ones_like(shot.image.clipped))
    light, std = clear_light(white, shot.background)
    assert light.tolist() == [1, 1, 1]
    assert not is_changed(light, std)


@pytest.mark.parametrize("width", [60, 200])
@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_a_ball_that_fills_the_picture_hides_neither_scene_nor_noise(width, noise):
    shot = still_ball(width, noise, seed=width)
    view = observe_streak(shot.image, shot.background, Uniform())
    assert float(view.streak.half_width) == pytest.approx(width / 2, rel=0.1)
    assert torch.allclose(view.noise.read_variance.sqrt(), torch.tensor(noise), rtol=0.3)


def test_a_large_ball_before_another_scene_is_refused():
    shot = still_ball(100, seed=1)
    other = still_ball(100, seed=2).background
    with pytest.raises(MismatchError, match="do not fit together"):
        observe_streak(shot.image, other, Uniform())
