import math

import pytest
import torch

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
