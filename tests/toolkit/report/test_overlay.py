import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from toolkit import EnvironmentFault, LinearImage, Measurement
from toolkit.measurement import ContourPoints, ProfileTable, Sign
from toolkit.report import draw_overlay, write_overlay
from toolkit.report.overlay import AXIS, CONTOUR, GOOD_PROFILE, LEFT_OUT_PROFILE


def flat_image(level: float, width: int = 200, height: int = 120) -> LinearImage:
    return LinearImage(
        rgb=torch.full((1, 3, height, width), level),
        clipped=torch.zeros(1, 1, height, width, dtype=torch.bool),
    )


def level_streak() -> Measurement:
    x = [20.0, 60.0, 100.0, 140.0, 180.0]
    return Measurement(
        contours=ContourPoints(left=tuple((v, 30.0) for v in x), right=tuple((v, 90.0) for v in x)),
        profiles=ProfileTable(
            centre_px=((50.0, 60.0), (120.0, 60.0), (150.0, 60.0)),
            half_width_px=(30.0, 20.0, math.nan),
            opacity=(0.5, 0.5, 0.5),
            flags=(0, 4, 1),
        ),
        sign=Sign(ambiguous=True, probability=0.5),
    )


def is_near(pixel: np.ndarray, colour: tuple[int, int, int]) -> bool:
    """A smoothed line of one pixel lets a little of the picture through."""
    return bool(np.abs(pixel.astype(int) - colour).max() < 40)


def test_lines_are_where_they_belong():
    picture = draw_overlay(flat_image(0.2), level_streak())
    assert picture.shape == (120, 200, 3)
    assert picture.dtype == np.uint8
    assert is_near(picture[30, 75], CONTOUR)
    assert is_near(picture[90, 75], CONTOUR)
    assert is_near(picture[60, 75], AXIS)
    assert is_near(picture[45, 50], GOOD_PROFILE)
    assert is_near(picture[45, 120], LEFT_OUT_PROFILE)
    assert tuple(picture[35, 120]) == tuple(picture[0, 0])  # it reaches 20 px only
    assert tuple(picture[45, 150]) == tuple(picture[0, 0])  # not finite: not drawn


def test_profiles_stand_across_a_slanting_axis():
    contours = ContourPoints(left=((40.0, 0.0), (100.0, 60.0)), right=((0.0, 40.0), (60.0, 100.0)))
    profiles = ProfileTable(
        centre_px=((50.0, 50.0),), half_width_px=(28.28,), opacity=(0.5,), flags=(0,)
    )
    picture = draw_overlay(flat_image(0.2), Measurement(contours=contours, profiles=profiles))
    assert is_near(picture[40, 60], GOOD_PROFILE)
    assert is_near(picture[60, 40], GOOD_PROFILE)


def test_dense_profiles_leave_the_shot_in_sight():
    contours = ContourPoints(left=((0.0, 30.0), (199.0, 30.0)), right=((0.0, 90.0), (199.0, 90.0)))
    count = 400
    table = ProfileTable(
        centre_px=tuple((x / 2, 60.0) for x in range(count)),
        half_width_px=(30.0,) * count,
        opacity=(0.5,) * count,
        flags=(0,) * count,
    )
    picture = draw_overlay(flat_image(0.2), Measurement(contours=contours, profiles=table))
    green = [is_near(pixel, GOOD_PROFILE) for pixel in picture[45]]
    assert 10 <= sum(green) <= 20


def test_arrow_only_where_the_sign_is_settled():
    open_sign = draw_overlay(flat_image(0.2), level_streak())
    settled = replace(level_streak(), sign=Sign(ambiguous=False, probability=0.99, cue="drag"))
    assert not np.array_equal(open_sign[:, 160:], draw_overlay(flat_image(0.2), settled)[:, 160:])
    assert np.array_equal(open_sign[:, :160], draw_overlay(flat_image(0.2), settled)[:, :160])


def test_a_ball_that_may_have_stood_still_has_no_axis():
    still = replace(level_streak(), speed_upper_m_s=0.1)
    picture = draw_overlay(flat_image(0.2), still)
    assert is_near(picture[30, 75], CONTOUR)
    assert tuple(picture[60, 75]) == tuple(picture[0, 0])


def test_what_was_not_found_is_not_drawn():
    alone = Measurement(contours=level_streak().contours)
    picture = draw_overlay(flat_image(0.2), alone)
    assert is_near(picture[30, 75], CONTOUR)
    assert is_near(picture[60, 75], AXIS)
    assert tuple(picture[45, 50]) == tuple(picture[0, 0])


def test_lines_grow_with_the_picture():
    small = draw_overlay(flat_image(0.2), level_streak())
    large = draw_overlay(flat_image(0.2, 4200, 120), level_streak())
    widths = [sum(is_near(p, CONTOUR) for p in picture[20:40, 75]) for picture in (small, large)]
    assert widths[1] >= widths[0] + 2


def test_dark_shot_is_made_visible_and_a_bright_one_not_darkened():
    nothing = Measurement.refused("dark")
    assert draw_overlay(flat_image(0.02), nothing).mean() > 200
    assert (draw_overlay(flat_image(1.0), nothing) == 255).all()
    assert (draw_overlay(flat_image(0.0), nothing) == 0).all()


def test_points_far_outside_do_not_wrap_round():
    far = ContourPoints(left=((1e9, 1e9), (2e9, 1e9)), right=((1e9, 2e9), (2e9, 2e9)))
    plain = draw_overlay(flat_image(0.2), Measurement())
    assert np.array_equal(draw_overlay(flat_image(0.2), Measurement(contours=far)), plain)


def test_written_png_holds_the_same_pixels(tmp_path):
    path = tmp_path / "o.png"
    write_overlay(path, flat_image(0.2), level_streak())
    assert np.array_equal(
        cv2.imread(str(path))[..., ::-1], draw_overlay(flat_image(0.2), level_streak())
    )
    with pytest.raises(EnvironmentFault, match="cannot be written"):
        write_overlay(tmp_path / "none" / "o.png", flat_image(0.2), level_streak())
