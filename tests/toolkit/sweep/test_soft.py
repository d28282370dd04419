import math

import pytest
import torch

from toolkit.sweep.soft import HIGH, LOW, density, soft_ramp, soft_root

PLACES = torch.cat(
    [torch.linspace(LOW - 1, HIGH + 1, 57), torch.tensor([20.0, 300.0, 1e5])]
).double()


def normal_mean(function, x):
    """Mean of function(x + z, z) over z ~ N(0, 1), where x + z > 0, by brute force.

    With x + z = y^2 no integrand has a singular slope.
    """
    low, high = (x - 9).clamp_min(0).sqrt(), (x + 9).clamp_min(1e-9).sqrt()
    share = (torch.arange(20_000, dtype=torch.float64) + 0.5) / 20_000
    y = low[:, None] + (high - low)[:, None] * share
    z = y * y - x[:, None]
    weight = torch.exp(-z * z / 2) / math.sqrt(2 * math.pi) * 2 * y
    return (function(y * y, z) * weight).mean(-1) * (high - low)


def test_the_root_is_the_mean_of_roots():
    root, _, _, _ = soft_root(PLACES)
    expected = normal_mean(lambda y, _: y.sqrt(), PLACES)
    assert torch.allclose(root, expected, rtol=2e-5, atol=1e-5)


def test_its_slope_is_the_mean_of_slopes():
    _, slope, _, _ = soft_root(PLACES)
    expected = normal_mean(lambda y, _: 0.5 / y.sqrt(), PLACES)
    assert torch.allclose(slope, expected, rtol=1e-4, atol=1e-5)


def test_its_bend_is_the_mean_of_slopes_times_z_squared():
    _, _, bend, turn = soft_root(PLACES)
    expected = normal_mean(lambda y, z: z * z * 0.5 / y.sqrt(), PLACES)
    assert torch.allclose(bend, expected, rtol=2e-3, atol=1e-4)
    step = 0.05
    difference = (soft_root(PLACES + step)[2] - soft_root(PLACES - step)[2]) / (2 * step)
    assert torch.allclose(turn, difference, rtol=0.02, atol=3e-3)


def test_table_and_series_meet():
    sides = torch.tensor([HIGH - 1e-9, HIGH + 1e-9], dtype=torch.float64)
    for values, limit in zip(soft_root(sides), (2e-5, 1e-4, 2e-3, 0.05), strict=True):
        assert float(values[1] / values[0]) == pytest.approx(1, abs=limit)


def test_nothing_is_left_far_outside():
    for values in soft_root(torch.tensor([-40.0, -1e6]).double()):
        assert (values.abs() < 1e-6).all()


def test_the_ramp_is_the_mean_of_ramps_and_its_slopes_follow():
    ramp, share, dense = soft_ramp(PLACES)
    assert torch.allclose(ramp, normal_mean(lambda y, _: y, PLACES), rtol=1e-6, atol=1e-9)
    ones = normal_mean(lambda y, _: torch.ones_like(y), PLACES)
    near = PLACES < HIGH  # beyond, the share is 1 to nine digits
    assert torch.allclose(share, ones, rtol=1e-6, atol=2e-9)
    assert torch.allclose(dense[near], density(PLACES[near]))
    assert (dense[~near] == 0).all()


def test_no_places_have_no_values():
    none = torch.zeros(0, dtype=torch.float64)
    assert all(len(values) == 0 for values in (*soft_root(none), *soft_ramp(none)))
