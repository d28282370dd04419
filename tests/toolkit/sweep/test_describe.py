import math
from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.motion import SPEED
from toolkit.sweep.describe import SweepResult, describe_sweep
from toolkit.sweep.doubt import J_state, sweep_uncertainty
from toolkit.sweep.linearity import Linearity
from toolkit.sweep.misfit import look_for_misfit
from toolkit.sweep.paths import PARABOLA
from toolkit.sweep.still import SpeedLimit

EXPOSURE = 0.02
LIGHT = torch.ones(3, dtype=torch.float64)


@pytest.fixture(scope="module")
def seen(streak):
    return streak(Uniform(), length_widths=1.5)


@pytest.fixture(scope="module")
def found(seen):
    fit = seen.fit()
    misfit = look_for_misfit(fit)
    uncertainty = sweep_uncertainty(
        fit,
        misfit,
        others=(),
        ball_radius_std=0.0,
        exposure_std_share=0.0,
        response_changes=torch.zeros(0),
    )
    linear = Linearity(known=0.0)
    return SweepResult(fit=fit, misfit=misfit, linearity=linear, uncertainty=uncertainty)


def described(found, exposure=EXPOSURE, drift=LIGHT, profiles=None):
    return describe_sweep(found, exposure=exposure, drift=drift, profiles=profiles)


def codes(result):
    return {caution.code for caution in result.warnings}


def test_the_state_is_at_mid_exposure(seen, found):
    result = described(found)
    assert result.stage == "sweep"
    assert result.time_s == pytest.approx(EXPOSURE / 2)
    position, displacement = found.fit.state()
    assert result.position_m == pytest.approx(position.tolist())
    assert result.velocity_m_s == pytest.approx((displacement / EXPOSURE).tolist())
    assert result.speed_m_s == pytest.approx(float(displacement.norm()) / EXPOSURE)
    assert math.hypot(*result.direction) == pytest.approx(1)
    assert result.sign.ambiguous


def test_the_trajectory_runs_over_the_exposure(found):
    path = described(found).trajectory
    assert path.time_s[0] == 0
    assert path.time_s[-1] == pytest.approx(EXPOSURE)
    assert path.position_m[0] == pytest.approx(found.fit.state(-0.5)[0].tolist())
    assert path.position_m[-1] == pytest.approx(found.fit.state(0.5)[0].tolist())


def test_rows_read_later_shift_all_times(found):
    plain, late = described(found), described(replace(found, delay=0.004))
    assert late.time_s == pytest.approx(plain.time_s + 0.004)
    assert late.trajectory.time_s[0] == pytest.approx(0.004)
    assert late.trajectory.position_m == plain.trajectory.position_m


def test_the_bound_is_the_inverse_of_the_information(found):
    result = described(found)
    fit = found.fit
    J = J_state(fit)
    covariance = J @ torch.linalg.inv(fit.seen.information)[:6, :6] @ J.mT
    std = covariance.diagonal().sqrt()
    assert result.bound.position_std_m == pytest.approx(std[:3].tolist(), rel=1e-6)
    assert result.bound.speed_std_m_s == pytest.approx(float(std[SPEED]) / EXPOSURE, rel=1e-6)


def test_efficiency_is_what_is_left_of_the_bound(found):
    """Where the pixels leave no more than noise, all of it."""
    plain = described(found)
    assert 0.9 < plain.bound.efficiency <= 1
    wider = replace(found, misfit=replace(found.misfit, factor=4 * found.misfit.factor))
    noise = replace(found.uncertainty, noise=4 * found.uncertainty.noise)
    doubted = described(replace(wider, uncertainty=noise))
    assert doubted.bound.position_std_m == pytest.approx(plain.bound.position_std_m)
    assert doubted.bound.efficiency == pytest.approx(plain.bound.efficiency / 4)
    depth = torch.zeros_like(found.uncertainty.noise)
    depth[2, 2] = found.uncertainty.noise[2, 2]
    halved = described(replace(found, uncertainty=replace(found.uncertainty, radius=depth)))
    assert halved.bound.efficiency == pytest.approx(plain.bound.efficiency / 2)
    assert halved.budget.depth.radius == pytest.approx(0.5)


def test_the_fit_is_summed_up(seen, found):
    fit = described(found).fit
    assert fit.chi2_per_dof == pytest.approx(1, abs=0.05)
    assert fit.appearance == pytest.approx(seen.scene.appearance.colour, abs=0.03)
    assert fit.blur_px == pytest.approx(seen.scene.blur, abs=0.15)
    assert fit.pixels == pytest.approx(3 * len(found.fit.pixels), rel=0.01)
    assert len(fit.residuals.place_px) == len(fit.residuals.sigma) > 6


def test_outlines_run_beside_the_streak(seen, found):
    contours = described(found).contours
    left, right = (torch.tensor(side).double() for side in (contours.left, contours.right))
    axis = seen.scene.camera.project(seen.points())
    half_width = 15.0
    for side in (left, right):
        middle = side[len(side) // 4 : -len(side) // 4]
        assert (torch.cdist(middle, axis).amin(1) - half_width).abs().max() < 1.0


def test_without_an_exposure_only_speeds_are_missing(found):
    result, full = described(found, exposure=None), described(found)
    assert result.speed_m_s is result.velocity_m_s is result.time_s is None
    assert result.bound.speed_std_m_s is None
    assert result.budget.speed is None
    assert result.position_m == full.position_m
    assert codes(result) - codes(full) == {"exposure-unknown"}


def test_a_ball_that_may_stand_still_has_no_velocity_but_limits(found):
    limit = SpeedLimit(any_way=0.4, across=0.01)
    result = described(replace(found, still_below=limit))
    assert result.speed_upper_m_s == pytest.approx(0.4 / EXPOSURE)
    assert result.speed_m_s is result.speed_std_m_s is result.velocity_m_s is None
    assert result.direction is result.sign is result.state_covariance is None
    told = {caution.code: caution.message for caution in result.warnings}["may-stand-still"]
    assert "at most 20 m/s" in told
    assert "at most 0.5 m/s across" in told
    assert result.position_m == described(found).position_m


def test_a_misfit_is_told_with_its_numbers(found):
    assert "streak-misfit" not in codes(described(found))
    misfit = replace(found.misfit, patches=7.25, is_patchy=True, factor=7.25)
    warnings = described(replace(found, misfit=misfit)).warnings
    told = {caution.code: caution.message for caution in warnings}["streak-misfit"]
    assert "7.2 in patches" in told
    noisy = replace(found, misfit=replace(found.misfit, pixels=1.6))
    assert "streak-misfit" in codes(described(noisy))


def test_another_light_is_told(found):
    assert "background-brightness" in codes(described(found, drift=0.9 * LIGHT))
    assert "background-brightness" not in codes(described(found))


def test_a_ball_that_nearly_stops_on_its_way_may_have_turned_back(found):
    assert "may-turn-back" not in codes(described(found))
    first, last = found.fit.parameters[:6].reshape(2, 3)
    way = last - first
    # control points of C(t) = first + way (t + 1/2)^2: it begins at rest
    falling = torch.cat([first, first, first + 2 * way, found.fit.parameters[6:]])
    fit = replace(found.fit, model=replace(found.fit.model, path=PARABOLA), parameters=falling)
    assert "may-turn-back" in codes(described(replace(found, fit=fit)))


@pytest.mark.parametrize(("exponent", "size"), [(0.05, "5% too large"), (-0.04, "4% too small")])
def test_a_response_that_the_streak_contradicts_is_told(found, exponent, size):
    doubted = Linearity(known=0.0, found=exponent, found_std=0.01)
    result = described(replace(found, linearity=doubted))
    (caution,) = (one for one in result.warnings if one.code == "response-doubted")
    assert size in caution.message
    unsure = Linearity(known=0.0, found=exponent, found_std=0.02)
    assert "response-doubted" not in codes(described(replace(found, linearity=unsure)))
