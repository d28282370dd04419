import numpy as np
import pytest
import torch

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic.lens import (
    Window,
    blur,
    blur_pixels,
    blur_reach,
    blur_rows,
    mean_over_pixels,
    normalised_grid,
    unit_rays,
)

STRONG = (-0.28, 0.09, 1.3e-3, -4e-4, -0.011)


def make_camera(**changes):
    values = {"width": 640, "height": 480, "fx": 500.0, "fy": 505.0, "cx": 310.0, "cy": 245.0}
    return Camera(**(values | changes))


@pytest.mark.parametrize("distortion", [(), STRONG])
def test_interpolated_rays_match_the_exact_ones(distortion):
    camera = make_camera(distortion=distortion)
    window = Window(left=-5, top=3, width=61, height=37)
    grid = normalised_grid(camera, window, 3)
    x = -5 - 0.5 + (torch.arange(183).double() + 0.5) / 3
    y = 3 - 0.5 + (torch.arange(111).double() + 0.5) / 3
    pixels = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    exact = camera.undistort(pixels)
    assert (grid.movedim(0, -1) - exact).abs().max() * camera.fx < 1e-4  # px
    assert torch.allclose(unit_rays(grid).movedim(0, -1), camera.unproject(pixels), atol=2e-7)


def test_a_lens_that_folds_back_is_refused():
    camera = make_camera(distortion=(-1.5, 0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="cannot be inverted"):
        normalised_grid(camera, Window(left=0, top=0, width=640, height=480), 1)


def test_blurring_pixels_equals_blurring_their_sub_pixels():
    picture = np.random.default_rng(0).random((2, 12, 15)).astype(np.float32)
    fine = picture.repeat(3, axis=1).repeat(3, axis=2)
    expected = mean_over_pixels(blur(fine, 0.7 * 3), 3)
    assert np.allclose(blur_pixels(picture, 0.7, 3), expected, atol=1e-6)


def test_blur_keeps_light_and_has_the_spread_asked_for():
    point = np.zeros((1, 41, 41), dtype=np.float32)
    point[0, 20, 20] = 1
    spread = blur(point, 2.1)[0]
    offset = np.arange(41) - 20
    assert spread.sum() == pytest.approx(1, abs=1e-6)
    assert (spread.sum(axis=0) * offset**2).sum() == pytest.approx(2.1**2, rel=1e-3)


@pytest.mark.parametrize("sigma", [0.1, 0.35, 0.8, 3.0])
def test_a_blur_narrower_than_a_sample_still_has_its_spread(sigma):
    point = np.zeros((1, 41, 41), dtype=np.float32)
    point[0, 20, 20] = 1
    variance = (blur(point, sigma)[0].sum(axis=0) * (np.arange(41) - 20) ** 2).sum()
    assert variance == pytest.approx(sigma**2, rel=1e-4)


def test_the_light_of_all_rows_together_is_the_blurred_picture():
    fine = np.random.default_rng(0).random((2, 36, 45)).astype(np.float32)
    fine[:, :18] = fine[:, 27:] = 0  # nothing beyond the border to be missed
    reach = blur_reach(0.7)
    parts = [blur_rows(fine, 0.7, 3, lag) for lag in range(-reach, reach + 1)]
    assert np.allclose(sum(parts), mean_over_pixels(blur(fine, 0.7 * 3), 3), atol=1e-6)
    assert parts[reach + 1][:, 5].max() > 0  # row 6 has light, and row 5 gets some of it
    assert parts[reach + 1][:, 6:].max() > parts[reach + 1][:, :5].max() == 0


def test_blur_reaches_no_farther_than_it_says():
    point = np.zeros((1, 31, 31), dtype=np.float32)
    point[0, 15, 15] = 1
    touched = np.nonzero(blur_pixels(point, 0.7, 3)[0].sum(axis=0) > 1e-9)[0]
    assert np.abs(touched - 15).max() <= blur_reach(0.7)


def test_no_blur_changes_nothing():
    picture = np.random.default_rng(0).random((1, 5, 6)).astype(np.float32)
    assert np.array_equal(blur(picture, 0.0), picture)
    assert np.array_equal(blur_pixels(picture, 0.0, 3), picture)
