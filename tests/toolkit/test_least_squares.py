import math

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from toolkit.least_squares import invert_information, minimise

T = np.linspace(0, 4, 25)


def decays(truth, noise, seed):
    """Noisy samples of a exp(-b t) + c for each row of truth [E, 3]."""
    generator = np.random.default_rng(seed)
    a, b, c = truth[:, :, None].transpose(1, 0, 2)
    clean = a * np.exp(-b * T) + c
    return torch.from_numpy((clean + noise * generator.standard_normal(clean.shape)) / noise), noise


def decay_problem(data, noise):
    t = torch.from_numpy(T)

    def problem(x, rows):
        a, b, c = x[:, :, None].unbind(1)
        fall = torch.exp(-b * t)
        J = torch.stack([fall, -a * t * fall, torch.ones_like(fall)], dim=-1)
        return (a * fall + c) / noise - data[rows], J / noise

    return problem


def random_decays(count, seed=0, noise=0.02):
    generator = np.random.default_rng([seed, 1])
    truth = generator.uniform([0.5, 0.4, -0.5], [2.0, 2.0, 0.5], (count, 3))
    data, noise = decays(truth, noise, seed)
    start = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64).expand(count, 3)
    return data, noise, start


def by_scipy(data, noise, start, **options):
    def residual(x):
        return (x[0] * np.exp(-x[1] * T) + x[2]) / noise - data.numpy()

    return least_squares(residual, start.numpy(), xtol=1e-13, ftol=1e-13, gtol=1e-13, **options)


def test_it_agrees_with_scipy():
    data, noise, start = random_decays(12)
    solution = minimise(decay_problem(data, noise), start, tolerance=1e-9)
    assert solution.converged.all()
    for element in range(12):
        expected = by_scipy(data[element], noise, start[element])
        np.testing.assert_allclose(solution.parameters[element], expected.x, rtol=1e-6, atol=1e-8)
        assert float(solution.cost[element]) == pytest.approx(2 * expected.cost, rel=1e-9)
        np.testing.assert_allclose(
            solution.information[element], expected.jac.T @ expected.jac, rtol=1e-5
        )


def test_shapes():
    data, noise, start = random_decays(5)
    solution = minimise(decay_problem(data, noise), start)
    assert solution.parameters.shape == (5, 3)
    assert solution.cost.shape == (5,)
    assert solution.gradient.shape == (5, 3)
    assert solution.information.shape == (5, 3, 3)
    assert solution.covariance.shape == (5, 3, 3)
    assert solution.converged.dtype == torch.bool
    assert 1 <= solution.iterations <= 30


def test_the_start_is_left_alone():
    data, noise, start = random_decays(3)
    before = start.clone()
    minimise(decay_problem(data, noise), start)
    assert torch.equal(start, before)


def test_a_linear_problem_takes_one_step():
    generator = torch.Generator().manual_seed(0)
    A = torch.randn(4, 20, 3, generator=generator, dtype=torch.float64)
    y = torch.randn(4, 20, generator=generator, dtype=torch.float64)

    def problem(x, rows):
        return (A[rows] @ x[..., None])[..., 0] - y[rows], A[rows]

    solution = minimise(problem, torch.zeros(4, 3, dtype=torch.float64))
    expected = torch.linalg.lstsq(A, y[..., None]).solution[..., 0]
    assert torch.allclose(solution.parameters, expected, atol=1e-8)
    assert solution.gradient.abs().max() < 1e-5
    assert solution.iterations <= 5


def test_the_covariance_is_the_inverse_and_the_spread_of_the_answers():
    truth = np.tile([1.0, 1.0, 0.2], (600, 1))
    data, noise = decays(truth, 0.02, seed=3)
    start = torch.from_numpy(truth).clone()
    solution = minimise(decay_problem(data, noise), start, tolerance=1e-4)
    identity = solution.covariance @ solution.information
    assert torch.allclose(identity, torch.eye(3).double().expand(600, 3, 3), atol=1e-8)
    spread = torch.cov(solution.parameters.T)
    predicted = solution.covariance.mean(0)
    assert torch.allclose(spread.diagonal(), predicted.diagonal(), rtol=0.2)


def test_an_element_alone_gives_the_same_as_among_300():
    data, noise, start = random_decays(300)
    together = minimise(decay_problem(data, noise), start)
    for element in (0, 17, 299):
        one = slice(element, element + 1)
        alone = minimise(decay_problem(data[one], noise), start[one])
        assert torch.allclose(alone.parameters[0], together.parameters[element], rtol=1e-12)
        assert torch.allclose(alone.covariance[0], together.covariance[element], rtol=1e-9)
        assert bool(alone.converged[0]) == bool(together.converged[element])


@pytest.mark.parametrize("poison", [torch.nan, torch.inf])
def test_a_spoiled_element_spoils_no_other(poison):
    data, noise, start = random_decays(6)
    clean = minimise(decay_problem(data, noise), start)
    spoiled = data.clone()
    spoiled[2, 5] = poison
    solution = minimise(decay_problem(spoiled, noise), start)
    others = torch.arange(6) != 2
    assert torch.equal(solution.parameters[others], clean.parameters[others])
    assert torch.equal(solution.converged[others], clean.converged[others])
    assert torch.isfinite(solution.parameters[2]).all()


def test_an_element_that_says_nothing_about_a_parameter_spoils_no_other():
    data, noise, start = random_decays(6)
    inner = decay_problem(data, noise)

    def problem(x, rows):
        residual, J = inner(x, rows)
        is_blind = (rows == 3)[:, None]
        J = torch.cat([J[..., :2], torch.where(is_blind, 0, J[..., 2])[..., None]], dim=-1)
        return residual, J

    clean = minimise(inner, start)
    solution = minimise(problem, start)
    others = torch.arange(6) != 3
    assert torch.equal(solution.parameters[others], clean.parameters[others])
    assert float(solution.parameters[3, 2]) == float(start[3, 2])
    assert torch.isinf(solution.covariance[3].diagonal()).any()
    assert torch.isfinite(solution.covariance[others]).all()


def test_bounds_hold_and_agree_with_scipy():
    data, noise, start = random_decays(8, seed=2)
    lower = torch.tensor([0.0, 0.9, -0.2], dtype=torch.float64)
    upper = torch.tensor([1.6, 1.5, 0.3], dtype=torch.float64)
    solution = minimise(
        decay_problem(data, noise), start, lower=lower, upper=upper, max_iterations=200
    )
    assert (solution.parameters >= lower).all()
    assert (solution.parameters <= upper).all()
    for element in range(8):
        expected = by_scipy(
            data[element], noise, start[element], bounds=(lower.numpy(), upper.numpy())
        )
        is_free = bool(
            ((expected.x > lower.numpy() + 1e-6) & (expected.x < upper.numpy() - 1e-6)).all()
        )
        if is_free:
            np.testing.assert_allclose(solution.parameters[element], expected.x, atol=1e-5)
        # where a bound is met the step is clipped, not projected: no worse than the start
        begin = float(minimise(decay_problem(data, noise), start, max_iterations=0).cost[element])
        assert 2 * expected.cost <= float(solution.cost[element]) * (1 + 1e-9) <= begin


def test_huber_agrees_with_scipy():
    data, noise, start = random_decays(6, seed=5)
    data[:, ::6] += 15  # gross errors in every sixth sample
    solution = minimise(
        decay_problem(data, noise), start, huber=1.5, tolerance=1e-9, max_iterations=300
    )
    assert solution.converged.all()
    for element in range(6):
        expected = by_scipy(data[element], noise, start[element], loss="huber", f_scale=1.5)
        np.testing.assert_allclose(solution.parameters[element], expected.x, rtol=2e-4, atol=2e-4)
        assert float(solution.cost[element]) == pytest.approx(2 * expected.cost, rel=1e-6)


def test_huber_bounds_the_pull_of_a_gross_error():
    data, noise, start = random_decays(1)
    clean = minimise(decay_problem(data, noise), start).parameters
    data[0, 10] += 1000
    robust = minimise(decay_problem(data, noise), start, huber=3.0, max_iterations=100).parameters
    plain = minimise(decay_problem(data, noise), start, max_iterations=100).parameters
    std = minimise(decay_problem(data, noise), start, max_iterations=0).covariance[0, 2, 2].sqrt()
    assert (robust - clean)[0, 2].abs() < 3 * std
    assert (plain - clean)[0, 2].abs() > 10 * std


def test_without_gross_errors_huber_changes_nothing():
    data, noise, start = random_decays(3)
    solutions = [
        minimise(decay_problem(data, noise), start, huber=huber) for huber in (50.0, math.inf)
    ]
    # the start is far off, so that the ways there differ but not the ends
    assert torch.allclose(solutions[0].parameters, solutions[1].parameters, atol=1e-6)


def test_running_out_of_iterations_is_told_per_element():
    data, noise, start = random_decays(4)
    settled = minimise(decay_problem(data, noise), start).parameters
    begin = start.clone()
    begin[1] = settled[1]
    solution = minimise(decay_problem(data, noise), begin, max_iterations=1)
    assert solution.converged.tolist() == [False, True, False, False]
    assert solution.iterations == 1


def test_no_iterations_evaluate_the_start():
    data, noise, start = random_decays(2)
    solution = minimise(decay_problem(data, noise), start, max_iterations=0)
    residual, J = decay_problem(data, noise)(start, torch.arange(2))
    assert torch.equal(solution.parameters, start)
    assert torch.allclose(solution.cost, (residual**2).sum(-1))
    assert torch.allclose(solution.gradient, (J.mT @ residual[..., None])[..., 0])
    assert not solution.converged.any()


def test_the_cost_never_rises():
    data, noise, start = random_decays(20, seed=8)
    far = start + torch.tensor([3.0, 2.0, 1.0])
    costs = torch.stack(
        [minimise(decay_problem(data, noise), far, max_iterations=n).cost for n in range(12)]
    )
    assert (costs.diff(dim=0) <= 0).all()


def test_invert_information_on_badly_scaled_matrices():
    scale = torch.tensor([1e-8, 1.0, 1e8], dtype=torch.float64)
    well = torch.tensor([[2.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 3.0]], dtype=torch.float64)
    inverse = invert_information(well * scale[:, None] * scale)
    assert torch.allclose(inverse * scale[:, None] * scale, torch.linalg.inv(well), rtol=1e-12)


def test_invert_information_of_singular_matrices_is_infinite_there_only():
    batch = torch.stack([torch.eye(2), torch.ones(2, 2), 4 * torch.eye(2)]).double()
    batch[1, 1, 1] = 1 - 1e-9  # not positive definite
    inverse = invert_information(batch)
    assert torch.equal(inverse[0], torch.eye(2).double())
    assert torch.equal(inverse[2], torch.eye(2).double() / 4)
    assert torch.isinf(inverse[1].diagonal()).all()
    assert float(inverse[1, 0, 1]) == 0
