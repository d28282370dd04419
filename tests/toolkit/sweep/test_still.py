from types import SimpleNamespace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit import measure
from toolkit.sweep.likelihood import compare
from toolkit.sweep.misfit import look_for_misfit
from toolkit.sweep.paths import PARABOLA
from toolkit.sweep.still import looks_still, speed_limit

QUIET = SimpleNamespace(factor=1.0)


def travel_of(seen):
    return float((seen.points(2)[1] - seen.points(2)[0]).norm()) / (2 * seen.scene.ball_radius)


@pytest.fixture(scope="module")
def still(streak):
    return streak(length_widths=0.01, width_px=20)


def test_a_ball_that_hardly_moves_may_stand_still(streak):
    seen = streak(length_widths=0.01)
    for seed in range(4):
        fit = seen.again(seed).fit()
        assert looks_still(fit, look_for_misfit(fit))


@pytest.mark.parametrize("length", [0.3, 1.0])
def test_a_ball_that_moves_does_not(streak, length):
    fit = streak(length_widths=length, width_px=20).fit()
    assert not looks_still(fit, look_for_misfit(fit))


def test_only_a_straight_path_is_asked(still):
    assert not looks_still(still.fit(PARABOLA), QUIET)


@pytest.mark.parametrize("seed", range(2))
def test_the_limit_holds_the_speed_and_is_no_wild_guess(still, seed):
    fit = still.again(seed).fit()
    limit = speed_limit(fit, look_for_misfit(fit))
    width = 2 * still.scene.ball_radius
    assert limit.any_way >= limit.across
    # half a width would show to anybody
    assert travel_of(still) * width < limit.across < 0.4 * width
    # towards the camera it shows as growth alone, 2 R in 50 R being one part in 25
    assert limit.any_way < 40 * width


def test_a_misfit_raises_the_limit(still):
    fit = still.fit()
    plain, doubted = speed_limit(fit, QUIET), speed_limit(fit, SimpleNamespace(factor=9.0))
    assert doubted.across > plain.across


def test_motions_below_the_limit_explain_the_picture_and_those_above_do_not(still):
    """The profile likelihood itself: all else fitted, at both sides of the limit."""
    fit = still.fit()
    limit = speed_limit(fit, QUIET).across
    position, _ = fit.state()
    costs = []
    for speed in (0.02 * still.scene.ball_radius, 0.7 * limit, 1.6 * limit):
        best = None
        for angle in torch.linspace(0, torch.pi, 5)[:-1]:
            side = torch.stack([angle.cos(), angle.sin(), torch.zeros(())]).double()
            x = fit.parameters.clone()
            x[:3], x[3:6] = position - side * speed / 2, position + side * speed / 2
            cost = fit_rest(fit, x)
            best = cost if best is None else min(best, cost)
        costs.append(best - fit.seen.cost)
    at_rest, below, above = costs
    assert below < max(at_rest, 0) + 2.71 + 1 < above


def fit_rest(fit, x):
    """Least cost over all but the displacement, by steps of Gauss and Newton."""
    free = torch.eye(len(x), dtype=torch.float64)[:, 6:]
    shift = torch.zeros(len(x), 3, dtype=torch.float64)
    shift[:3], shift[3:6] = torch.eye(3), torch.eye(3)
    basis = torch.cat([shift, free], dim=1)
    for _ in range(6):
        seen = compare(fit.model, x, fit.pixels)
        step = torch.linalg.solve(basis.mT @ seen.information @ basis, -basis.mT @ seen.gradient)
        x = x + basis @ step
    return compare(fit.model, x, fit.pixels).cost


def test_the_measurement_states_the_limit_and_no_velocity(still):
    scene = still.scene
    result = measure(
        still.shot.image,
        still.shot.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=Uniform(colour=scene.appearance.colour),
    )
    assert "may-stand-still" in {caution.code for caution in result.warnings}
    assert result.velocity_m_s is result.speed_m_s is result.speed_std_m_s is None
    assert result.state_covariance is result.direction is result.sign is None
    assert result.bound.speed_std_m_s is None
    assert result.speed_upper_m_s > float(still.shot.velocity.norm())
    error = torch.tensor(result.position_m) - still.shot.position
    assert (error.abs() < 4 * torch.tensor(result.position_std_m)).all()
