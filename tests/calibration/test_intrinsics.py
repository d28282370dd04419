import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.intrinsics import calibrate, calibrate_views
from toolkit.errors import CalibrationError, ConfigError, ImageError


def codes(result):
    return [caution.code for caution in result.warnings]


def test_rendered_photos_give_back_the_camera_and_the_poses(photos, camera):
    result = calibrate(photos.paths, square=0.03)
    assert result.board == (9, 6)
    assert len(result.used) == len(photos.paths)
    assert result.rms_px < 0.08
    error = (result.camera.parameters - camera.parameters).numpy()
    assert abs(error[0]) / camera.fx < 2e-3
    assert abs(error[1]) / camera.fy < 2e-3
    std = result.camera.covariance.diagonal().sqrt().numpy()
    assert (np.abs(error) < 5 * std).all()
    assert (result.camera.width, result.camera.height) == (640, 480)
    for view, true in zip(result.views, photos.poses, strict=True):
        np.testing.assert_allclose(view.T_cam_board[:3, :3], true[:3, :3], atol=3e-3)
        np.testing.assert_allclose(view.T_cam_board[:3, 3], true[:3, 3], atol=3e-3)


def test_poses_are_in_squares_when_no_length_is_given(make_views, tilted_poses):
    poses = tilted_poses(9)
    views = make_views(poses)
    squares, metres = calibrate_views(views), calibrate_views(views, square=0.03)
    for in_squares, in_metres, (_, true) in zip(squares.views, metres.views, poses, strict=True):
        shift = in_squares.T_cam_board[:3, 3]
        np.testing.assert_allclose(shift, true, atol=0.05)
        np.testing.assert_allclose(in_metres.T_cam_board[:3, 3], 0.03 * shift)
    np.testing.assert_allclose(squares.camera.parameters, metres.camera.parameters, rtol=1e-6)


def test_a_view_that_does_not_fit_is_set_aside_and_named(make_views, tilted_poses, camera):
    views = make_views(tilted_poses(10))
    bent = views[4].corners + np.random.default_rng(0).normal(0, 6, (54, 2))
    views[4] = replace(views[4], corners=bent)
    result = calibrate_views(views)
    assert [view.is_used for view in result.views] == [index != 4 for index in range(10)]
    assert result.views[4].reason.startswith("does not fit the other views (")
    assert result.camera.fx == pytest.approx(camera.fx, rel=2e-3)


def test_k3_is_fitted_where_the_lens_has_it(make_views, tilted_poses, camera):
    bent = replace(camera, distortion=(-0.24, 0.08, 0.0, 0.0, -1.2))
    result = calibrate_views(make_views(tilted_poses(12), camera=bent))
    assert len(result.camera.distortion) == 5
    assert result.camera.distortion[4] == pytest.approx(-1.2, abs=0.3)
    assert len(calibrate_views(make_views(tilted_poses(12))).camera.distortion) == 4


def test_views_that_all_face_the_camera_are_refused(make_views):
    poses = [
        (np.array([0, 0, 0.3 * i]), np.array([-4.0 + 0.5 * i, -3.0 + 0.4 * i, 12.0 + i]))
        for i in range(6)
    ]
    with pytest.raises(CalibrationError, match="tilt the board"):
        calibrate_views(make_views(poses))


def test_little_tilt_few_views_and_a_small_area_are_cautioned_against(make_views, tilted_poses):
    result = calibrate_views(make_views(tilted_poses(5, lean=0.12), noise=0.3))
    assert "few_views" in codes(result)
    assert "focal_length_uncertain" in codes(result)
    assert "few_views" not in codes(calibrate_views(make_views(tilted_poses(10))))
    far = [(turn, shift * [1, 1, 1] + [0, 0, 30]) for turn, shift in tilted_poses(10, lean=0.8)]
    assert "poor_coverage" in codes(calibrate_views(make_views(far, noise=0.02)))


def test_photos_from_the_same_place_count_once(make_views, tilted_poses):
    poses = tilted_poses(2)
    views = make_views([poses[0], poses[1], poses[0], poses[1]])
    with pytest.raises(CalibrationError, match=r"2 different .* \(4 show it, some from the same"):
        calibrate_views(views)


def test_two_views_are_too_few(photos):
    with pytest.raises(
        CalibrationError, match="2 different usable views of a board among 3 photos"
    ):
        calibrate([*photos.paths[:2], photos.paths[0]])


def test_the_refusal_names_what_failed(photos, tmp_path):
    missing = tmp_path / "missing.png"
    with pytest.raises(CalibrationError, match=r"missing\.png: cannot be read") as caught:
        calibrate([photos.paths[0], missing])
    assert "\n" not in str(caught.value)


def test_corners_that_no_lens_explains_are_refused(make_views, tilted_poses):
    with pytest.raises(CalibrationError, match="no lens of this model fits"):
        calibrate_views(make_views(tilted_poses(6), noise=8.0))


def test_photos_none_of_which_can_be_read_are_an_image_error(tmp_path):
    (tmp_path / "a.jpg").write_text("text")
    with pytest.raises(ImageError, match=r"none of the 2 photos can be read: .*a\.jpg.*b\.jpg"):
        calibrate([tmp_path / "a.jpg", tmp_path / "b.jpg"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"images": []}, "no photos were given"),
        ({"board": (9, 2)}, "9x2 has too few inner corners"),
        ({"square": 0.0}, "square is 0.0 m"),
        ({"square": math.nan}, "square is nan m"),
    ],
)
def test_impossible_requests_are_refused(settings, message):
    settings = {"images": [Path("a.png")]} | settings
    with pytest.raises(ConfigError, match=message):
        calibrate(settings.pop("images"), **settings)


@pytest.mark.shared_data
def test_opencv_left_comes_out_as_published(opencv_left):
    result = calibrate(opencv_left)
    assert result.board == (9, 6)
    assert len(result.used) == 13
    assert result.rms_px <= 0.30
    assert 528 < result.camera.fx < 537
    assert 528 < result.camera.fy < 537
    assert result.camera.fx == pytest.approx(533.3, abs=1.0)
    assert result.camera.cx == pytest.approx(342.3, abs=2.0)
    assert result.camera.cy == pytest.approx(235.6, abs=2.0)
    assert len(result.camera.distortion) == 4
    assert result.warnings == ()


@pytest.mark.shared_data
def test_a_wide_lens_is_predicted_by_the_model_it_chooses(gopro_wide):
    result = calibrate(gopro_wide)
    assert result.board == (8, 6)
    assert result.camera.model in ("fisheye", "rational")
    assert result.held_out_px <= 0.6
    assert result.camera.fx == pytest.approx(564, abs=5)
