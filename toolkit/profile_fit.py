"""Fitting the semi-ellipse to every profile at once."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.least_squares import Equations, Solution, invert_information, minimise_equations
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
STRAIGHT = 0.01
"""Skew below which the bend's second order does not matter."""
MAX_ITERATIONS = 15
OUTLIER_SAMPLE = 3.0
"""Standard deviations beyond which a sample (dirt, text, a reflection) loses its pull."""
MIN_SIGNIFICANCE = 3.0
"""Opacity over its own standard deviation below which a profile says nothing."""
MIN_VALID_SHARE = 0.8
"""Share of a profile's pixels that must be usable."""
OWN = 4
"""Parameters of each profile: centre, half width, opacity, skew."""
PRECISION = torch.float32
"""Of everything that a single pixel contributes, twice as fast; parameters stay in double."""


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
    model = _Model.of(profiles, estimator, skew, profiles.ground)
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
    model = _Model.of(profiles, estimator, skew, profiles.smooth_ground)
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
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Model:
    """The composited semi-ellipse of B * P = E profiles, against their pixels."""

    estimator: AlphaEstimator
    offset: Tensor  # [E, S]
    observed: Tensor  # [E, Q, S] signal minus ground, in standard deviations
    ground: Tensor  # [E, Q, S]
    J_ground: Tensor  # [E, Q, S] the ground as the Jacobian sees it
    whitening: Tensor  # [E, Q, S] 1 / standard deviation, 0 for what is not to be used
    contrasts: tuple[Tensor, Tensor] | None  # [E, Q, S], where one colour serves every offset
    direction: Tensor  # [E, 1] rad
    skew_mean: Tensor  # [E]
    skew_std: float
    is_bent: bool

    @classmethod
    def of(
        cls, profiles: Profiles, estimator: AlphaEstimator, skew: Skew | None, J_ground: Tensor
    ) -> "_Model":
        mean = torch.zeros_like(profiles.position) if skew is None else skew.mean
        whitening = profiles.valid[..., None] / profiles.variance.clamp_min(1e-14).sqrt()
        weight, ground, observed = (
            _by_channel(values)
            for values in (
                whitening,
                profiles.ground,
                (profiles.signal - profiles.ground) * whitening,
            )
        )
        is_same = J_ground is profiles.ground
        J_ground = ground if is_same else _by_channel(J_ground)
        offset = profiles.offset.flatten(0, 1).to(PRECISION)
        direction = profiles.direction.flatten()[:, None].to(PRECISION)
        foreground, slope = estimator.foreground_and_slope(
            Chord(offset=torch.zeros_like(offset), direction=direction)
        )
        foreground = foreground.mT
        contrast = (foreground - ground) * weight
        J_contrast = contrast if is_same else (foreground - J_ground) * weight
        if slope is None and int((weight > 0).sum(1).max()) <= 1:
            # behind a mosaic each pixel measured one channel: the others are all zeros
            contrast, observed = contrast.sum(1, keepdim=True), observed.sum(1, keepdim=True)
            J_contrast = contrast if is_same else J_contrast.sum(1, keepdim=True)
        return cls(
            estimator=estimator,
            offset=offset,
            observed=observed,
            ground=ground,
            J_ground=J_ground,
            whitening=weight,
            contrasts=(contrast, J_contrast) if slope is None else None,
            direction=direction,
            skew_mean=mean.flatten(),
            skew_std=KNOWN_SKEW if skew is None else skew.std,
            is_bent=bool((mean.abs() > STRAIGHT).any()),
        )

    def own_equations(self, blur: Tensor) -> Equations:
        """Give the normal equations of every profile's own parameters, at the blur [B]."""

        def equations(x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            cost, gradient, information = self.equations(x, rows, blur)
            return cost, gradient[:, :OWN], information[:, :OWN, :OWN]

        return equations

    def equations(self, x: Tensor, rows: Tensor, blur: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Give the robust cost [A], gradient [A, 5] and information [A, 5, 5].

        They are in (centre, half width, opacity, skew, blur). The channels of a pixel share the
        derivative of its alpha, so that they are summed first and the Jacobian of every single
        number is never formed.
        """
        # indexing copies: while every profile is still searched for, a slice does
        chosen = slice(None) if len(rows) == len(self.offset) else rows
        own_blur = blur.repeat_interleave(len(self.offset) // len(blur))[chosen][:, None]
        own_blur = own_blur.to(PRECISION)
        centre, half_width, opacity, skew = x[:, None, :].to(PRECISION).unbind(-1)
        offset = self.offset[chosen]
        bend = self.skew_mean[rows][:, None].to(PRECISION) if self.is_bent else None
        alpha, J_alpha = semi_ellipse_and_J(
            offset, centre, half_width, opacity, skew, own_blur, bend
        )
        J_alpha = J_alpha.mT
        share = (offset - centre) / half_width
        contrast, J_contrast, slope = self._contrast(share, chosen)
        residual = alpha[:, None] * contrast - self.observed[chosen]
        weight = OUTLIER_SAMPLE / residual.abs().clamp_min(OUTLIER_SAMPLE)
        weighted = weight * residual
        cost = (weighted * residual * (2 - weight)).sum((-1, -2))
        weighted_J = weight * J_contrast
        gradient = (J_alpha @ (weighted * J_contrast).sum(1)[..., None])[..., 0]
        information = (J_alpha * (weighted_J * J_contrast).sum(1)[:, None]) @ J_alpha.mT
        if slope is not None:
            pull = alpha[:, None] * slope
            J_share = torch.zeros_like(J_alpha)
            J_share[:, 0], J_share[:, 1] = -1 / half_width, -share / half_width
            gradient = gradient + (J_share @ (weighted * pull).sum(1)[..., None])[..., 0]
            cross = (J_alpha * (weighted_J * pull).sum(1)[:, None]) @ J_share.mT
            own = (J_share * (weight * pull * pull).sum(1)[:, None]) @ J_share.mT
            information = information + cross + cross.mT + own
        cost, gradient, information = (v.to(x.dtype) for v in (cost, gradient, information))
        surprise = (x[:, 3] - self.skew_mean[chosen]) / self.skew_std
        gradient[:, 3] += surprise / self.skew_std
        information[:, 3, 3] += 1 / self.skew_std**2
        return cost + surprise**2, gradient, information

    def _contrast(
        self, share: Tensor, rows: Tensor | slice
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Give ball minus ground, as J sees it too, and its slope along the share, [A, Q, S]."""
        if self.contrasts is not None:
            contrast, J_contrast = self.contrasts
            taken = contrast[rows]
            return taken, taken if J_contrast is contrast else J_contrast[rows], None
        foreground, slope = self.estimator.foreground_and_slope(
            Chord(offset=share.clamp(-1, 1), direction=self.direction[rows])
        )
        foreground, weight = foreground.mT, self.whitening[rows]
        contrast = (foreground - self.ground[rows]) * weight
        J_contrast = (foreground - self.J_ground[rows]) * weight
        return contrast, J_contrast, None if slope is None else slope.mT * weight


def _by_channel(values: Tensor) -> Tensor:
    """From [B, P, S, Q] to [B * P, Q, S]."""
    return values.flatten(0, 1).mT.to(PRECISION).contiguous()


def _first_guess(
    profiles: Profiles, estimator: AlphaEstimator, half_width: Tensor | None, skew: Tensor
) -> Tensor:
    """Start from the moments of the pixels' own alpha, near the rough width if one is known."""
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
