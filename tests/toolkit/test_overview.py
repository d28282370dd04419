"""Both pictures reduced for looks at the whole of them."""

import re

import pytest
import torch

from toolkit import LinearImage, MismatchError
from toolkit.overview import MAX_SIDE, Overview
from toolkit.scene_match import check_same_scene
from toolkit.synthetic import textured_background

BAYER = ((0, 1), (1, 2))


def picture(rgb):
    return LinearImage(rgb=rgb, clipped=torch.zeros(1, 1, *rgb.shape[-2:], dtype=torch.bool))


def mosaic(rgb):
    height, width = rgb.shape[-2:]
    channel = torch.tensor(BAYER).repeat(height // 2, width // 2)[None, None]
    clipped = torch.zeros(1, 1, height, width, dtype=torch.bool)
    return LinearImage(mosaic=rgb.gather(1, channel), pattern=BAYER, clipped=clipped)


def test_a_small_picture_is_left_as_it_is():
    image = picture(torch.rand(1, 3, 90, MAX_SIDE))
    overview = Overview.of(image, image)
    assert overview.factor == 1
    assert overview.image is image


@pytest.mark.parametrize("factor", [2, 3, 4, 6, 8])
def test_a_large_one_is_reduced_to_the_means_of_its_blocks(factor):
    rgb, ground = torch.rand(2, 1, 3, 121, factor * MAX_SIDE - 1)
    overview = Overview.of(picture(rgb), picture(ground))
    assert overview.factor == factor
    for reduced, whole in ((overview.image, rgb), (overview.background, ground)):
        means = torch.nn.functional.avg_pool2d(whole, factor)
        assert torch.allclose(reduced.rgb, means, atol=1e-6)


def test_a_mosaic_is_reduced_by_whole_periods_of_its_pattern():
    image = mosaic(torch.rand(1, 3, 60, 3 * MAX_SIDE))
    overview = Overview.of(image, image)
    assert overview.factor == 4
    assert overview.image.pattern is None


@pytest.mark.parametrize("dress", [picture, mosaic])
def test_other_light_is_the_same_before_and_after_reducing(dress):
    image, ground = (dress(torch.rand(1, 3, 60, 2 * MAX_SIDE)) for _ in range(2))
    light = torch.tensor([0.5, 1.2, 2.0], dtype=torch.float64)
    plain = Overview.of(image, ground)
    lit = plain.lit(light)
    expected = plain.background.rgb * light[:, None, None]
    assert torch.allclose(lit.background.rgb, expected.float(), atol=1e-6)
    assert lit.background.frames == pytest.approx(1 / float((light * light).mean()))
    assert lit.image is plain.image


def test_a_shift_is_named_in_pixels_of_the_stored_picture():
    scene = textured_background(320, 240, contrast=0.15, seed=3)[None]
    large = scene.repeat_interleave(4, -1).repeat_interleave(4, -2)
    overview = Overview.of(picture(large.roll(24, -1)), picture(large))
    assert overview.factor == 3
    with pytest.raises(MismatchError, match="the camera moved") as refusal:
        check_same_scene(overview.image, overview.background, overview.factor)
    named = re.search(r"by about \((-?\d+), (-?\d+)\) px", str(refusal.value))
    assert [int(px) for px in named.groups()] == pytest.approx([24, 0], abs=3)
