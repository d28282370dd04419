import cv2
import numpy as np
import pytest

from calibration.lens_fit import board_points, fit_lens, left_out_rms, lens_covariance
from toolkit.errors import CalibrationError

SIZE, BOARD = (640, 480), (9, 6)
POINTS = board_points(BOARD)


def parameters(lens):
    (fx, _, cx), (_, fy, cy) = lens.matrix[:2]
    return np.array([fx, fy, cx, cy, *lens.distortion])


@pytest.fixture
def corners_of(make_views, tilted_poses):
    def corners_of(count=10, **settings):
        return [view.corners for view in make_views(tilted_poses(count), **settings)]

    return corners_of


def test_board_points_run_along_the_long_side_first():
    assert POINTS.shape == (54, 3)
    np.testing.assert_array_equal(
        POINTS[[0, 1, 8, 9]], [[0, 0, 0], [1, 0, 0], [8, 0, 0], [0, 1, 0]]
    )


def test_exact_corners_give_the_exact_lens(corners_of, camera):
    corners = corners_of(noise=0.0)
    lens = fit_lens(POINTS, corners, SIZE, with_k3=False)
    np.testing.assert_allclose(parameters(lens), camera.parameters.numpy(), rtol=1e-4, atol=1e-5)
    assert lens.rms_px < 1e-3
    assert lens.rotation.shape == lens.translation.shape == (10, 3)
    assert lens.view_rms.shape == (10,)


@pytest.mark.parametrize("with_k3", [False, True])
def test_covariance_agrees_with_opencv(corners_of, with_k3):
    corners = corners_of(noise=0.2)
    lens = fit_lens(POINTS, corners, SIZE, with_k3=with_k3)
    covariance = lens_covariance(POINTS, corners, lens)
    expected = cv2.calibrateCameraExtended(
        [POINTS.astype(np.float32)] * len(corners),
        [view.astype(np.float32) for view in corners],
        SIZE,
        None,
        None,
        flags=0 if with_k3 else cv2.CALIB_FIX_K3,
    )[5].ravel()
    size = 9 if with_k3 else 8
    assert covariance.shape == (size, size)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), expected[:size], rtol=2e-3)


def test_covariance_is_the_spread_of_repeated_calibrations(corners_of, camera):
    exact = corners_of(8, noise=0.0)
    generator = np.random.default_rng(5)
    repeats, noise = 120, 0.2
    errors, normalised = [], []
    for _ in range(repeats):
        corners = [view + generator.normal(0, noise, view.shape) for view in exact]
        lens = fit_lens(POINTS, corners, SIZE, with_k3=False)
        covariance = lens_covariance(POINTS, corners, lens)
        errors.append(parameters(lens) - camera.parameters.numpy())
        normalised.append(errors[-1] @ np.linalg.solve(covariance, errors[-1]))
    # a mean of chi squared with 8 degrees: 8 within 4 standard deviations, sqrt(2 * 8 / 120) each
    assert np.mean(normalised) == pytest.approx(8, abs=4 * np.sqrt(16 / repeats))
    np.testing.assert_allclose(np.std(errors, axis=0), np.sqrt(np.diag(covariance)), rtol=0.25)
    # off the diagonal too: fx and fy err together
    spread, claimed = np.corrcoef(np.transpose(errors)), covariance
    claimed = claimed / np.sqrt(np.outer(np.diag(claimed), np.diag(claimed)))
    np.testing.assert_allclose(spread, claimed, atol=0.35)
    assert claimed[0, 1] > 0.9


def test_k3_helps_left_out_views_only_where_the_lens_has_it(corners_of, camera):
    from dataclasses import replace

    def gain(distortion):
        corners = corners_of(camera=replace(camera, distortion=distortion), noise=0.1)
        plain, cubic = (
            left_out_rms(POINTS, corners, SIZE, with_k3=with_k3) for with_k3 in (False, True)
        )
        return cubic / plain

    assert gain((-0.24, 0.08, 0.0, 0.0, 0.0)) > 0.995
    assert gain((-0.24, 0.08, 0.0, 0.0, -1.2)) < 0.9


def test_left_out_rms_is_the_noise_where_the_model_is_right(corners_of):
    corners = corners_of(15, noise=0.1)
    # two coordinates a corner
    assert left_out_rms(POINTS, corners, SIZE, with_k3=False) == pytest.approx(0.141, rel=0.1)


def test_parameters_that_no_view_shows_are_an_error(make_views):
    still = [(np.zeros(3), np.array([-4.0, -2.5, 12.0]))] * 3
    corners = [view.corners for view in make_views(still, noise=0.0)]
    with pytest.raises(CalibrationError, match="tilt the board more"):
        lens_covariance(POINTS, corners, fit_lens(POINTS, corners, SIZE, with_k3=False))
