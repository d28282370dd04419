import math

import numpy as np
import pytest
import torch

from toolkit.demosaicing import demosaic
from toolkit.errors import ShapeError
from toolkit.types import LinearImage, NoiseModel, ProfileFlag

BAYER = ((0, 1), (1, 2))


def picture(height=7, width=9, **options):
    rgb = torch.arange(3.0 * height * width).reshape(1, 3, height, width)
    return LinearImage(rgb=rgb, clipped=rgb[:, :1] > 60, **options)


def behind_mosaic(image, pattern=BAYER):
    period = torch.tensor(pattern)
    rows, columns = torch.arange(image.height) % 2, torch.arange(image.width) % 2
    channel = period[rows[:, None], columns[None]]
    mosaic = image.rgb.gather(1, channel[None, None])
    return LinearImage(rgb=image.rgb, clipped=image.clipped, mosaic=mosaic, pattern=pattern)


def test_sizes():
    assert (picture().width, picture().height) == (9, 7)


def test_without_a_mosaic_every_channel_was_measured():
    assert picture().measured() is None


def test_behind_a_mosaic_one_channel_was_measured():
    image = behind_mosaic(picture())
    measured = image.measured()
    assert measured.shape == (1, 3, 7, 9)
    assert (measured.sum(1) == 1).all()
    assert torch.equal((image.rgb * measured).sum(1), image.mosaic[:, 0])


@pytest.mark.parametrize(("left", "top"), [(0, 0), (1, 0), (0, 1), (3, 2)])
def test_a_window_keeps_its_pixels_and_its_pattern(left, top):
    image = behind_mosaic(picture())
    window = image.window(left, top, 5, 4)
    assert (window.width, window.height) == (5, 4)
    area = (..., slice(top, top + 4), slice(left, left + 5))
    assert torch.equal(window.rgb, image.rgb[area])
    assert torch.equal(window.clipped, image.clipped[area])
    assert torch.equal(window.measured(), image.measured()[area])
    assert torch.equal((window.rgb * window.measured()).sum(1), window.mosaic[:, 0])


XTRANS = (
    (1, 0, 1, 1, 2, 1),
    (2, 1, 2, 0, 1, 0),
    (1, 0, 1, 1, 2, 1),
    (1, 2, 1, 1, 0, 1),
    (0, 1, 0, 2, 1, 2),
    (1, 2, 1, 1, 0, 1),
)


def raw(pattern=BAYER, height=23, width=26, count=1):
    rng = np.random.default_rng(3)
    mosaic = torch.from_numpy(rng.normal(size=(count, 1, height, width)).astype(np.float32))
    return LinearImage(mosaic=mosaic, clipped=mosaic > 2, pattern=pattern)


@pytest.mark.parametrize("pattern", [BAYER, XTRANS])
def test_the_colours_of_a_mosaic_are_filled_in_once(pattern):
    image = raw(pattern, count=2)
    expected = [demosaic(one, pattern) for one in image.mosaic[:, 0].numpy()]
    assert torch.equal(image.rgb, torch.from_numpy(np.stack(expected)))
    assert image.rgb is image.rgb
    assert torch.equal((image.rgb * image.measured()).sum(1), image.mosaic[:, 0])


@pytest.mark.parametrize("pattern", [BAYER, XTRANS])
@pytest.mark.parametrize("place", [(0, 0, 26, 23), (1, 0, 9, 7), (9, 8, 11, 10), (15, 14, 11, 9)])
def test_a_window_has_the_colours_of_the_whole(pattern, place):
    left, top, width, height = place
    window, whole = raw(pattern).window(*place), raw(pattern).rgb
    expected = whole[..., top : top + height, left : left + width]
    assert torch.allclose(window.rgb, expected, atol=1e-6)
    assert torch.equal((window.rgb * window.measured()).sum(1), window.mosaic[:, 0])


def test_a_remade_picture_follows_what_was_recorded():
    image = raw()
    brighter = image.remade(2 * image.recorded, frames=4)
    assert torch.allclose(brighter.rgb, 2 * image.rgb)
    assert torch.equal(brighter.mosaic, 2 * image.mosaic)
    assert (brighter.frames, brighter.pattern) == (4, BAYER)
    colours = picture()
    assert torch.equal(colours.remade(2 * colours.recorded).rgb, 2 * colours.rgb)
    assert colours.remade(colours.rgb).mosaic is None


def test_a_picture_needs_colours_or_a_mosaic():
    with pytest.raises(ShapeError, match="needs rgb, or a mosaic and its pattern"):
        LinearImage(clipped=torch.zeros(1, 1, 4, 4, dtype=torch.bool))


def test_the_variance_rises_with_the_level():
    noise = NoiseModel(
        read_variance=torch.tensor([[1e-4, 2e-4, 3e-4]]),
        gain=torch.tensor([[1e-3, 2e-3, 0.0]]),
        density=torch.tensor([0.25, 0.5, 0.25]),
    )
    level = torch.full((1, 3, 6, 6), 0.5)
    expected = torch.tensor([6e-4 / 0.25, 1.2e-3 / 0.5, 3e-4 / 0.25])
    assert torch.allclose(noise.variance(level)[0, :, 3, 3], expected)
    dark = noise.variance(-level)
    assert torch.allclose(dark[0, 0], torch.tensor(1e-4 / 0.25))
    measured = behind_mosaic(picture(6, 6)).measured()
    raw = noise.variance(level, measured)
    assert float(raw[0, 0, 0, 0]) == pytest.approx(6e-4)
    assert math.isinf(float(raw[0, 1, 0, 0]))


def test_flags_are_bits():
    both = ProfileFlag.END | ProfileFlag.CLIPPED
    assert int(both) == 18
    assert ProfileFlag.GOOD == 0
    values = [int(flag) for flag in ProfileFlag if flag]
    assert all(value & (value - 1) == 0 for value in values)
