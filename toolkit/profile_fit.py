"""Fitting the semi-ellipse to every profile at once."""

from dataclasses import replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.least_squares import Solution, invert_information, minimise_equations
from toolkit.profile_model import OWN, ProfileModel, Skew
from toolkit.semi_ellipse import start_from_moments
from toolkit.types import Appearance, ProfileFit, ProfileFlag, Profiles

START_BLUR = 0.8
"""px, of pixel and a sharp lens together."""
BLUR_RANGE = (0.3, 4.0)
"""px."""
BLUR_ROUNDS = 3
"""Updates of the blur all profiles of a picture share; each is a Newton step, so three do."""
BLUR_SETTLED = 0.02
"""px."""
MAX_ITERATIONS = 15
MIN_SIGNIFICANCE = 3.0
"""Opacity over its own standard deviation below which a profile says nothing."""
MIN_VALID_SHARE = 0.8
"""Share of a profile's pixels that must be usable."""


def fit_profiles(
    profiles: Profiles,
    estimator: AlphaEstimator,
    *,
    half_width: Tensor | None = None,
    skew: Skew | None = None,
    tolerance: float = 0.05,
    blur_rounds: int = BLUR_ROUNDS,
) -> ProfileFit:
    """Fit centre, half width and opacity of every profile by batched Gauss-Newton.

    The blur is one number a picture, found by the same least squares with every profile's own
    parameters projected out.
    Source: Caglioti & Giusti 2007, section 3.2. Deviation: the fit compares composited signals,
    weighed by their noise, not alpha values, which serves every estimator; a robust loss bounds
    the pull of single samples; the path's bend enters as a known skew.

    Args:
        profiles: B pictures with P profiles of S samples each.
        estimator: says what the ball alone would show.
        half_width: a rough half width [B] px that bounds the first guess.
        skew: what is known of each profile's skew; none, when None.
        tolerance: steps below this share of each standard deviation end a profile's search.
        blur_rounds: how often the blur is improved.

    Returns:
        ProfileFit; profiles that failed carry flags.
    """
    model = ProfileModel.of(profiles, estimator, skew, profiles.ground)
    reach = float(profiles.offset.max())
    x = _first_guess(profiles, estimator, half_width, model.skew_mean)
    blur = torch.full((len(profiles.position),), START_BLUR, dtype=torch.float64)
    iterations = 0
    for _ in range(blur_rounds):
        solution = minimise_equations(
            model.own_equations(blur),
            x,
            lower=torch.tensor([-reach, 0.5, 0.0, -1.0], dtype=torch.float64),
            upper=torch.tensor([reach, reach, 1.5, 1.0], dtype=torch.float64),
            tolerance=tolerance,
            max_iterations=MAX_ITERATIONS,
        )
        x = solution.parameters
        iterations += solution.iterations
        if blur_rounds == 1:
            break
        better_blur = _improve_blur(model, x, blur, solution.converged)
        if bool(((better_blur - blur).abs() < BLUR_SETTLED).all()):
            break
        blur = better_blur
    return _finish(profiles, solution, blur, iterations)


def refine_profiles(
    profiles: Profiles,
    estimator: AlphaEstimator,
    fit: ProfileFit,
    about: Tensor,
    skew: Skew | None = None,
) -> ProfileFit:
    """Fit every profile again by one linear step from where its neighbours say it should lie.

    A single noisy profile is fitted with a bias of second order in its noise, always outwards, and
    weighs itself by what it found: neither averages out over the streak. A step that is linear in
    the noise, from parameters smoothed over many profiles and weighed by them, has neither fault.
    The background is noisy as well, and enters both residual and Jacobian; a Jacobian from the
    smoothed background keeps the two uncorrelated, without which every streak comes out wider. The
    blur takes its step from here too. [derived]

    Args:
        profiles: what was fitted.
        estimator: says what the ball alone would show.
        fit: the fit so far; profiles flagged in it, but for NOT_CONVERGED, stay as they are.
        about: smooth (centre, half width, opacity, skew) of all profiles [B, P, 4].
        skew: what is known of each profile's skew; none, when None.
    """
    model = ProfileModel.of(profiles, estimator, skew, profiles.smooth_ground)
    x = about.reshape(-1, OWN)
    # a step that needs no search takes those along whose search did not settle
    is_open = (fit.flags & ~int(ProfileFlag.NOT_CONVERGED)) == 0
    blur = _improve_blur(model, x, fit.blur, is_open.flatten())
    there = minimise_equations(model.own_equations(blur), x, max_iterations=0)
    step = (there.covariance @ there.gradient[..., None])[..., 0]
    moved = replace(
        there,
        parameters=torch.where(is_open.flatten()[:, None], x - step, x),
        converged=torch.ones_like(there.converged),
    )
    refined = _finish(profiles, moved, blur, fit.iterations + 1)
    return replace(
        refined,
        centre=torch.where(is_open, refined.centre, fit.centre),
        half_width=torch.where(is_open, refined.half_width, fit.half_width),
        opacity=torch.where(is_open, refined.opacity, fit.opacity),
        skew=torch.where(is_open, refined.skew, fit.skew),
        covariance=torch.where(is_open[..., None, None], refined.covariance, fit.covariance),
        flags=torch.where(is_open, refined.flags, fit.flags),
        appearance=fit.appearance,
    )


def improve_appearance(
    profiles: Profiles,
    estimator: AlphaEstimator,
    guess: Appearance,
    values: Tensor,
    fit: ProfileFit,
    about: Tensor,
    skew: Skew | None = None,
) -> Appearance:
    """Take one Gauss-Newton step in the unknowns of the ball's appearance.

    Every profile's own parameters and the blur are projected out: what remains to tell a colour
    from the opacity is how a varying background shines through. As in `refine_profiles` the
    Jacobian sees the smoothed background, without which its noise would count as variation.
    [derived]

    Args:
        profiles: of one picture.
        estimator: with unknowns, not settled.
        guess: from elsewhere, a weak prior.
        values: to step from [A].
        fit: the fit so far, settled on some appearance near by.
        about: smooth (centre, half width, opacity, skew) of all profiles [B, P, 4].
        skew: what is known of each profile's skew; none, when None.
    """
    model = ProfileModel.of(profiles, estimator.settled(values), skew, profiles.smooth_ground)
    rows = fit.good.flatten().nonzero()[:, 0]
    x = about.reshape(-1, OWN)[rows]
    J_foreground = model.J_appearance(estimator, x, rows)
    gradient, information = model.full_equations(x, rows, fit.blur, J_foreground)
    own, shared = slice(None, OWN), slice(OWN, None)
    gain = invert_information(information[:, own, own]) @ information[:, own, shared]
    slope = (gradient[:, shared] - (gain.mT @ gradient[:, own, None])[..., 0]).sum(0)
    curvature = (information[:, shared, shared] - gain.mT @ information[:, own, shared]).sum(0)
    slope[1:] += (values - guess.values) / guess.std**2
    curvature[1:, 1:] += torch.eye(len(values), dtype=curvature.dtype) / guess.std**2
    covariance = torch.linalg.inv(curvature)
    per_opacity = (gain[:, 2] / x[:, 2:3]).mean(0)
    return Appearance(
        values=values - (covariance @ slope)[1:],
        std=guess.std,
        opacity_std=float((per_opacity @ covariance @ per_opacity).sqrt()),
    )


def _first_guess(
    profiles: Profiles, estimator: AlphaEstimator, half_width: Tensor | None, skew: Tensor
) -> Tensor:
    """Start from the moments of the pixels' own alpha, near the rough width if one is known."""
    middle = Chord(
        offset=torch.zeros_like(profiles.position)[..., None],
        direction=profiles.direction[..., None],
        place=profiles.origin[..., None, :],
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
    return torch.cat([guess.reshape(-1, 3), skew[:, None]], dim=-1)


def _improve_blur(model: ProfileModel, x: Tensor, blur: Tensor, used: Tensor) -> Tensor:
    """Take one Gauss-Newton step in the blur [B], every profile's own parameters projected out."""
    _, gradient, information = model.equations(x, torch.arange(len(x)), blur)
    inverse = invert_information(information[:, :OWN, :OWN])
    usable = torch.isfinite(inverse).all(-1).all(-1) & used
    inverse = torch.where(usable[:, None, None], inverse, 0)
    mixed = information[:, :OWN, OWN]
    gain = (inverse @ mixed[..., None])[..., 0]
    slopes = gradient[:, OWN] - (gain * gradient[:, :OWN]).sum(-1)
    curvatures = information[:, OWN, OWN] - (gain * mixed).sum(-1)
    slope = torch.where(usable, slopes, 0).reshape(len(blur), -1).sum(-1)
    curvature = torch.where(usable, curvatures, 0).reshape(len(blur), -1).sum(-1)
    step = (-slope / curvature.clamp_min(1e-12)).clamp(-0.5, 0.5)
    return (blur + step).clamp(*BLUR_RANGE)


def _finish(profiles: Profiles, solution: Solution, blur: Tensor, iterations: int) -> ProfileFit:
    """Turn the solution of all profiles into a ProfileFit, with flags for those that failed."""
    pictures, count = profiles.position.shape
    compared = profiles.valid[..., None] & torch.isfinite(profiles.variance)
    samples = compared.sum((-1, -2))
    chi2 = solution.cost.reshape(pictures, count) / (samples - 3).clamp_min(1)
    valid_share = profiles.valid.sum(-1) / profiles.is_filled.sum(-1).clamp_min(1)
    covariance = solution.covariance[:, :3, :3].reshape(pictures, count, 3, 3)
    centre, width, opacity, skew = solution.parameters.reshape(pictures, count, OWN).unbind(-1)
    std = covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    faults = {
        ProfileFlag.NOT_CONVERGED: ~solution.converged.reshape(pictures, count),
        ProfileFlag.CLIPPED: valid_share < MIN_VALID_SHARE,
        ProfileFlag.LOW_CONTRAST: ~(opacity > MIN_SIGNIFICANCE * std[..., 2]),
        ProfileFlag.AT_BOUND: (width < 0.75)
        | (width > 0.95 * float(profiles.offset.max()))
        | (opacity > 1.2)
        | ~(std[..., 1] < width / 2),
    }
    flags = torch.zeros_like(opacity, dtype=torch.int64)
    for flag, is_at_fault in faults.items():
        flags = flags | is_at_fault * int(flag)
    return ProfileFit(
        origin=profiles.origin,
        normal=profiles.normal,
        position=profiles.position,
        centre=centre,
        half_width=width,
        opacity=opacity,
        skew=skew,
        covariance=covariance,
        chi2_per_dof=chi2,
        flags=flags,
        blur=blur,
        samples=samples,
        iterations=iterations,
    )
