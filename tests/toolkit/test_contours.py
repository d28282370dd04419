"""Smooth contours from fitted profiles."""

from dataclasses import replace

import pytest
import torch

from toolkit import ProfileFlag, StreakError
from toolkit.contours import (
    mark_profiles,
    smooth_contours,
    smooth_parameters,
    widen_for_correlation,
)
from toolkit.types import ProfileFit

COUNT, WIDTH, STD = 160, 15.0, 0.3


def make_fit(centre=None, half_width=None, seed=0):
    """Profiles 1 px apart along the x axis, with independent noise of 0.3 px."""
    generator = torch.Generator().manual_seed(seed)
    position = torch.arange(COUNT, dtype=torch.float64)

    def noisy(values, std):
        return (values + std * torch.randn(COUNT, generator=generator, dtype=torch.float64))[None]

    zero = torch.zeros(COUNT, dtype=torch.float64)
    return ProfileFit(
        origin=torch.stack([position, zero], dim=-1)[None],
        normal=torch.tensor([0.0, 1.0], dtype=torch.float64).expand(1, COUNT, 2),
        position=position[None],
        centre=noisy(zero if centre is None else centre(position), STD),
        half_width=noisy(zero + WIDTH if half_width is None else half_width(position), STD),
        opacity=noisy(zero + 0.2, 0.002),
        skew=zero[None],
        covariance=torch.diag(torch.tensor([STD, STD, 0.002], dtype=torch.float64) ** 2).expand(
            1, COUNT, 3, 3
        ),
        chi2_per_dof=torch.ones(1, COUNT, dtype=torch.float64),
        flags=torch.zeros(1, COUNT, dtype=torch.int64),
        blur=torch.tensor([0.8], dtype=torch.float64),
        samples=torch.full((1, COUNT), 100),
        iterations=1,
    )


def test_straight_edges_make_lines():
    contours, _ = smooth_contours(make_fit(half_width=lambda x: WIDTH + 0.01 * x))
    assert contours.order == 2
    left, right = contours.points
    truth = WIDTH + 0.01 * contours.position
    assert (right[:, 1] - truth).abs().max() < 0.2
    assert (left[:, 1] + truth).abs().max() < 0.2
    assert torch.allclose(
        contours.tangents[..., 0], torch.ones_like(contours.tangents[..., 0]), atol=1e-3
    )


def test_bent_edges_make_curves():
    contours, _ = smooth_contours(make_fit(centre=lambda x: 0.002 * (x - 80) ** 2))
    assert contours.order >= 3
    truth = 0.002 * (contours.position - 80) ** 2 + WIDTH
    assert (contours.points[1, :, 1] - truth).abs().max() < 0.3


def test_the_stated_deviation_is_that_of_the_contour():
    ends = [smooth_contours(make_fit(seed=seed))[0] for seed in range(60)]
    scatter = torch.stack([c.points[1, :, 1] for c in ends]).std(0)
    stated = torch.stack([c.std[1] for c in ends]).mean(0)
    assert (scatter / stated).median() == pytest.approx(1.0, abs=0.25)


def test_profiles_that_contradict_their_neighbours_are_flagged():
    fit = make_fit()
    centre = fit.centre.clone()
    centre[0, 70:74] += 8
    contours, marked = smooth_contours(replace(fit, centre=centre))
    assert ((marked.flags[0, 70:74] & int(ProfileFlag.OUTLIER)) > 0).all()
    assert (marked.flags[0] != 0).sum() <= 8
    assert contours.points[..., 1].abs().max() < WIDTH + 0.6


def test_flagged_profiles_are_left_out():
    fit = make_fit()
    centre = fit.centre.clone()
    centre[0, :40] += 50
    rows = torch.zeros(1, COUNT, dtype=torch.bool)
    rows[0, :40] = True
    fit = mark_profiles(replace(fit, centre=centre), ProfileFlag.END, rows)
    smooth = smooth_parameters(fit)
    assert smooth[60:, 0].abs().max() < 0.3


def test_too_few_profiles_are_refused_with_the_reason():
    rows = torch.ones(1, COUNT, dtype=torch.bool)
    rows[0, :5] = False
    fit = mark_profiles(make_fit(), ProfileFlag.CLIPPED, rows)
    with pytest.raises(StreakError, match=r"only 5 of 160 .* saturated"):
        smooth_contours(fit)


def test_independent_profiles_keep_their_covariance_and_correlated_ones_do_not():
    independent = make_fit()
    widened = widen_for_correlation(independent)
    assert (widened.covariance[0, 0, 0, 0] / STD**2).item() == pytest.approx(1, abs=0.35)
    fit = make_fit(seed=3)
    smooth = torch.nn.functional.avg_pool1d(fit.centre, 9, stride=1, padding=4) * 3
    ratio = widen_for_correlation(replace(fit, centre=smooth)).covariance[0, 0, 0, 0] / STD**2
    assert 3 < ratio < 14  # 9 neighbours share each error
