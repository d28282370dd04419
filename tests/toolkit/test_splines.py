import numpy as np
import pytest
import torch
from scipy.interpolate import BSpline

from toolkit.splines import SplineBasis, fit_smooth, fit_spline

SIZES = (1, 2, 3, 4, 5, 7, 12)
START, STOP = -3.0, 9.0


def by_scipy(size):
    """The same clamped basis, continued as polynomials."""
    degree = min(size - 1, 3)
    inner = np.linspace(START, STOP, size - degree + 1)
    knots = np.concatenate([[START] * degree, inner, [STOP] * degree])
    return BSpline(knots, np.eye(size), degree, extrapolate=True)


@pytest.mark.parametrize(("size", "derivative"), [(k, d) for k in SIZES for d in range(min(k, 4))])
def test_the_basis_and_its_derivatives_agree_with_scipy(size, derivative):
    x = np.linspace(START - 2, STOP + 2, 141)
    expected = by_scipy(size)(x, derivative)
    found = SplineBasis(start=START, stop=STOP, size=size)(torch.from_numpy(x), derivative)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-10 * np.abs(expected).max() + 1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_the_basis_adds_up_to_one_even_outside(size):
    x = torch.linspace(START - 3, STOP + 3, 50, dtype=torch.float64)
    total = SplineBasis(start=START, stop=STOP, size=size)(x).sum(-1)
    assert torch.allclose(total, torch.ones_like(total), atol=1e-10)


def test_the_basis_keeps_the_shape_and_type_of_its_argument():
    basis = SplineBasis(start=0.0, stop=1.0, size=6)
    assert basis(torch.zeros(4, 5, 2, dtype=torch.float64)).shape == (4, 5, 2, 6)
    assert basis(torch.tensor(0.5, dtype=torch.float64)).shape == (6,)
    assert basis(torch.zeros(2)).dtype == torch.float32


@pytest.mark.parametrize(("size", "degree"), [(1, 0), (2, 1), (3, 2), (4, 3), (9, 3)])
def test_degrees(size, degree):
    assert SplineBasis(start=0.0, stop=1.0, size=size).degree == degree


@pytest.mark.parametrize("size", [2, 3, 4, 6])
def test_fit_spline_agrees_with_lstsq_and_its_covariance(size):
    generator = torch.Generator().manual_seed(size)
    x = torch.linspace(0, 5, 40, dtype=torch.float64)
    values = torch.randn(40, 2, generator=generator, dtype=torch.float64)
    weight = 0.5 + torch.rand(40, generator=generator, dtype=torch.float64)
    basis = SplineBasis(start=0.0, stop=5.0, size=size)
    coefficients, inverse = fit_spline(basis, x, values, weight)
    design = basis(x) * weight.sqrt()[:, None]
    expected = torch.linalg.lstsq(design, values * weight.sqrt()[:, None]).solution
    assert torch.allclose(coefficients, expected, atol=1e-9)
    assert torch.allclose(inverse, torch.linalg.inv(design.T @ design), rtol=1e-9)


def test_fit_spline_ignores_what_has_no_weight():
    x = torch.linspace(0, 5, 40, dtype=torch.float64)
    values = (2 - 0.3 * x)[:, None].clone()
    values[7] = 1e3
    weight = torch.ones(40, dtype=torch.float64)
    weight[7] = 0
    basis = SplineBasis(start=0.0, stop=5.0, size=2)
    coefficients, _ = fit_spline(basis, x, values, weight)
    assert torch.allclose(coefficients[:, 0], torch.tensor([2.0, 0.5]).double(), atol=1e-9)


def noisy(curve, seed, outliers=0.0, std=0.1, count=200, dimensions=1):
    """Samples of a curve on 0..10, of which a share is grossly wrong, and who is."""
    generator = np.random.default_rng([seed, 3])
    x = np.linspace(0, 10, count)
    values = np.stack([curve(x)] * dimensions, axis=-1)
    values += std * generator.standard_normal(values.shape)
    wrong = generator.random(count) < outliers
    values[wrong] += generator.choice([-1, 1], (wrong.sum(), 1)) * generator.uniform(
        10 * std, 60 * std, (wrong.sum(), 1)
    )
    tensors = [torch.from_numpy(v) for v in (x, values, np.full(count, 1 / std**2))]
    return *tensors, torch.from_numpy(wrong)


CURVES = {
    "line": (lambda x: 1 + 0.4 * x, 2),
    "parabola": (lambda x: 0.1 * x * x - x, 3),
    "cubic": (lambda x: 0.02 * (x - 5) ** 3, 4),
}


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("dimensions", [1, 2])
def test_the_order_is_the_one_the_data_ask_for(name, dimensions):
    curve, order = CURVES[name]
    chosen = [
        fit_smooth(*noisy(curve, seed, dimensions=dimensions)[:3]).basis.size for seed in range(20)
    ]
    assert min(chosen) == order
    # strict between a line and all else; Akaike takes a needless coefficient in one of six
    assert chosen.count(order) >= (19 if order == 2 else 13)
    assert max(chosen) <= order + 3


def test_a_wiggle_gets_a_flexible_spline():
    x, values, weight, _ = noisy(lambda x: np.sin(1.5 * x), seed=0)
    fit = fit_smooth(x, values, weight)
    assert fit.basis.size >= 8
    assert (fit(x)[:, 0] - torch.sin(1.5 * x)).abs().max() < 0.1


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("seed", range(4))
def test_outliers_of_15_percent_change_nothing(name, seed):
    curve, _ = CURVES[name]
    x, values, weight, wrong = noisy(curve, seed, outliers=0.15, dimensions=2)
    fit = fit_smooth(x, values, weight)
    truth = torch.from_numpy(curve(x.numpy()))[:, None]
    assert (fit(x) - truth).abs().max() < 0.12  # noise of 0.1 each, 200 samples
    assert (fit.weight[wrong] == 0).all()
    assert (fit.weight[~wrong] > 0).double().mean() > 0.98


def test_clean_data_keep_nearly_all_their_weight():
    x, values, weight, _ = noisy(CURVES["line"][0], seed=1)
    fit = fit_smooth(x, values, weight)
    assert float((fit.weight / weight).mean()) > 0.85
    assert (fit.weight <= weight).all()


def test_the_curve_errs_by_its_own_standard_deviation():
    curve, _ = CURVES["parabola"]
    errors = []
    for seed in range(60):
        x, values, weight, _ = noisy(curve, seed)
        fit = fit_smooth(x, values, weight)
        errors.append((fit(x)[:, 0] - torch.from_numpy(curve(x.numpy()))) / fit.std(x))
    assert 0.8 < float(torch.stack(errors).pow(2).mean().sqrt()) < 1.25


def test_weights_below_the_true_noise_do_not_make_a_wiggle_of_a_line():
    x, values, weight, _ = noisy(CURVES["line"][0], seed=2)
    assert fit_smooth(x, values, 25 * weight).basis.size == 2


def test_the_derivative_is_that_of_the_curve():
    x, values, weight, _ = noisy(lambda x: np.sin(x), seed=0)
    fit = fit_smooth(x, values, weight)
    step = 1e-5
    slope = (fit(x + step) - fit(x - step)) / (2 * step)
    assert torch.allclose(fit(x, 1), slope, atol=1e-7)


def test_few_points_get_few_coefficients():
    x, values, weight, _ = noisy(lambda x: np.sin(2 * x), seed=0, count=13)
    assert fit_smooth(x, values, weight).basis.size == 2


def test_ignored_points_do_not_stretch_the_interval():
    x, values, weight, _ = noisy(CURVES["line"][0], seed=0)
    weight[:20] = 0
    values[:20] = torch.nan
    values = values.nan_to_num(nan=1e6)
    fit = fit_smooth(x, values, weight)
    assert fit.basis.start == float(x[20])
    assert (fit.weight[:20] == 0).all()


def test_only_the_sizes_offered_are_chosen():
    x, values, weight, _ = noisy(lambda x: np.sin(1.5 * x), seed=0)
    assert fit_smooth(x, values, weight, (1, 2, 3)).basis.size in (1, 2, 3)
    constant = noisy(lambda x: 0 * x + 4, seed=0)
    assert fit_smooth(*constant[:3], (1, 2, 3)).basis.size == 1
