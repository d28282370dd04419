"""Whether the ball moved in the light in which its looks were taken.

Other light shows as a gain: the streak's colours are those foretold times a number, its own for
each channel. A fitted opacity hides most of it, since a brighter ball looks like a slower one; but
it also covers the background's texture for longer, and it cannot change a colour. [derived]
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.measurement import Caution
from toolkit.semi_ellipse import semi_ellipse_and_J
from toolkit.types import ProfileFit, Profiles

ENOUGH_PROFILES = 100
"""Spread over the streak; more of them hardly sharpen three numbers."""
LEAST_CHANGE = 0.05
"""Change of a gain that is worth a word: the speed is off by about as much."""
SURPRISE = 30.0
"""Chi-square of three gains beyond which they are no accident."""
OWN = 3
"""Parameters of each profile that may hide a gain: centre, half width, opacity."""
PLAUSIBLE_SPREAD = 2.0
"""Largest gain over the smallest, beyond which no lamp but another shading is behind them."""
MOST_PULL = 3.0
"""Standard deviations at which a single number stops to pull."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LightGain:
    """How many times the light foretold the ball sent to each of Q channels."""

    gain: Tensor  # [Q]
    covariance: Tensor  # [Q, Q]
    misfit: float  # chi-square per number of what even the gains do not explain

    @property
    def std(self) -> Tensor:
        """Standard deviation of each gain [Q]."""
        return self.covariance.diagonal().sqrt()

    @property
    def is_plausible(self) -> bool:
        """Whether a lamp may be behind such gains; a wrong shape of the shading gives any."""
        low, high = self.gain.aminmax()
        return bool(low > 0) and bool(high < PLAUSIBLE_SPREAD * low)

    @property
    def is_other_light(self) -> bool:
        """Whether the gains differ from 1 by more than noise, and enough to matter."""
        change = self.gain - 1
        surprise = change @ torch.linalg.solve(self.covariance, change)
        return bool(surprise > SURPRISE) and bool(change.abs().max() > LEAST_CHANGE)


def light_gain(profiles: Profiles, fit: ProfileFit, estimator: AlphaEstimator) -> LightGain | None:
    """Find the gain of every channel that explains best what the fit has left over.

    With opacity k and gain g the picture shows k (g F - B): linear in k and in k g, so that one
    step of least squares finds both; centre, half width and opacity of each profile are projected
    out.

    Args:
        profiles: what was fitted, of the first picture.
        fit: its good profiles count.
        estimator: says what the ball alone would show.

    Returns:
        LightGain; None where the streak does not tell.
    """
    good = fit.good[0].nonzero()[:, 0]
    chosen = good[:: max(1, len(good) // ENOUGH_PROFILES)]
    if not len(chosen):
        return None
    residual, J_own, J_gain = _linearised(profiles, fit, estimator, chosen)
    weight = MOST_PULL / residual.abs().clamp_min(MOST_PULL)
    weighted_own, weighted_gain = weight[..., None] * J_own, weight[..., None] * J_gain
    own = weighted_own.mT @ J_own
    mixed, pull = weighted_own.mT @ J_gain, weighted_own.mT @ residual[..., None]
    inverse, info = torch.linalg.inv_ex(own)
    usable = (info == 0) & torch.isfinite(inverse).all(-1).all(-1)
    inverse = torch.where(usable[:, None, None], inverse, 0)
    information = _total(weighted_gain.mT @ J_gain - mixed.mT @ inverse @ mixed, usable)
    slope = _total(weighted_gain.mT @ residual[..., None] - mixed.mT @ inverse @ pull, usable)
    factor, failed = torch.linalg.cholesky_ex(information)
    if bool(failed):
        return None
    change = torch.cholesky_solve(slope, factor)
    step = inverse @ (pull - mixed @ change)
    dimming = 1 + (step[:, 2, 0] / fit.opacity[0, chosen])[usable].median()
    left = residual - (J_own @ step + J_gain @ change)[..., 0]
    misfit = (weight * left**2)[usable].sum() / (residual[usable] != 0).sum().clamp_min(1)
    return LightGain(
        gain=1 + change[:, 0] / dimming,
        covariance=torch.cholesky_inverse(factor) * misfit.clamp_min(1) / dimming**2,
        misfit=float(misfit),
    )


def light_caution(profiles: Profiles, fit: ProfileFit, estimator: AlphaEstimator) -> Caution | None:
    """Give the caution that is due where the ball moved in other light, with the gain seen."""
    found = light_gain(profiles, fit, estimator)
    if found is None or not found.is_other_light:
        return None
    if found.is_plausible:
        gains = zip(found.gain.tolist(), found.std.tolist(), strict=True)
        factors = ", ".join(f"{gain:.2f} +- {std:.2f}" for gain, std in gains)
        message = (
            f"the ball sends {factors} times the light (R, G, B) it was known by, as if it had "
            "moved in other light; take its colours or its sharp picture where it flies, with the "
            "same exposure"
        )
    else:
        message = (
            "the ball is coloured, lit or shaded otherwise than this estimator knows it; correct "
            "its colour or, for known-shading, take its sharp picture where it flies, with the "
            "same exposure"
        )
    return Caution(code="other-light", message=message)


def _linearised(
    profiles: Profiles, fit: ProfileFit, estimator: AlphaEstimator, chosen: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Give what the fit left over, in standard deviations, and its derivatives.

    Returns:
        Residual [P, S * Q], in the profiles' own parameters [P, S * Q, 3], and in the gains
        [P, S * Q, Q].
    """
    centre, half_width, opacity, skew = (
        values[0, chosen, None] for values in (fit.centre, fit.half_width, fit.opacity, fit.skew)
    )
    offset, ground = profiles.offset[0, chosen], profiles.ground[0, chosen]
    alpha, J_alpha = semi_ellipse_and_J(offset, centre, half_width, opacity, skew, fit.blur[:1])
    share = (offset - centre) / half_width
    foreground, slope = estimator.foreground_and_slope(
        Chord(
            offset=share.clamp(-1, 1),
            direction=profiles.direction[0, chosen, None],
            place=profiles.origin[0, chosen, None],
        )
    )
    variance = profiles.variance[0, chosen].clamp_min(1e-14)
    whitening = profiles.valid[0, chosen][..., None] / variance.sqrt()
    contrast = (foreground - ground) * whitening
    residual = (profiles.signal[0, chosen] - ground) * whitening - alpha[..., None] * contrast
    # the ground's own noise is in the residual, and must not be in the derivative as well
    J_contrast = (foreground - profiles.smooth_ground[0, chosen]) * whitening
    J_own = J_contrast[..., None] * J_alpha[..., None, :OWN]
    if slope is not None:
        J_share = torch.stack([-1 / half_width.expand_as(share), -share / half_width], dim=-1)
        pull = (alpha[..., None] * slope * whitening)[..., None] * J_share[..., None, :]
        J_own = J_own + torch.nn.functional.pad(pull, (0, 1))
    J_gain = torch.diag_embed(alpha[..., None] * foreground * whitening)
    return residual.flatten(1), J_own.flatten(1, 2), J_gain.flatten(1, 2)


def _total(parts: Tensor, usable: Tensor) -> Tensor:
    """Sum over the usable profiles."""
    return torch.where(usable[:, None, None], parts, 0).sum(0)
