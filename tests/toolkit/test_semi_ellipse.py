import math

import numpy as np
import pytest
import torch

from toolkit.camera import Camera
from toolkit.semi_ellipse import (
    WINDOW_PER_BLUR,
    semi_ellipse,
    semi_ellipse_and_J,
    start_from_moments,
)
from toolkit.synthetic import PlainBall, Scene, StraightPath, flat_background, render_shot

CASES = [  # centre, half width px, opacity, skew, blur px
    (0.0, 10.0, 0.3, 0.0, 0.5),
    (2.37, 25.4, 0.9, 0.15, 0.9),
    (-4.1, 3.2, 0.05, -0.4, 1.7),
    (0.3, 1.1, 1.0, 0.1, 2.5),  # the window is wider than the streak
]
EVEN = [(*case[:3], 0.0, case[4]) for case in CASES]
OFFSET = torch.linspace(-40, 40, 801, dtype=torch.float64)


def as_tensors(*values):
    return tuple(torch.tensor(value, dtype=torch.float64) for value in values)


def averaged_by_hand(offset, centre, half_width, opacity, skew, blur, bend=0.0, samples=20_001):
    """The paper's semi-ellipse, bent by the skew, its mean over the window taken numerically."""
    window = WINDOW_PER_BLUR * blur
    at = offset + window * ((np.arange(samples) + 0.5) / samples - 0.5)
    share = np.clip((at - centre) / half_width, -1, 1)
    longer = 1 + skew * share + bend**2 * (1.5 * share**2 + (1 - share**2) / 6)
    return opacity * (np.sqrt(1 - share**2) * longer).mean()


@pytest.mark.parametrize("case", CASES)
def test_it_is_the_window_s_mean_of_the_paper_s_curve(case):
    offset = np.linspace(-30, 30, 97)
    expected = [averaged_by_hand(y, *case) for y in offset]
    alpha = semi_ellipse(torch.from_numpy(offset), *as_tensors(*case))
    np.testing.assert_allclose(alpha.numpy(), expected, atol=2e-6 * case[2])


def test_the_window_has_the_standard_deviation_of_the_blur():
    window = WINDOW_PER_BLUR * 0.8
    assert window / math.sqrt(12) == pytest.approx(0.8)


def test_a_narrow_window_leaves_the_bare_curve():
    alpha = semi_ellipse(OFFSET, *as_tensors(0.0, 12.0, 0.4, 0.0, 1e-4))
    bare = 0.4 * (1 - (OFFSET / 12) ** 2).clamp_min(0).sqrt()
    assert (alpha - bare).abs().max() < 0.4 * 5e-3  # at the edge, where the slope is infinite
    inner = OFFSET.abs() < 11
    assert (alpha - bare)[inner].abs().max() < 1e-7


@pytest.mark.parametrize("case", EVEN)
def test_blur_moves_light_but_loses_none(case):
    centre, half_width, opacity, _, blur = case
    alpha = semi_ellipse(OFFSET, *as_tensors(*case))
    step = float(OFFSET[1] - OFFSET[0])
    area = float(alpha.sum()) * step
    assert area == pytest.approx(math.pi * opacity * half_width / 2, rel=1e-4)
    mean = float((alpha * OFFSET).sum()) * step / area
    assert mean == pytest.approx(centre, abs=1e-3)
    variance = float((alpha * (OFFSET - centre) ** 2).sum()) * step / area
    assert variance == pytest.approx(half_width**2 / 4 + blur**2, rel=1e-3)


@pytest.mark.parametrize("case", CASES)
def test_beyond_streak_and_window_there_is_nothing(case):
    centre, half_width, _, _, blur = case
    alpha = semi_ellipse(OFFSET, *as_tensors(*case))
    beyond = (OFFSET - centre).abs() > half_width + WINDOW_PER_BLUR * blur / 2
    assert beyond.any()
    assert (alpha[beyond] == 0).all()


def test_shapes_broadcast():
    offset = torch.arange(-5.0, 6.0).double()
    one = torch.ones(4, 3, 1, dtype=torch.float64)
    blur = torch.full((4, 1, 1), 0.7, dtype=torch.float64)
    parameters = (0 * one, 3 * one, 0.5 * one, 0 * one, blur)
    alpha, J = semi_ellipse_and_J(offset, *parameters)
    assert semi_ellipse(offset, *parameters).shape == alpha.shape == (4, 3, 11)
    assert J.shape == (4, 3, 11, 5)


@pytest.mark.parametrize("case", CASES)
def test_both_forms_agree_and_J_is_the_derivative(case):
    parameters = torch.tensor(case, dtype=torch.float64)
    alpha, J = semi_ellipse_and_J(OFFSET, *parameters)
    assert torch.allclose(alpha, semi_ellipse(OFFSET, *parameters), atol=1e-14)
    automatic = torch.func.jacrev(lambda p: semi_ellipse(OFFSET, *p))(parameters)
    # automatic differentiation has no value where the window's border meets the rim exactly
    known = torch.isfinite(automatic).all(-1)
    assert known.double().mean() > 0.99
    assert torch.allclose(J[known], automatic[known], atol=1e-9)
    assert torch.isfinite(J).all()


def test_J_is_finite_where_the_window_meets_the_rim():
    half_window = WINDOW_PER_BLUR / 2
    offset = torch.tensor([10 + half_window, 10 - half_window, -10 - half_window]).double()
    _, J = semi_ellipse_and_J(offset, *as_tensors(0.0, 10.0, 0.5, 0.2, 1.0))
    assert torch.isfinite(J).all()


@pytest.mark.parametrize("case", EVEN[:3])
def test_moments_give_the_parameters_of_a_clean_profile(case):
    centre, half_width, opacity, _, blur = case
    offset = torch.arange(-40.0, 41.0).double()
    alpha = semi_ellipse(offset, *as_tensors(*case))
    guess = start_from_moments(offset, alpha, torch.ones_like(alpha))
    assert float(guess[0]) == pytest.approx(centre, abs=0.05)
    # the blur widens it, and its area stays
    widened = math.hypot(half_width, 2 * blur)
    assert float(guess[1]) == pytest.approx(widened, rel=0.02)
    assert float(guess[2]) == pytest.approx(opacity * half_width / widened, rel=0.02)


def test_moments_of_noisy_profiles_are_right_to_half_a_px():
    generator = torch.Generator().manual_seed(4)
    offset = torch.arange(-30.0, 31.0).double()
    alpha = semi_ellipse(offset, *as_tensors(1.3, 20.0, 0.4, 0.0, 0.7))
    noisy = alpha + 0.01 * torch.randn(500, len(offset), generator=generator).double()
    centre, half_width, opacity = start_from_moments(offset, noisy, torch.ones_like(noisy))
    assert (centre - 1.3).std() < 0.5
    assert (half_width - 20).pow(2).mean().sqrt() < 0.5
    assert (opacity / 0.4 - 1).abs().max() < 0.1


def test_moments_ignore_what_has_no_weight():
    offset = torch.arange(-30.0, 31.0).double()
    alpha = semi_ellipse(offset, *as_tensors(0.0, 10.0, 0.4, 0.0, 0.7))
    spoiled = torch.where(offset > 20, 5.0, alpha)
    weight = (offset <= 20).double()
    assert torch.allclose(
        torch.stack(start_from_moments(offset, spoiled, weight)),
        torch.stack(start_from_moments(offset, alpha, torch.ones_like(alpha))),
    )


def test_an_empty_profile_gives_finite_moments():
    offset = torch.arange(-5.0, 6.0).double()
    guess = start_from_moments(offset, torch.zeros(2, 11).double(), torch.ones(2, 11).double())
    assert torch.isfinite(torch.stack(guess)).all()


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize("bending_radius", [100.0, 300.0])
def test_the_skew_is_that_of_a_ball_on_a_circle(bending_radius, turn):
    """Chords of a disc of 20 px that runs on a circle, bending right or left, in closed form."""
    half_width, opacity = 20.0, 0.3
    offset = np.linspace(-19.5, 19.5, 79)
    from_middle = bending_radius - turn * offset  # a turn to the right has its centre on the right
    covered = np.arccos(
        (bending_radius**2 + from_middle**2 - half_width**2) / (2 * bending_radius * from_middle)
    )
    straight_on = math.acos(1 - half_width**2 / (2 * bending_radius**2))
    skew = turn * half_width / (2 * bending_radius)
    model = semi_ellipse(
        torch.from_numpy(offset), *as_tensors(0.0, half_width, opacity, skew, 1e-3, skew)
    )
    error = model.numpy() - opacity * covered / straight_on
    assert np.abs(error).max() < 0.6 * opacity * (half_width / bending_radius) ** 2
    without = semi_ellipse(
        torch.from_numpy(offset), *as_tensors(0.0, half_width, opacity, 0.0, 1e-3)
    )
    assert np.abs(without.numpy() - opacity * covered / straight_on).max() > 3 * np.abs(error).max()


BALL_RADIUS = 0.05
DISTANCE = 2.0


def across_a_streak(tilt, blur=0.0):
    """Pixel rows and opacity across the middle of a rendered streak that runs along the rows."""
    camera = Camera(width=200, height=60, fx=800.0, fy=800.0, cx=99.5, cy=29.3)
    half_travel = 0.13
    direction = np.array([math.cos(tilt), 0.0, math.sin(tilt)])
    start = np.array([0.0, 0.0, DISTANCE]) - half_travel * direction
    velocity = 2 * half_travel * direction / 0.01
    path = StraightPath(start=tuple(start.tolist()), start_velocity=tuple(velocity.tolist()))
    scene = Scene(
        camera=camera,
        path=path,
        ball_radius=BALL_RADIUS,
        exposure=0.01,
        appearance=PlainBall(colour=(1.0, 1.0, 1.0)),
        background=flat_background(200, 60, (0.0, 0.0, 0.0)),
        blur=blur,
    )
    shot = render_shot(scene, step=0.05, supersampling=5)
    profile = shot.clean_image[0, :, 99:101].mean(-1).double()
    return torch.arange(60).double() - 29.3, profile


@pytest.mark.parametrize(("tilt", "blur"), [(0.0, 0.0), (0.0, 1.0), (0.35, 0.0), (-0.35, 0.7)])
def test_many_sharp_images_of_a_ball_leave_a_semi_ellipse(tilt, blur):
    offset, profile = across_a_streak(tilt, blur)
    # exact geometry of the axis, whose distance from the viewpoint is R / sin(half the angle)
    distance = DISTANCE * math.cos(tilt)
    half_width = 800.0 * math.tan(math.asin(BALL_RADIUS / distance)) * math.cos(tilt)
    crossed = 2 * BALL_RADIUS / math.cos(tilt)  # 2R / sin(gamma)
    opacity = crossed / 0.26
    width = math.hypot(blur, math.sqrt(1 / 12))
    model = semi_ellipse(offset, *as_tensors(0.0, half_width, opacity, 0.0, width))
    inner = offset.abs() < half_width - 3 * width
    # perspective bends the semi-ellipse by less than (R / distance)^2; a box replaces a Gaussian
    assert (model - profile)[inner].abs().max() < 2e-3 * opacity + (0.025**2) * opacity
    assert (model - profile).abs().max() < 0.02 * opacity
    assert float((model - profile).sum()) == pytest.approx(0, abs=2e-3 * float(profile.sum()))
