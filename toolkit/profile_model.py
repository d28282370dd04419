"""The composited semi-ellipse of many profiles, held against their pixels."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.least_squares import Equations
from toolkit.semi_ellipse import semi_ellipse_and_J
from toolkit.types import Profiles

KNOWN_SKEW = 1e-3
"""Standard deviation of a skew that is known from the path's bend: as good as fixed."""
STRAIGHT = 0.01
"""Skew below which the bend's second order does not matter."""
OUTLIER_SAMPLE = 3.0
"""Standard deviations beyond which a sample (dirt, text, a reflection) loses its pull."""
OWN = 4
"""Parameters of each profile: centre, half width, opacity, skew."""
PRECISION = torch.float32
"""Of everything that a single pixel contributes, twice as fast; parameters stay in double."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Skew:
    """What is expected of the profiles' skew: a normal distribution."""

    mean: Tensor  # [B, P]
    std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WhitePixels:
    """The pixels of B * P = E profiles in standard deviations, as any model of them needs them."""

    offset: Tensor  # [E, S] px
    observed: Tensor  # [E, Q, S] signal minus ground
    ground: Tensor  # [E, Q, S]
    smooth_ground: Tensor  # [E, Q, S]
    whitening: Tensor  # [E, Q, S] 1 / standard deviation, 0 for what is not to be used
    direction: Tensor  # [E, 1] rad
    place: Tensor  # [E, 1, 2] px of the profile in the picture
    is_mosaic: bool  # one channel at most was measured at each pixel

    @classmethod
    def of(cls, profiles: Profiles) -> "WhitePixels":
        """Weigh the pixels of profiles by their noise."""
        weight = _by_channel(profiles.variance).clamp_min(1e-14).rsqrt()
        weight = weight * profiles.valid.flatten(0, 1)[:, None]
        signal, ground, smooth_ground = (
            _by_channel(values)
            for values in (profiles.signal, profiles.ground, profiles.smooth_ground)
        )
        return cls(
            offset=profiles.offset.flatten(0, 1).to(PRECISION),
            observed=(signal - ground) * weight,
            ground=ground * weight,
            smooth_ground=smooth_ground * weight,
            whitening=weight,
            direction=profiles.direction.flatten()[:, None].to(PRECISION),
            place=profiles.origin.flatten(0, 1)[:, None].to(PRECISION),
            is_mosaic=int((weight > 0).sum(1).max()) <= 1,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileModel:
    """The composited semi-ellipse of B * P = E profiles, against their pixels."""

    estimator: AlphaEstimator
    pixels: WhitePixels
    observed: Tensor  # [E, Q, S] signal minus ground, in standard deviations; Q = 1 of a mosaic
    is_smooth: bool  # whether the Jacobian sees the smoothed ground
    contrasts: tuple[Tensor, Tensor] | None  # [E, Q, S], where one colour serves every offset
    skew_mean: Tensor  # [E]
    skew_std: float
    is_bent: bool

    @classmethod
    def of(
        cls,
        pixels: WhitePixels,
        estimator: AlphaEstimator,
        skew: Skew | None,
        *,
        is_smooth: bool = False,
    ) -> "ProfileModel":
        """Prepare profiles for fitting."""
        count = len(pixels.offset)
        mean = torch.zeros(count, dtype=torch.float64) if skew is None else skew.mean.flatten()
        foreground, slope = estimator.foreground_and_slope(
            Chord(
                offset=torch.zeros_like(pixels.offset),
                direction=pixels.direction,
                place=pixels.place,
            )
        )
        contrasts, observed = None, pixels.observed
        if slope is None:
            light = foreground.mT * pixels.whitening
            contrast = light - pixels.ground
            J_contrast = light - pixels.smooth_ground if is_smooth else contrast
            if pixels.is_mosaic:
                # the channels that were not measured are all zeros
                observed, contrast = (v.sum(1, keepdim=True) for v in (observed, contrast))
                J_contrast = J_contrast.sum(1, keepdim=True) if is_smooth else contrast
            contrasts = (contrast, J_contrast)
        return cls(
            estimator=estimator,
            pixels=pixels,
            observed=observed,
            is_smooth=is_smooth,
            contrasts=contrasts,
            skew_mean=mean,
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
        at = self._at(x, rows, blur)
        cost, gradient, information = (v.to(x.dtype) for v in at.sums())
        surprise = self._add_prior(x, rows, gradient, information)
        return cost + surprise**2, gradient, information

    def full_equations(
        self, x: Tensor, rows: Tensor, blur: Tensor, J_foreground: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Give cost, gradient [A, 5 + U] and information with U unknowns of the appearance behind.

        Args:
            x: own parameters of the chosen profiles [A, 4].
            rows: which profiles [A].
            blur: [B] px.
            J_foreground: derivative of the whitened foreground in the unknowns [A, Q, S, U].
        """
        at = self._at(x, rows, blur)
        cost, gradient, information = at.sums()
        J_looks = at.alpha[:, None, :, None] * J_foreground
        weighted_J = at.weight[..., None] * J_looks
        mixed = at.J_alpha @ (at.J_contrast[..., None] * weighted_J).sum(1)
        if at.slope is not None and at.J_share is not None:
            pull = at.alpha[:, None] * at.slope
            mixed = mixed + at.J_share @ (pull[..., None] * weighted_J).sum(1)
        weighted_J, J_looks = weighted_J.flatten(1, 2), J_looks.flatten(1, 2)
        looks_gradient = (weighted_J.mT @ at.residual.flatten(1)[..., None])[..., 0]
        looks_information = torch.cat([mixed.mT, weighted_J.mT @ J_looks], dim=-1)
        gradient = torch.cat([gradient, looks_gradient], dim=-1).to(x.dtype)
        information = torch.cat([information, mixed], dim=-1)
        information = torch.cat([information, looks_information], dim=-2).to(x.dtype)
        surprise = self._add_prior(x, rows, gradient, information)
        return cost.to(x.dtype) + surprise**2, gradient, information

    def residuals(self, x: Tensor, rows: Tensor, blur: Tensor) -> tuple[Tensor, Tensor]:
        """Give model minus observed of the chosen profiles, in standard deviations, [A, Q, S].

        Beside them 1 where something was observed, else 0; a mosaic shows one channel.
        """
        residual = self._at(x, rows, blur).residual
        seen = self.pixels.whitening[rows] > 0
        if seen.shape[1] != residual.shape[1]:
            seen = seen.any(1, keepdim=True)
        return residual, seen.to(residual.dtype)

    def J_appearance(self, estimator: AlphaEstimator, x: Tensor, rows: Tensor) -> Tensor:
        """Give the derivative of the whitened foreground in the estimator's U unknowns.

        The foreground is linear in them. [A, Q, S, U]
        """
        offset = (self.pixels.offset[rows] - x[:, :1]) / x[:, 1:2]
        chord = self._chord(offset.to(PRECISION), rows)
        count = estimator.unknowns()
        at_zero = estimator.foreground(chord, torch.zeros(count, dtype=x.dtype))
        columns = [
            (estimator.foreground(chord, unit) - at_zero).mT * self.pixels.whitening[rows]
            for unit in torch.eye(count, dtype=x.dtype)
        ]
        J = torch.stack(columns, dim=-1)
        # behind a mosaic the model holds one channel a pixel
        return J if J.shape[1] == self.observed.shape[1] else J.sum(1, keepdim=True)

    def _at(self, x: Tensor, rows: Tensor, blur: Tensor) -> "_Evaluated":
        # indexing copies: while every profile is still searched for, a slice does
        chosen = slice(None) if len(rows) == len(self.pixels.offset) else rows
        own_blur = blur.to(PRECISION)[:, None]
        if len(blur) > 1:
            own_blur = own_blur.repeat_interleave(len(self.pixels.offset) // len(blur), 0)[chosen]
        centre, half_width, opacity, skew = x[:, None, :].to(PRECISION).unbind(-1)
        offset = self.pixels.offset[chosen]
        bend = self.skew_mean[rows][:, None].to(PRECISION) if self.is_bent else None
        alpha, J_alpha = semi_ellipse_and_J(
            offset, centre, half_width, opacity, skew, own_blur, bend
        )
        J_alpha = J_alpha.mT
        share = (offset - centre) / half_width
        contrast, J_contrast, slope = self._contrast(share, chosen)
        residual = alpha[:, None] * contrast - self.observed[chosen]
        J_share = None
        if slope is not None:
            J_share = torch.zeros_like(J_alpha)
            J_share[:, 0], J_share[:, 1] = -1 / half_width, -share / half_width
        return _Evaluated(
            alpha=alpha,
            J_alpha=J_alpha,
            J_share=J_share,
            J_contrast=J_contrast,
            slope=slope,
            residual=residual,
            weight=OUTLIER_SAMPLE / residual.abs().clamp_min(OUTLIER_SAMPLE),
        )

    def _add_prior(self, x: Tensor, rows: Tensor, gradient: Tensor, information: Tensor) -> Tensor:
        """Add what is known of the skew, in place; give its surprise in standard deviations [A]."""
        surprise = (x[:, 3] - self.skew_mean[rows]) / self.skew_std
        gradient[:, 3].add_(surprise, alpha=1 / self.skew_std)
        information[:, 3, 3].add_(1 / self.skew_std**2)
        return surprise

    def _chord(self, share: Tensor, rows: Tensor | slice) -> Chord:
        """Whole chords at offsets [A, S] in half widths; beyond the rim, those at the rim."""
        return Chord(
            offset=share.clamp(-1, 1),
            direction=self.pixels.direction[rows],
            place=self.pixels.place[rows],
        )

    def _contrast(
        self, share: Tensor, rows: Tensor | slice
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Give ball minus ground, as J sees it too, and its slope along the share, [A, Q, S]."""
        if self.contrasts is not None:
            contrast, J_contrast = self.contrasts
            taken = contrast[rows]
            return taken, taken if J_contrast is contrast else J_contrast[rows], None
        foreground, slope = self.estimator.foreground_and_slope(self._chord(share, rows))
        weight = self.pixels.whitening[rows]
        light = foreground.mT * weight
        contrast = light - self.pixels.ground[rows]
        J_contrast = light - self.pixels.smooth_ground[rows] if self.is_smooth else contrast
        return contrast, J_contrast, None if slope is None else slope.mT * weight


@dataclass(frozen=True, slots=True, kw_only=True)
class _Evaluated:
    """The model at some parameters: A profiles, Q channels, S places; contrasts are whitened."""

    alpha: Tensor  # [A, S]
    J_alpha: Tensor  # [A, 5, S] in the profile's own parameters and the blur
    J_contrast: Tensor  # [A, Q, S] ball minus ground, as the Jacobian sees it
    slope: Tensor | None  # [A, Q, S] of the contrast along the share; None where there is none
    J_share: Tensor | None  # [A, 5, S] of the share of the half width; None where not needed
    residual: Tensor  # [A, Q, S]
    weight: Tensor  # [A, Q, S] robust

    def sums(self) -> tuple[Tensor, Tensor, Tensor]:
        """Give cost [A], gradient [A, 5] and information [A, 5, 5]."""
        J_alpha, weighted = self.J_alpha, self.weight * self.residual
        cost = (weighted * self.residual * (2 - self.weight)).sum((-1, -2))
        weighted_J = self.weight * self.J_contrast
        gradient = (J_alpha @ (weighted * self.J_contrast).sum(1)[..., None])[..., 0]
        information = (J_alpha * (weighted_J * self.J_contrast).sum(1)[:, None]) @ J_alpha.mT
        if self.slope is not None and self.J_share is not None:
            pull, J_share = self.alpha[:, None] * self.slope, self.J_share
            gradient = gradient + (J_share @ (weighted * pull).sum(1)[..., None])[..., 0]
            cross = (J_alpha * (weighted_J * pull).sum(1)[:, None]) @ J_share.mT
            own = (J_share * (self.weight * pull * pull).sum(1)[:, None]) @ J_share.mT
            information = information + cross + cross.mT + own
        return cost, gradient, information


def _by_channel(values: Tensor) -> Tensor:
    """From [B, P, S, Q] to [B * P, Q, S]."""
    return values.flatten(0, 1).mT.to(PRECISION).contiguous()
