from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.board import Board
from calibration.choose_lens import choose_lens
from calibration.held_out import held_out, reduce_poses
from calibration.lens_doubt import lens_doubt
from calibration.lens_fit import fit_lens, gather, linearise, residuals, total_rms, view_rms
from calibration.lens_models import FISHEYE, K1_K2, MODELS, PINHOLE_4, PINHOLE_5, RATIONAL
from calibration.lens_start import first_fit, focal_guess, start_lens
from toolkit.errors import CalibrationError

SIZE = (640, 480)
POINTS = Board(columns=9, rows=6).points()
BEND = np.array([0.02, -0.005, 0.01])


@pytest.fixture
def corners_of(make_views, tilted_poses):
    def corners_of(count=10, **settings):
        views = make_views(tilted_poses(count), **settings)
        return gather([POINTS] * count, [view.corners for view in views], SIZE)

    return corners_of


def fitted(corners, model=PINHOLE_4):
    return fit_lens(corners, first_fit(corners, model), settled=1e-12)


def covariance_of(corners, fit):
    """Of fitted lens numbers, corner errors independent; the poses unknown."""
    reduced = reduce_poses(corners, fit)
    freedom = 2 * corners.weight.sum() - fit.shared - 6 * corners.views
    return np.linalg.inv(reduced.information.sum(0)) * (reduced.residual**2).sum() / freedom


def test_the_focal_length_is_guessed_from_the_boards_alone(corners_of, camera):
    straight = replace(camera, distortion=(0.0, 0.0, 0.0, 0.0))
    assert focal_guess(corners_of(camera=straight, noise=0.0)) == pytest.approx(558, rel=0.02)


def test_exact_corners_give_the_exact_lens(corners_of, camera):
    corners = corners_of(noise=0.0)
    lens = fitted(corners)
    np.testing.assert_allclose(lens.lens, camera.parameters.numpy(), rtol=1e-6, atol=1e-7)
    assert total_rms(corners, residuals(corners, lens)) < 1e-6


@pytest.mark.parametrize("model", [PINHOLE_4, PINHOLE_5, RATIONAL], ids=lambda m: m.name)
def test_the_fit_and_its_covariance_are_opencvs(corners_of, model):
    corners = corners_of(noise=0.2)
    fit = fitted(corners, model)
    flags = {4: cv2.CALIB_FIX_K3, 5: 0, 8: cv2.CALIB_RATIONAL_MODEL}[model.size]
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-14)
    rms, matrix, distortion, _, _, expected, *_ = cv2.calibrateCameraExtended(
        [POINTS.astype(np.float32)] * 10,
        [view.astype(np.float32) for view in corners.seen],
        SIZE,
        None,
        None,
        flags=flags,
        criteria=stop,
    )
    ours = total_rms(corners, residuals(corners, fit))
    assert ours <= rms * (1 + 1e-4)
    if model is RATIONAL:  # its terms trade with each other: only what they show is comparable
        assert ours == pytest.approx(rms, rel=2e-3)
        return
    np.testing.assert_allclose(fit.lens[:4], matrix[[0, 1, 0, 1], [0, 1, 2, 2]], atol=0.01)
    np.testing.assert_allclose(fit.lens[4:], distortion.ravel()[: model.size], atol=2e-3)
    std = np.sqrt(np.diag(covariance_of(corners, fit)))
    np.testing.assert_allclose(std, expected.ravel()[: 4 + model.size], rtol=5e-3)


def test_a_fisheye_comes_back_from_its_corners(tilted_poses):
    true = np.array([400.0, 399.0, 325.0, 236.0, -0.03, 0.01, -0.006, 0.001])
    views = []
    for turn, shift in tilted_poses(12):
        shift = shift * [2.2, 2.2, 0.55]  # near, towards the edges
        rotation = cv2.Rodrigues(turn)[0]
        matrix = np.array([[true[0], 0, true[2]], [0, true[1], true[3]], [0, 0, 1]])
        placed = (POINTS @ rotation.T + shift)[:, None]
        none = np.zeros((3, 1))
        views.append(cv2.fisheye.projectPoints(placed, none, none, matrix, true[4:])[0][:, 0])
    corners = gather([POINTS] * 12, views, SIZE)
    fit = fitted(corners, FISHEYE)
    np.testing.assert_allclose(fit.lens, true, rtol=1e-5, atol=1e-5)
    noisy = replace(
        corners, seen=corners.seen + np.random.default_rng(0).normal(0, 0.1, (12, 54, 2))
    )
    assert choose_lens(noisy).taken.fit.model is FISHEYE


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_derivatives_agree_with_differences(corners_of, model):
    corners = corners_of(4)
    start = start_lens(corners, model, 555.0)
    lens = start.lens + np.concatenate([np.zeros(4), 0.03 * np.arange(1, 1 + model.size)])
    fit = replace(start, lens=lens, is_bent=True, bend=BEND)
    linear = linearise(corners, fit)
    base = residuals(corners, fit).reshape(4, -1)
    np.testing.assert_allclose(linear.residual, base)
    for index, column in enumerate(model.columns):
        step = 1e-6 * max(1.0, abs(fit.lens[column]))
        moved = fit.lens.copy()
        moved[column] += step
        slope = (residuals(corners, replace(fit, lens=moved)).reshape(4, -1) - base) / step
        np.testing.assert_allclose(linear.J_shared[..., index], slope, rtol=1e-3, atol=2e-3)
    for index in range(3):
        moved = fit.bend.copy()
        moved[index] += 1e-6
        slope = (residuals(corners, replace(fit, bend=moved)).reshape(4, -1) - base) / 1e-6
        np.testing.assert_allclose(
            linear.J_shared[..., len(model.columns) + index], slope, rtol=1e-3, atol=2e-3
        )
    for index in range(6):
        turn, shift = np.zeros(3), np.zeros(3)
        (turn if index < 3 else shift)[index % 3] = 1e-6
        moved_fit = replace(
            fit,
            rotation=cv2.Rodrigues(turn)[0] @ fit.rotation,
            translation=fit.translation + shift,
        )
        slope = (residuals(corners, moved_fit).reshape(4, -1) - base) / 1e-6
        np.testing.assert_allclose(linear.J_pose[..., index], slope, rtol=1e-3, atol=2e-2)


def test_a_view_of_a_part_of_the_board_counts_with_what_it_shows(corners_of, camera):
    whole = corners_of(noise=0.0)
    part = np.r_[3:30]
    places = [POINTS[part] if view == 2 else POINTS for view in range(10)]
    seen = [view[part] if index == 2 else view for index, view in enumerate(whole.seen)]
    corners = gather(places, seen, SIZE)
    assert corners.weight.sum() == 9 * 54 + 27
    fit = fitted(corners)
    np.testing.assert_allclose(fit.lens, camera.parameters.numpy(), rtol=1e-6, atol=1e-7)
    assert view_rms(corners, residuals(corners, fit)).max() < 1e-6


def test_a_bent_board_is_found_and_the_lens_with_it(corners_of, camera):
    flat = corners_of(noise=0.0)
    bent = replace(fitted(flat), is_bent=True, bend=BEND)
    seen = residuals(flat, bent) + flat.seen
    noise = np.random.default_rng(1).normal(0, 0.05, seen.shape)
    choice = choose_lens(replace(flat, seen=seen + noise))
    assert choice.taken.fit.is_bent
    np.testing.assert_allclose(choice.taken.fit.bend, BEND, atol=3e-3)
    assert choice.taken.fit.lens[0] == pytest.approx(camera.fx, rel=2e-3)
    unbent = choice.other(choice.taken.fit.model, is_bent=False)
    assert unbent.held_out.rms_px > 1.5 * choice.taken.held_out.rms_px


def test_a_flat_board_stays_flat_and_the_lens_as_simple_as_it_is(corners_of, camera):
    assert not choose_lens(corners_of(12)).taken.fit.is_bent
    simple = replace(camera, distortion=(-0.24, 0.08, 0.0, 0.0))
    assert choose_lens(corners_of(12, camera=simple)).taken.fit.model is K1_K2


def test_leaving_views_out_by_one_step_is_as_good_as_fitting_again(corners_of):
    corners = corners_of(10, noise=0.2)
    fit = fitted(corners, PINHOLE_5)
    folds = np.arange(10) % 5
    quick = held_out(corners, fit, folds)
    squares = []
    for fold in range(5):
        kept, left = folds != fold, folds == fold
        again = fit_lens(
            corners.only(kept),
            replace(fit, rotation=fit.rotation[kept], translation=fit.translation[kept]),
        )
        matrix = np.array(
            [[again.lens[0], 0, again.lens[2]], [0, again.lens[1], again.lens[3]], [0, 0, 1]]
        )
        for seen in corners.only(left).seen:
            _, turn, shift = cv2.solvePnP(POINTS, seen, matrix, again.lens[4:])
            turn, shift = cv2.solvePnPRefineLM(POINTS, seen, matrix, again.lens[4:], turn, shift)
            shown = cv2.projectPoints(POINTS, turn, shift, matrix, again.lens[4:])[0][:, 0]
            squares.append(((shown - seen) ** 2).sum())
    exact = np.sqrt(np.sum(squares) / corners.weight.sum())
    assert quick.rms_px == pytest.approx(exact, rel=0.01)
    assert quick.rms_px > total_rms(corners, residuals(corners, fit))


def test_covariance_is_the_spread_of_repeated_calibrations(corners_of, camera):
    exact = corners_of(8, noise=0.0)
    start = fitted(exact)
    generator = np.random.default_rng(5)
    repeats, noise = 120, 0.2
    errors, normalised = [], []
    for _ in range(repeats):
        corners = replace(exact, seen=exact.seen + generator.normal(0, noise, exact.seen.shape))
        fit = fit_lens(corners, start)
        covariance = covariance_of(corners, fit)
        errors.append(fit.lens - camera.parameters.numpy())
        normalised.append(errors[-1] @ np.linalg.solve(covariance, errors[-1]))
    # a mean of chi squared with 8 degrees: 8 within 4 standard deviations, sqrt(2 * 8 / 120) each
    assert np.mean(normalised) == pytest.approx(8, abs=4 * np.sqrt(16 / repeats))
    np.testing.assert_allclose(np.std(errors, axis=0), np.sqrt(np.diag(covariance)), rtol=0.25)


def test_errors_common_to_a_view_widen_the_covariance(corners_of):
    corners = corners_of(12, noise=0.05)
    generator = np.random.default_rng(2)
    plain = lens_doubt(corners, choose_lens(corners))
    u, v = corners.board_axes(corners.points)
    waves = np.stack([u * u * v, u * v * v, u**3, v**3], axis=-1)
    common = waves @ generator.normal(0, 0.4, (12, 4, 2))
    widened = lens_doubt(*_with_choice(replace(corners, seen=corners.seen + common)))
    assert plain.common < 1.5
    assert widened.common > 1.5


def _with_choice(corners):
    return corners, choose_lens(corners)


def test_corners_on_a_line_are_an_error():
    seen = np.stack([np.arange(54.0) * 5 + 100, np.arange(54.0) * 2 + 80], axis=-1)
    corners = gather([POINTS] * 3, [seen] * 3, SIZE)
    with pytest.raises(CalibrationError, match="lie on a line"):
        first_fit(corners, K1_K2)
