"""Fitting the semi-ellipse to every profile at once."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.least_squares import Problem, Solution, invert_information, minimise
from toolkit.semi_ellipse import semi_ellipse_and_J, start_from_moments
from toolkit.types import ProfileFit, ProfileFlag, Profiles

START_BLUR = 0.8
"""px, of pixel and a sharp lens together."""
BLUR_RANGE = (0.3, 4.0)
"""px."""
BLUR_ROUNDS = 3
"""Updates of the blur all profiles of a picture share; each is a Newton step, so three do."""
BLUR_SETTLED = 0.02
"""px."""
KNOWN_SKEW = 1e-3
"""Standard deviation of a skew that is known from the path's bend: as good as fixed."""
MAX_ITERATIONS = 15
OUTLIER_SAMPLE = 3.0
"""Standard deviations beyond which a sample (dirt, text, a reflection) loses its pull."""
MIN_SIGNIFICANCE = 3.0
"""Opacity over its own standard deviation below which a profile says nothing."""
MIN_VALID_SHARE = 0.8
"""Share of a profile's pixels that must be usable."""
OWN = 4
"""Parameters of each profile: centre, half width, opacity, skew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Skew:
    """What is expected of the profiles' skew: a normal distribution."""

    mean: Tensor  # [B, P]
    std: float


def fit_profiles(
    profiles: Profiles,
    estimator: AlphaEstimator,
    *,
    half_width: Tensor | None = None,
    skew: Skew | None = None,
    tolerance: float = 0.02,
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
    model = _Model.of(profiles, estimator, skew, profiles.ground)
    reach = float(profiles.offset.max())
    x = _first_guess(profiles, estimator, half_width, model.skew_mean)
    blur = torch.full((len(profiles.position),), START_BLUR, dtype=torch.float64)
    iterations = 0
    for _ in range(blur_rounds):
        solution = minimise(
            model.own_problem(blur),
            x,
            lower=torch.tensor([-reach, 0.5, 0.0, -1.0], dtype=torch.float64),
            upper=torch.tensor([reach, reach, 1.5, 1.0], dtype=torch.float64),
            huber=OUTLIER_SAMPLE,
            tolerance=tolerance,
            max_iterations=MAX_ITERATIONS,
        )
        x = solution.parameters
        iterations += solution.iterations
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
    model = _Model.of(profiles, estimator, skew, profiles.smooth_ground)
    x = about.reshape(-1, OWN)
    # a step that needs no search takes those along whose search did not settle
    is_open = (fit.flags & ~int(ProfileFlag.NOT_CONVERGED)) == 0
    blur = _improve_blur(model, x, fit.blur, is_open.flatten())
    there = minimise(model.own_problem(blur), x, huber=OUTLIER_SAMPLE, max_iterations=0)
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
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Model:
    """The composited semi-ellipse of B * P = E profiles, against their pixels."""

    estimator: AlphaEstimator
    offset: Tensor  # [E, S]
    observed: Tensor  # [E, S, Q] signal minus ground
    ground: Tensor  # [E, S, Q]
    J_ground: Tensor  # [E, S, Q] the ground as the Jacobian sees it
    whitening: Tensor  # [E, S, Q] 1 / standard deviation, 0 for what is not to be used
    direction: Tensor  # [E, 1] rad
    skew_mean: Tensor  # [E]
    skew_std: float

    @classmethod
    def of(
        cls, profiles: Profiles, estimator: AlphaEstimator, skew: Skew | None, J_ground: Tensor
    ) -> "_Model":
        mean = torch.zeros_like(profiles.position) if skew is None else skew.mean
        whitening = profiles.valid[..., None] / profiles.variance.clamp_min(1e-14).sqrt()
        return cls(
            estimator=estimator,
            offset=profiles.offset.flatten(0, 1),
            observed=(profiles.signal - profiles.ground).flatten(0, 1),
            ground=profiles.ground.flatten(0, 1),
            J_ground=J_ground.flatten(0, 1),
            whitening=whitening.flatten(0, 1),
            direction=profiles.direction.flatten()[:, None],
            skew_mean=mean.flatten(),
            skew_std=KNOWN_SKEW if skew is None else skew.std,
        )

    def own_problem(self, blur: Tensor) -> Problem:
        """The least-squares problem of every profile's own parameters, at the blur [B]."""

        def problem(x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
            residual, J = self.residual(x, rows, blur)
            return residual, J[..., :OWN]

        return problem

    def residual(self, x: Tensor, rows: Tensor, blur: Tensor) -> tuple[Tensor, Tensor]:
        """Whitened residuals [A, S * Q + 1] of profiles `rows` [A] at x [A, 4].

        Returns:
            The residuals, the last one being the skew's, and their Jacobian in (centre, half
            width, opacity, skew, blur) [A, S * Q + 1, 5].
        """
        own_blur = blur.repeat_interleave(len(self.offset) // len(blur))[rows][:, None]
        centre, half_width, opacity, skew = x[:, None, :].unbind(-1)
        offset, weight = self.offset[rows], self.whitening[rows]
        alpha, J_alpha = semi_ellipse_and_J(offset, centre, half_width, opacity, skew, own_blur)
        share = (offset - centre) / half_width
        foreground, slope = self.estimator.foreground_and_slope(
            Chord(offset=share.clamp(-1, 1), direction=self.direction[rows])
        )
        residual = (
            alpha[..., None] * (foreground - self.ground[rows]) - self.observed[rows]
        ) * weight
        J = ((foreground - self.J_ground[rows]) * weight)[..., None] * J_alpha[..., None, :]
        if slope is not None:
            J_share = torch.stack([(-1 / half_width).expand_as(share), -share / half_width], dim=-1)
            pull = (alpha[..., None] * slope * weight)[..., None] * J_share[..., None, :]
            J = torch.cat([J[..., :2] + pull, J[..., 2:]], dim=-1)
        surprise = (x[:, 3:] - self.skew_mean[rows][:, None]) / self.skew_std
        J_surprise = torch.zeros(len(x), 1, OWN + 1, dtype=x.dtype)
        J_surprise[:, 0, 3] = 1 / self.skew_std
        return (
            torch.cat([residual.flatten(1), surprise], dim=1),
            torch.cat([J.flatten(1, 2), J_surprise], dim=1),
        )


def _first_guess(
    profiles: Profiles, estimator: AlphaEstimator, half_width: Tensor | None, skew: Tensor
) -> Tensor:
    """Start from the moments of every pixel's own alpha, near the rough half width if there is one."""
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
    return torch.cat([guess.reshape(-1, 3), skew[:, None]], dim=-1)


def _improve_blur(model: _Model, x: Tensor, blur: Tensor, used: Tensor) -> Tensor:
    """Take one Gauss-Newton step in the blur [B], every profile's own parameters projected out."""
    residual, J = model.residual(x, torch.arange(len(x)), blur)
    weight = (OUTLIER_SAMPLE / residual.abs().clamp_min(OUTLIER_SAMPLE)).sqrt()
    residual, J = residual * weight, J * weight[..., None]
    own, shared = J[..., :OWN], J[..., OWN]
    inverse = invert_information(own.mT @ own)
    usable = torch.isfinite(inverse).all(-1).all(-1) & used
    inverse = torch.where(usable[:, None, None], inverse, 0)
    mixed = (own.mT @ shared[..., None])[..., 0]
    projected = shared - (own @ (inverse @ mixed[..., None]))[..., 0]
    slope = torch.where(usable, (projected * residual).sum(-1), 0).reshape(len(blur), -1).sum(-1)
    curvature = torch.where(usable, (projected * shared).sum(-1), 0).reshape(len(blur), -1).sum(-1)
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
