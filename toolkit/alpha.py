"""The estimator interface: how a kind of ball turns colours into opacity.

Every built-in appearance, and a matte from elsewhere, is one linear mixture per signal channel,

    signal = alpha * foreground + (1 - alpha) * ground,

so an estimator answers two questions and nothing more: what is observed (`observe`), and what the
ball alone would show (`foreground`). The solver never sees colours; an estimator never sees the
solver.
Source: Caglioti & Giusti 2007, eq. (1) and section 3.2.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import ClassVar, final

import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.types import LinearImage, NoiseModel

API_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """A picture as an estimator sees it.

    B image, Q signal channels (three colours, one distance from a plane, one matte).
    """

    signal: Tensor  # [B, Q, H, W] with the ball
    ground: Tensor  # [B, Q, H, W] without it
    variance: Tensor  # [B, Q, H, W] of signal minus ground


@dataclass(frozen=True, slots=True, kw_only=True)
class Chord:
    """Lines across the ball's disc, parallel to the motion, along which its colour is averaged.

    `offset` is (y - centre) / half_width, -1 at the left rim and 1 at the right one when looking
    along `direction`. `start` and `stop` cut a partial chord, in shares of it: -1 is the trailing
    rim, 1 the leading one; the streak's ends show such parts.
    """

    offset: Tensor  # [..., S]
    direction: Tensor  # [..., 1] radians in the image, of the motion
    start: float | Tensor = -1.0  # broadcast against offset
    stop: float | Tensor = 1.0
    place: Tensor | None = None  # [..., 1, 2] px of the ball in the whole picture, where known
    ray: Tensor | None = None  # [..., S, 3] unit, along which each is seen, where known
    ahead: Tensor | None = None  # [..., S, 3] unit, the motion's part across that ray, with it


@dataclass(frozen=True, kw_only=True)
class AlphaEstimator(ABC):
    """How one kind of ball is told from its background.

    Subclass it as a frozen dataclass; fields are its options.

    Example:
        >>> from dataclasses import dataclass
        >>> @dataclass(frozen=True, kw_only=True)
        ... class Matte(AlphaEstimator):
        ...     '''A trivial one: the picture's first channel already is the opacity.'''
        ...     def observe(self, image, background, noise):
        ...         alpha = image.rgb[:, :1]
        ...         return Observation(
        ...             signal=alpha, ground=0 * alpha, variance=noise.variance(image.rgb)[:, :1]
        ...         )
        ...     def foreground(self, chord, appearance):
        ...         return torch.ones_like(chord.offset)[..., None]
        >>> Matte().option_names()
        ()
    """

    api_version: ClassVar[int] = API_VERSION

    @abstractmethod
    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Turn shot and background into signal, ground and variance, before any sampling."""

    @abstractmethod
    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the mean signal of the ball alone along each chord, [..., S, Q].

        Args:
            chord: where on the disc.
            appearance: the unknowns [A], in which the answer is linear; None where there are none.
        """

    def unknowns(self) -> int:
        """Say how many numbers of its appearance, A, are left for the fit to find: none, here."""
        return 0

    def seen_through(self, camera: Camera) -> "AlphaEstimator":
        """Give the estimator that knows the camera of the shot: this one, if that tells nothing."""
        return self

    def other_lights(self) -> tuple["AlphaEstimator", ...]:
        """Give others whose light differs as what this one takes for known may err: none, here.

        Each is drawn for itself, so that the mean square of what they change is its variance.
        """
        return ()

    def loosened(self) -> "AlphaEstimator | None":
        """Give the estimator that leaves open by how much its light errs: none, here.

        Its unknowns are independent errors, each in standard deviations; all zero is the light that
        this one takes for known. The exact stage finds them with the motion.
        """
        return None

    def relit(self, amounts: Tensor) -> "AlphaEstimator":
        """Give the estimator with these errors [E] of `loosened` taken for known."""
        loose = self.loosened()
        return self if loose is None else loose.settled(amounts)

    def doubts(self) -> dict[str, str]:
        """Give cautions about what this estimator was told, by code: none, here.

        Every result carries them, as `code` and message.
        """
        return {}

    @final
    def settled(self, appearance: Tensor) -> "AlphaEstimator":
        """Give the same estimator with its unknowns [A] taken for known."""
        return _Settled(estimator=self, appearance=appearance)

    @final
    @classmethod
    def option_names(cls) -> tuple[str, ...]:
        """Names of the options that `--set field=value` reaches."""
        return tuple(field.name for field in fields(cls) if field.init)

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Give `foreground` and its derivative in the chord's offset, both [..., S, Q].

        The derivative is None where the foreground is constant. Here by reverse mode, one pass a
        channel: exact, and free of the second that forward mode takes to load. Override it where a
        closed form is at hand.
        """
        offset = chord.offset.detach().requires_grad_(True)
        with torch.enable_grad():
            value = self.foreground(replace(chord, offset=offset), appearance)
            if not value.requires_grad:
                return value, None
            slopes = [
                torch.autograd.grad(value[..., q].sum(), offset, retain_graph=True)[0]
                for q in range(value.shape[-1])
            ]
        return value.detach(), torch.stack(slopes, dim=-1)

    @final
    def middle_colour(self, observation: Observation) -> Tensor:
        """Give what the disc's middle would show alone, [1, Q, 1, 1]; its unknowns are settled."""
        zero = torch.zeros(1, dtype=observation.signal.dtype)
        colour = self.foreground(Chord(offset=zero, direction=zero), None)
        return colour.to(observation.signal).reshape(1, -1, 1, 1)

    @final
    def alpha(self, observation: Observation) -> tuple[Tensor, Tensor]:
        """Estimate the opacity of every pixel on its own and its variance, both [B, 1, H, W].

        The least-squares solution of the mixture with the colour of the disc's middle: exact for a
        uniform ball, an approximation good enough to find the streak for a shaded one.
        """
        contrast = self.middle_colour(observation) - observation.ground
        weight = contrast / observation.variance
        information = (weight * contrast).sum(1, keepdim=True).clamp_min(1e-12)
        signal = (weight * (observation.signal - observation.ground)).sum(1, keepdim=True)
        return signal / information, 1 / information


def observe_colours(image: LinearImage, background: LinearImage, noise: NoiseModel) -> Observation:
    """Observe the colours as they are; behind a mosaic, those measured and no others."""
    measured = image.measured()
    variance = noise.variance(image.rgb, measured)
    variance.add_(noise.variance(background.rgb, measured), alpha=1 / background.frames)
    return Observation(signal=image.rgb, ground=background.rgb, variance=variance)


@dataclass(frozen=True, kw_only=True)
class _Settled(AlphaEstimator):
    """An estimator whose unknowns have been found."""

    estimator: AlphaEstimator
    appearance: Tensor  # [A]

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        return self.estimator.observe(image, background, noise)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        return self.estimator.foreground(chord, self.appearance)

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        return self.estimator.foreground_and_slope(chord, self.appearance)
