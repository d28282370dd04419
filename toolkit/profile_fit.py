"""Fitting the semi-ellipse to every profile at once."""

from dataclasses import replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.least_squares import Problem, Solution, invert_information, minimise
from toolkit.semi_ellipse import semi_ellipse_and_J, start_from_moments
from toolkit.types import ProfileFit, ProfileFlag, Profiles

START_BLUR = 0.9
"""px, of pixel, interpolation and a sharp lens together."""
BLUR_RANGE = (0.4, 4.0)
"""px."""
BLUR_ROUNDS = 3
"""Updates of the blur all profiles of a picture share; each is a Newton step, so that three are plenty."""
MAX_ITERATIONS = 15
OUTLIER_SAMPLE = 3.0
"""Standard deviations beyond which a sample (dirt, text, a reflection) loses its pull."""
MIN_SIGNIFICANCE = 3.0
"""Opacity over its own standard deviation below which a profile says nothing."""
MIN_VALID_SHARE = 0.8
"""Share of a profile's samples that must be usable."""


def fit_profiles(
    profiles: Profiles,
    estimator: AlphaEstimator,
    *,
    half_width: Tensor | None = None,
    tolerance: float = 0.02,
    blur_rounds: int = BLUR_ROUNDS,
) -> ProfileFit:
    """Fit centre, half width and opacity of every profile by batched Gauss-Newton.

    The blur is one number a picture, found by the same least squares with every profile's own parameters projected out.
    Source: Caglioti & Giusti 2007, section 3.2. Deviation: the fit compares composited signals, weighed by their noise, not alpha
    values, which serves every estimator; a robust loss bounds the pull of single samples.

    Args:
        profiles: B pictures with P profiles of S samples each.
        estimator: says what the ball alone would show.
        half_width: a rough half width [B] px that bounds the first guess.
        tolerance: steps below this share of each standard deviation end a profile's search.
        blur_rounds: how often the blur is improved.

    Returns:
        ProfileFit; profiles that failed carry flags.
    """
    pictures = len(profiles.position)
    whitening = profiles.valid[..., None] / profiles.variance.clamp_min(1e-14).sqrt()
    start = _first_guess(profiles, estimator, half_width)
    reach = float(profiles.offset.max())
    lower = torch.tensor([-reach, 0.5, 0.0], dtype=torch.float64)
    upper = torch.tensor([reach, reach, 1.5], dtype=torch.float64)
    blur = torch.full((pictures,), START_BLUR, dtype=torch.float64)
    iterations = 0
    for _ in range(blur_rounds):
        problem = _problem(profiles, estimator, whitening, blur)
        solution = minimise(
            lambda x, rows, problem=problem: _own_parameters(problem(x, rows)),
            start,
            lower=lower,
            upper=upper,
            huber=OUTLIER_SAMPLE,
            tolerance=tolerance,
            max_iterations=MAX_ITERATIONS,
        )
        start = solution.parameters
        iterations += solution.iterations
        new_blur = _improve_blur(problem, start, blur, torch.ones_like(solution.converged))
        settled = bool(((new_blur - blur).abs() < 0.02).all())
        if settled:
            break
        blur = new_blur
    return _finish(profiles, solution, blur, iterations)


def refine_profiles(
    profiles: Profiles, estimator: AlphaEstimator, fit: ProfileFit, about: Tensor
) -> ProfileFit:
    """Fit every profile again by one linear step from where its neighbours say it should lie.

    A single noisy profile is fitted with a bias of second order in its noise, always outwards, and weighs itself by what it found: neither
    averages out over the streak. A step that is linear in the noise, from parameters smoothed over many profiles and weighed by them, has
    neither fault. The background is noisy as well, and enters both residual and Jacobian; a Jacobian from the smoothed background keeps the two
    uncorrelated, without which every streak comes out wider. The blur takes its step from here too. [derived]

    Args:
        profiles: what was fitted.
        estimator: says what the ball alone would show.
        fit: the fit so far; profiles flagged in it, but for NOT_CONVERGED, are handed back as they are.
        about: smooth (centre, half width, opacity) of all profiles [B, P, 3].
    """
    whitening = profiles.valid[..., None] / profiles.variance.clamp_min(1e-14).sqrt()
    rows = about.reshape(-1, 3)
    # a step that needs no search takes those along whose search did not settle
    is_open = (fit.flags & ~int(ProfileFlag.NOT_CONVERGED)) == 0
    good = is_open.flatten()
    smooth = profiles.smooth_ground
    problem = _problem(profiles, estimator, whitening, fit.blur, smooth)
    blur = _improve_blur(problem, rows, fit.blur, good)
    problem = _problem(profiles, estimator, whitening, blur, smooth)
    solution = minimise(
        lambda x, elements: _own_parameters(problem(x, elements)),
        rows,
        huber=OUTLIER_SAMPLE,
        max_iterations=0,
    )
    step = solution.covariance @ solution.gradient[..., None]
    moved = replace(solution, parameters=torch.where(good[:, None], rows - step[..., 0], rows))
    refined = _finish(profiles, moved, blur, fit.iterations + 1)
    keep = is_open
    return replace(
        refined,
        centre=torch.where(keep, refined.centre, fit.centre),
        half_width=torch.where(keep, refined.half_width, fit.half_width),
        opacity=torch.where(keep, refined.opacity, fit.opacity),
        covariance=torch.where(keep[..., None, None], refined.covariance, fit.covariance),
        flags=torch.where(keep, refined.flags & ~int(ProfileFlag.NOT_CONVERGED), fit.flags),
    )


def _finish(profiles: Profiles, solution: Solution, blur: Tensor, iterations: int) -> ProfileFit:
    """Turn the solution of all profiles into a ProfileFit, with flags for those that failed."""
    pictures, count = profiles.position.shape
    samples = _counted(profiles).sum((-1, -2)).to(torch.float64)
    chi2 = solution.cost.reshape(pictures, count) / (samples - 3).clamp_min(1)
    # a model that misses by more than the noise is believed only as far as its own misfit
    excess = _picture_excess(chi2, _valid_share(profiles))
    covariance = solution.covariance.reshape(pictures, count, 3, 3) * excess[:, None, None, None]
    centre, width, opacity = solution.parameters.reshape(pictures, count, 3).unbind(-1)
    converged = solution.converged.reshape(pictures, count)
    return ProfileFit(
        origin=profiles.origin,
        normal=profiles.normal,
        position=profiles.position,
        centre=centre,
        half_width=width,
        opacity=opacity,
        covariance=covariance,
        chi2_per_dof=chi2,
        flags=_flags(profiles, converged, width, opacity, covariance),
        blur=blur,
        samples=samples.to(torch.int64),
        iterations=iterations,
    )


def _problem(
    profiles: Profiles,
    estimator: AlphaEstimator,
    whitening: Tensor,
    blur: Tensor,
    smooth_ground: Tensor | None = None,
) -> Problem:
    """Residuals [A, S * Q] and Jacobian in (centre, half width, opacity, blur) of the profiles asked for.

    With a smooth ground [B, P, S, Q] the Jacobian is free of the noise of single samples, and with it of its correlation with the residual.
    """
    ground, observed, whitening, offset = (
        values.flatten(0, 1)
        for values in (
            profiles.ground,
            profiles.signal - profiles.ground,
            whitening,
            profiles.offset,
        )
    )
    J_ground = ground if smooth_ground is None else smooth_ground.flatten(0, 1)
    direction = profiles.direction.flatten()[:, None]
    blur = blur[:, None].expand_as(profiles.position).flatten()[:, None]

    def problem(x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        centre, half_width, opacity = x[:, None, :].unbind(-1)
        alpha, J_alpha = semi_ellipse_and_J(offset[rows], centre, half_width, opacity, blur[rows])
        share = (offset[rows] - centre) / half_width
        foreground, slope = estimator.foreground_and_slope(
            Chord(offset=share.clamp(-1, 1), direction=direction[rows])
        )
        weight = whitening[rows]
        contrast = (foreground - ground[rows]) * weight
        residual = alpha[..., None] * contrast - observed[rows] * weight
        J_contrast = (foreground - J_ground[rows]) * weight
        J = J_contrast[..., None] * J_alpha[..., None, :]
        if slope is not None:
            J_share = torch.stack([(-1 / half_width).expand_as(share), -share / half_width], dim=-1)
            pull = (alpha[..., None] * slope * weight)[..., None] * J_share[..., None, :]
            J = torch.cat([J[..., :2] + pull, J[..., 2:]], dim=-1)
        return residual.flatten(1), J.flatten(1, 2)

    return problem


def _own_parameters(result: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    return result[0], result[1][..., :3]


def _first_guess(
    profiles: Profiles, estimator: AlphaEstimator, half_width: Tensor | None
) -> Tensor:
    """Start from the moments of the per-sample alpha, kept near the rough half width where one is given."""
    middle = Chord(
        offset=torch.zeros_like(profiles.position)[..., None],
        direction=profiles.direction[..., None],
    )
    contrast = estimator.foreground(middle, None) - profiles.ground
    weight = contrast / profiles.variance.clamp_min(1e-14)
    information = (weight * contrast).sum(-1).clamp_min(1e-12)
    alpha = (weight * (profiles.signal - profiles.ground)).sum(-1) / information
    usable = profiles.valid.to(alpha.dtype)
    if half_width is None:
        centre, width, opacity = start_from_moments(profiles.offset, alpha, usable)
    else:
        rough = half_width[:, None]
        near = usable * (profiles.offset.abs() <= 1.6 * rough[..., None])
        centre, width, opacity = start_from_moments(profiles.offset, alpha, near)
        centre = centre.clamp(-rough / 2, rough / 2)
        width = torch.minimum(torch.maximum(width, 0.6 * rough), 1.4 * rough)
    guess = torch.stack([centre, width.clamp_min(1.0), opacity.clamp(0.01, 1.2)], dim=-1)
    return guess.reshape(-1, 3)


def _improve_blur(problem: Problem, parameters: Tensor, blur: Tensor, used: Tensor) -> Tensor:
    """Take one Gauss-Newton step in the blur [B], every profile's own parameters projected out."""
    residual, J = problem(parameters, torch.arange(len(parameters)))
    weight = (OUTLIER_SAMPLE / residual.abs().clamp_min(OUTLIER_SAMPLE)).sqrt()
    residual, J = residual * weight, J * weight[..., None]
    own, shared = J[..., :3], J[..., 3]
    inverse = invert_information(own.mT @ own)
    usable = torch.isfinite(inverse).all(-1).all(-1) & used
    inverse = torch.where(usable[:, None, None], inverse, 0)
    mixed = (own.mT @ shared[..., None])[..., 0]
    projected = shared - (own @ (inverse @ mixed[..., None]))[..., 0]
    slope = torch.where(usable, (projected * residual).sum(-1), 0).reshape(len(blur), -1).sum(-1)
    curvature = torch.where(usable, (projected * shared).sum(-1), 0).reshape(len(blur), -1).sum(-1)
    step = (-slope / curvature.clamp_min(1e-12)).clamp(-0.5, 0.5)
    return (blur + step).clamp(*BLUR_RANGE)


def _counted(profiles: Profiles) -> Tensor:
    """Numbers that enter the comparison [B, P, S, Q] bool."""
    return profiles.valid[..., None] & torch.isfinite(profiles.variance)


def _valid_share(profiles: Profiles) -> Tensor:
    """Share of each profile's pixels that may be used [B, P]."""
    filled = profiles.is_filled.sum(-1).clamp_min(1)
    return profiles.valid.sum(-1) / filled


def _picture_excess(chi2: Tensor, valid_share: Tensor) -> Tensor:
    """Median chi-square per degree of freedom of a picture's usable profiles [B], at least 1."""
    medians = torch.where(valid_share > MIN_VALID_SHARE, chi2, torch.nan).nanmedian(dim=-1).values
    return medians.nan_to_num(nan=1.0).clamp_min(1.0)


def _flags(
    profiles: Profiles, converged: Tensor, half_width: Tensor, opacity: Tensor, covariance: Tensor
) -> Tensor:
    std = covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    reach = float(profiles.offset.max())
    faults = {
        ProfileFlag.NOT_CONVERGED: ~converged,
        ProfileFlag.CLIPPED: _valid_share(profiles) < MIN_VALID_SHARE,
        ProfileFlag.LOW_CONTRAST: ~(opacity > MIN_SIGNIFICANCE * std[..., 2]),
        ProfileFlag.AT_BOUND: (half_width < 0.75)
        | (half_width > 0.95 * reach)
        | (opacity > 1.2)
        | ~torch.isfinite(std).all(-1)
        | (std[..., 1] > half_width / 2),
    }
    flags = torch.zeros_like(opacity, dtype=torch.int64)
    for flag, is_at_fault in faults.items():
        flags = flags | is_at_fault * int(flag)
    return flags
