"""Smooth contours from the edges of many profiles, which err one by one but not on the whole."""

from dataclasses import replace

import torch
from torch import Tensor

from toolkit.errors import StreakError
from toolkit.splines import SIZES, SplineFit, fit_smooth, fit_smooth_columns, up_to
from toolkit.types import Contours, ProfileFit, ProfileFlag

MIN_PROFILES = 8
"""Good profiles between the streak's ends without which no contour can be trusted."""
SHORTEST = 2.6
"""Length of a streak over its width, tip to tip, from which MIN_PROFILES are good, as a rule."""
CONTOUR_POINTS = 100
NORMAL_STD = 1e-4
"""Radians to which the directions of the profiles are followed."""


def mark_profiles(fit: ProfileFit, flag: ProfileFlag, chosen: Tensor) -> ProfileFit:
    """Add a flag to the chosen profiles [B, P] bool."""
    return replace(fit, flags=fit.flags | chosen.to(torch.int64) * int(flag))


def smooth_contours(fit: ProfileFit, picture: int = 0) -> tuple[Contours, ProfileFit]:
    """Fit both outlines by lines, parabolas or splines, whichever the data ask for.

    Source: Caglioti & Giusti 2007, section 5, "Fitting". Deviations: not the two sides are smoothed
    but what errs independently, the middle line and the half width, which needs fewer coefficients;
    their orders are chosen by an information criterion; and single profiles that disagree with
    their neighbours lose their weight and are flagged OUTLIER.

    Args:
        fit: the profiles; flagged ones are ignored.
        picture: which of the B pictures.

    Returns:
        Contours between the first and the last good profile, and the fit with the outliers flagged.

    Raises:
        StreakError: when too few profiles are good.
    """
    good = fit.good[picture]
    check_enough(fit, picture)
    position, covariance = fit.position[picture], fit.covariance[picture]
    middle, width = _middle_and_width(fit, picture)
    is_outlier = good & ((middle.weight == 0) | (width.weight == 0))
    rows = torch.zeros_like(fit.good)
    rows[picture] = is_outlier
    fit = mark_profiles(fit, ProfileFlag.OUTLIER, rows)
    good = fit.good[picture]
    check_enough(fit, picture)
    at = torch.linspace(
        float(position[good].min()),
        float(position[good].max()),
        CONTOUR_POINTS,
        dtype=position.dtype,
    )
    weight = torch.where(good, 1 / covariance[:, 2, 2], 0)
    opacity = fit_smooth(position, fit.opacity[picture][:, None], weight, orders(fit, picture))
    points, tangents = _sides(fit, picture, middle, width, at)
    contours = Contours(
        position=at,
        points=points,
        tangents=tangents,
        std=(middle.std(at) ** 2 + width.std(at) ** 2).sqrt().expand(2, -1),
        opacity=opacity(at)[:, 0],
        order=max(middle.basis.size, width.basis.size),
    )
    return contours, fit


def smooth_parameters(fit: ProfileFit, picture: int = 0) -> Tensor:
    """Give centre, half width, opacity and skew of all profiles, smoothed along the streak, [P, 4].

    Raises:
        StreakError: when too few profiles are good.
    """
    good = fit.good[picture]
    check_enough(fit, picture)
    position, covariance = fit.position[picture], fit.covariance[picture]
    inside = position.clamp(float(position[good].min()), float(position[good].max()))
    variance = covariance.diagonal(dim1=-2, dim2=-1)
    weight = torch.where(good[:, None], 1 / variance, 0)
    weight = torch.cat([weight, good[:, None]], dim=-1)
    values = torch.stack([fit.centre, fit.half_width, fit.opacity, fit.skew], dim=-1)[picture]
    columns = fit_smooth_columns(position, values[..., None], weight, orders(fit, picture))
    return torch.cat([column(inside) for column in columns], dim=-1)


def length_in_widths(fit: ProfileFit, picture: int = 0) -> float:
    """Length of the contours between the ball's first and last image, in widths of the streak."""
    good = fit.good[picture]
    position = fit.position[picture][good]
    return float((position.max() - position.min()) / (2 * fit.half_width[picture][good].median()))


def orders(fit: ProfileFit, picture: int = 0) -> tuple[int, ...]:
    """Give the numbers of coefficients to try: what is finer than the ball cannot be seen."""
    return up_to(3 + length_in_widths(fit, picture), SIZES)


def widen_for_correlation(fit: ProfileFit, picture: int = 0) -> ProfileFit:
    """Widen the covariances where neighbouring profiles err together, as in compressed pictures.

    What many correlated profiles tell together has the variance of independent ones times
    1 + 2 sum of the correlations at all distances. [derived]
    """
    good = fit.good[picture]
    about = smooth_parameters(fit, picture)[good]
    values = torch.stack([fit.centre, fit.half_width, fit.opacity], dim=-1)[picture][good]
    std = fit.covariance[picture][good].diagonal(dim1=-2, dim2=-1).sqrt()
    spacing = float(fit.position[picture].diff().mean())
    reach = max(4, int(fit.half_width[picture][good].median() / spacing))
    factors = [_variance_factor(column, reach) for column in ((values - about[:, :3]) / std).mT]
    scale = torch.tensor(factors, dtype=values.dtype).sqrt()
    covariance = fit.covariance.clone()
    covariance[picture] = scale[:, None] * covariance[picture] * scale
    return replace(fit, covariance=covariance)


def _variance_factor(residual: Tensor, reach: int) -> float:
    """1 + 2 sum of the autocorrelation up to where it is lost in its own noise."""
    residual = residual - residual.mean()
    variance = (residual * residual).mean().clamp_min(1e-12)
    limit = 2 / len(residual) ** 0.5
    factor = 1.0
    for lag in range(1, min(reach, len(residual) // 3)):
        correlation = float((residual[lag:] * residual[:-lag]).mean() / variance)
        if correlation < limit:
            break
        factor += 2 * correlation
    return factor


def check_enough(fit: ProfileFit, picture: int = 0) -> None:
    """Raise `StreakError`, with the most frequent reason, when fewer than MIN_PROFILES are good.

    Profiles clear of the ball's first and last image begin where a streak is twice as long as wide;
    enough of them for a first look are there from SHORTEST on. Down to that length the stated
    uncertainties hold (rendered straight streaks).
    """
    good, flags = fit.good[picture], fit.flags[picture]
    if int(good.sum()) >= MIN_PROFILES:
        return
    counts = {flag: int(((flags & int(flag)) > 0).sum()) for flag in ProfileFlag if flag}
    worst = max(counts, key=lambda flag: counts[flag])
    reasons = {
        ProfileFlag.END: f"{_size(fit, picture)} is too short for profiles clear of the ball's "
        f"first and last image, about {SHORTEST:g} widths are needed, more where its ends "
        "are faint; expose longer",
        ProfileFlag.CLIPPED: "it meets saturated pixels or the picture's border; "
        "expose less or aim again",
        ProfileFlag.LOW_CONTRAST: "its opacity hardly exceeds the noise; "
        "check the ball colour, or expose less long",
        ProfileFlag.NOT_CONVERGED: "its profiles are no semi-ellipses; "
        "check background and ball colour",
        ProfileFlag.AT_BOUND: "its profiles have no plausible width or opacity; "
        "check background and ball colour",
        ProfileFlag.OUTLIER: "its profiles contradict each other; "
        "check that the background fits the shot",
    }
    raise StreakError(
        f"only {int(good.sum())} of {len(good)} profiles are usable, "
        f"{MIN_PROFILES} are needed: {reasons[worst]}"
    )


def _size(fit: ProfileFit, picture: int) -> str:
    """Say how long and wide the streak is, from tip to tip."""
    is_seen = fit.good[picture] if bool(fit.good[picture].any()) else fit.samples[picture] > 0
    position, half_width = fit.position[picture], fit.half_width[picture][is_seen]
    length, width = float(position[-1] - position[0]), 2 * float(half_width.median())
    widths = length / max(width, 1)
    return f"a streak {length:.0f} px long and {width:.0f} px wide ({widths:.1f} widths)"


def _middle_and_width(fit: ProfileFit, picture: int) -> tuple[SplineFit, SplineFit]:
    """Smooth the centre points and, of an order of its own, the half width along the axis."""
    position, covariance = fit.position[picture], fit.covariance[picture]
    sizes = orders(fit, picture)
    smooth = [
        fit_smooth(
            position,
            values[picture],
            torch.where(fit.good[picture], 1 / covariance[:, i, i].clamp_min(1e-8), 0),
            sizes,
        )
        for i, values in enumerate((fit.middle, fit.half_width[..., None]))
    ]
    return smooth[0], smooth[1]


def _sides(
    fit: ProfileFit, picture: int, middle: SplineFit, width: SplineFit, at: Tensor
) -> tuple[Tensor, Tensor]:
    """Points and unit tangents of the left and the right contour, both [2, N, 2]."""
    position, normals = fit.position[picture], fit.normal[picture]
    square = fit_smooth(position, normals, fit.good[picture] / NORMAL_STD**2, orders(fit, picture))
    normal, half_width = square(at), width(at)
    growth = width(at, 1) * normal + half_width * square(at, 1)
    points = [middle(at) + side * half_width * normal for side in (-1, 1)]
    tangents = [_unit(middle(at, 1) + side * growth) for side in (-1, 1)]
    return torch.stack(points), torch.stack(tangents)


def _unit(vectors: Tensor) -> Tensor:
    length: Tensor = torch.linalg.vector_norm(vectors, dim=-1, keepdim=True)
    return vectors / length
