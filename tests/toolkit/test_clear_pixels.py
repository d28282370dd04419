"""Telling the background from the ball before and after it is found."""

import cv2
import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit import LinearImage, MismatchError
from toolkit.clear_pixels import grown, roughly_lit
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
    doubled = torch.full((3,), 2.0, dtype=torch.float64)
    assert roughly_lit(shot.image, shot.background, doubled) is shot.background
    half = LinearImage(rgb=shot.background.rgb / 2, clipped=shot.background.clipped)
    assert torch.allclose(roughly_lit(shot.image, half, doubled).rgb, shot.background.rgb)


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
