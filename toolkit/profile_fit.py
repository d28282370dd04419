"""Fitting the semi-ellipse to every profile at once."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.least_squares import invert_information, minimise_equations
from toolkit.profile_model import OWN, ProfileModel, Skew, WhitePixels
from toolkit.semi_ellipse import start_from_moments
from toolkit.types import ProfileFit, ProfileFlag, Profiles

START_BLUR = 0.8
"""px, of pixel and a sharp lens together."""
BLUR_RANGE = (0.3, 4.0)
"""px."""
BLUR_ROUNDS = 3
"""Updates of the blur all profiles of a picture share; each is a Newton step, so three do."""
BLUR_SETTLED = 0.02
"""px."""
LONGEST_BLUR_STEP = 0.5
"""px."""
MAX_ITERATIONS = 15
MIN_SIGNIFICANCE = 3.0
"""Opacity over its own standard deviation below which a profile says nothing."""
MIN_VALID_SHARE = 0.8
"""Share of a profile's pixels that must be usable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where a search begins."""

    parameters: Tensor  # [B, P, 4] centre, half width, opacity, skew
    blur: Tensor  # [B] px


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Where the minima of E profiles lie."""

    parameters: Tensor  # [E, 4]
    cost: Tensor  # [E]
    covariance: Tensor  # [E, 4, 4]
    converged: Tensor  # [E] bool
    blur: Tensor  # [B] px


def fit_profiles(
    profiles: Profiles,
    estimator: AlphaEstimator,
    *,
    half_width: Tensor | None = None,
    skew: Skew | None = None,
    tolerance: float = 0.05,
    blur_rounds: int = BLUR_ROUNDS,
    max_iterations: int = MAX_ITERATIONS,
    start: Start | None = None,
    pixels: WhitePixels | None = None,
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
        blur_rounds: how often the blur is improved, but for the last time; 1 leaves it as it is.
        max_iterations: of a search, between two changes of the blur.
        start: where to start instead of a first guess.
        pixels: those of the profiles, where they are weighed already.

    Returns:
        ProfileFit; profiles that failed carry flags.
    """
    pixels = WhitePixels.of(profiles) if pixels is None else pixels
    model = ProfileModel.of(pixels, estimator, skew)
    reach = float(profiles.offset.max())
    if start is None:
        x = _first_guess(profiles, estimator, half_width, model.skew_mean)
        blur = torch.full((len(profiles.position),), START_BLUR, dtype=torch.float64)
    else:
        x, blur = start.parameters.reshape(-1, OWN), start.blur
    iterations = 0
    for _ in range(blur_rounds):
        solution = minimise_equations(
            model.own_equations(blur),
            x,
            lower=torch.tensor([-reach, 0.5, 0.0, -1.0], dtype=torch.float64),
            upper=torch.tensor([reach, reach, 1.5, 1.0], dtype=torch.float64),
            tolerance=tolerance,
            max_iterations=max_iterations,
        )
        x = solution.parameters
        iterations += solution.iterations
        if blur_rounds == 1:
            break
        better_blur = _improve_blur(model, x, blur, solution.converged)
        is_settled = bool(((better_blur - blur).abs() < BLUR_SETTLED).all())
        blur = better_blur
        if is_settled:
            break
    found = Found(
        parameters=x,
        cost=solution.cost,
        covariance=solution.covariance,
        converged=solution.converged,
        blur=blur,
    )
    return describe_fit(profiles, found, iterations)


def refine_profiles(
    profiles: Profiles,
    estimator: AlphaEstimator,
    fit: ProfileFit,
    about: Tensor,
    skew: Skew | None = None,
    pixels: WhitePixels | None = None,
) -> ProfileFit:
    """Fit every profile again by one linear step from where its neighbours say it should lie.

    A single noisy profile is fitted with a bias of second order in its noise, always outwards, and
    weighs itself by what it found: neither averages out over the streak. A step that is linear in
    the noise, from parameters smoothed over many profiles and weighed by them, has neither fault.
    The background is noisy as well, and enters both residual and Jacobian; a Jacobian from the
    smoothed background keeps the two uncorrelated, without which every streak comes out wider. The
    blur takes its step along with them. [derived]

    Args:
        profiles: what was fitted.
        estimator: says what the ball alone would show.
        fit: the fit so far; profiles flagged in it, but for NOT_CONVERGED, stay as they are.
        about: smooth (centre, half width, opacity, skew) of all profiles [B, P, 4].
        skew: what is known of each profile's skew; none, when None.
        pixels: those of the profiles, where they are weighed already.
    """
    pixels = WhitePixels.of(profiles) if pixels is None else pixels
    model = ProfileModel.of(pixels, estimator, skew, is_smooth=True)
    x = about.reshape(-1, OWN)
    cost, gradient, information = model.equations(x, torch.arange(len(x)), fit.blur)
    covariance = invert_information(information[:, :OWN, :OWN])
    blur_step = _blur_step(gradient, information, covariance, is_open(fit).flatten(), fit.blur)
    return step_from(profiles, fit, x, cost, gradient, information, covariance, blur_step)


def is_open(fit: ProfileFit) -> Tensor:
    """Tell which profiles may still be fitted again [B, P].

    A step that needs no search takes those along whose search did not settle.
    """
    return (fit.flags & ~int(ProfileFlag.NOT_CONVERGED)) == 0


def step_from(
    profiles: Profiles,
    fit: ProfileFit,
    x: Tensor,
    cost: Tensor,
    gradient: Tensor,
    information: Tensor,
    covariance: Tensor,
    shared_step: Tensor,
) -> ProfileFit:
    """Step to the minimum of the normal equations, whose shared parameters have taken their step.

    Args:
        profiles: what was fitted.
        fit: the fit so far.
        x: own parameters about which the equations stand [E, 4].
        cost: there [E].
        gradient: [E, 4 + U], the blur being the first of U shared parameters.
        information: [E, 4 + U, 4 + U].
        covariance: inverse of the own part [E, 4, 4].
        shared_step: of blur and what is behind it [B, U].
    """
    each = shared_step.repeat_interleave(len(x) // len(shared_step), 0)[..., None]
    pull = gradient[:, :OWN, None] + information[:, :OWN, OWN:] @ each
    open_rows = is_open(fit)
    step = torch.where(open_rows.flatten()[:, None], (covariance @ pull)[..., 0], 0)
    found = Found(
        parameters=x - step,
        cost=cost,
        covariance=covariance,
        converged=torch.ones(len(x), dtype=torch.bool),
        blur=fit.blur + shared_step[:, 0],
    )
    refined = describe_fit(profiles, found, fit.iterations + 1)
    return replace(
        refined,
        centre=torch.where(open_rows, refined.centre, fit.centre),
        half_width=torch.where(open_rows, refined.half_width, fit.half_width),
        opacity=torch.where(open_rows, refined.opacity, fit.opacity),
        skew=torch.where(open_rows, refined.skew, fit.skew),
        covariance=torch.where(open_rows[..., None, None], refined.covariance, fit.covariance),
        flags=torch.where(open_rows, refined.flags, fit.flags),
        appearance=fit.appearance,
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
    covariance = invert_information(information[:, :OWN, :OWN])
    return blur + _blur_step(gradient, information, covariance, used, blur)[:, 0]


def _blur_step(
    gradient: Tensor, information: Tensor, covariance: Tensor, used: Tensor, blur: Tensor
) -> Tensor:
    """Give the step of the blur [B, 1]; `covariance` is the inverse of the own information."""
    usable = torch.isfinite(covariance).all(-1).all(-1) & used
    inverse = torch.where(usable[:, None, None], covariance, 0)
    mixed = information[:, :OWN, OWN]
    gain = (inverse @ mixed[..., None])[..., 0]
    slopes = gradient[:, OWN] - (gain * gradient[:, :OWN]).sum(-1)
    curvatures = information[:, OWN, OWN] - (gain * mixed).sum(-1)
    slope = torch.where(usable, slopes, 0).reshape(len(blur), -1).sum(-1)
    curvature = torch.where(usable, curvatures, 0).reshape(len(blur), -1).sum(-1)
    return bounded_blur_step(-slope / curvature.clamp_min(1e-12), blur)[:, None]


def bounded_blur_step(step: Tensor, blur: Tensor) -> Tensor:
    """Keep a step of the blur [B] short, and what it leads to in its range."""
    return (blur + step.clamp(-LONGEST_BLUR_STEP, LONGEST_BLUR_STEP)).clamp(*BLUR_RANGE) - blur


def describe_fit(profiles: Profiles, found: Found, iterations: int) -> ProfileFit:
    """Turn what was found of all profiles into a ProfileFit, with flags for those that failed."""
    pictures, count = profiles.position.shape
    compared = profiles.valid[..., None] & torch.isfinite(profiles.variance)
    samples = compared.sum((-1, -2))
    chi2 = found.cost.reshape(pictures, count) / (samples - 3).clamp_min(1)
    valid_share = profiles.valid.sum(-1) / profiles.is_filled.sum(-1).clamp_min(1)
    covariance = found.covariance[:, :3, :3].reshape(pictures, count, 3, 3)
    centre, width, opacity, skew = found.parameters.reshape(pictures, count, OWN).unbind(-1)
    std = covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    faults = {
        ProfileFlag.NOT_CONVERGED: ~found.converged.reshape(pictures, count),
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
        blur=found.blur,
        samples=samples,
        iterations=iterations,
    )
