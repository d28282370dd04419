"""A ball whose colour leans from one side of the streak to the other, as shading makes it.

An estimator that knows of no shade leaves a misfit common to the whole streak. Where the picture
shows one, each channel may rise or fall across the streak, and towards its rims, by as much as
shading does; how much is fitted along with all else, and what is then known of the width, and so
of the depth, is rightly less. [derived]
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord, Observation
from toolkit.sweep.chord_table import STEEPEST
from toolkit.sweep.colours import is_plain
from toolkit.types import LinearImage, NoiseModel


@dataclass(frozen=True, kw_only=True)
class Shaded(AlphaEstimator):
    """Another estimator's ball with a shade laid over it."""

    estimator: AlphaEstimator
    channels: int
    powers: tuple[int, ...] = (1, 2)
    """Of the chord's offset: 0 is another colour, 1 leans, 2 darkens or lights both rims."""
    is_ahead: bool = False
    """Whether the ball may be brighter or darker ahead too, which the streak's ends show: linearly
    from its trailing to its leading rim, none on the mean over a whole chord."""

    @staticmethod
    def powers_above(estimator: AlphaEstimator) -> tuple[int, ...]:
        """Give the next two powers that an estimator's shade leaves out.

        A ball that is not shaded as it is known to be does not show the one colour either that it
        is known by: the mean light differs as well, or there are marks on it.
        """
        if isinstance(estimator, Shaded):
            first = estimator.powers[-1] + 1
            return (first, first + 1)
        is_known = is_plain(estimator) and not estimator.unknowns()
        return (0, 1, 2) if is_known else (1, 2)

    @property
    def innermost(self) -> AlphaEstimator:
        """The ball below all shades."""
        below = self.estimator
        return below.innermost if isinstance(below, Shaded) else below

    @property
    def is_recoloured(self) -> bool:
        """Whether the ball shows another colour than the one it is known by."""
        below = self.estimator
        return 0 in self.powers or (isinstance(below, Shaded) and below.is_recoloured)

    @property
    def shades(self) -> int:
        """Numbers of the shade, and of one below it."""
        below = self.estimator.shades if isinstance(self.estimator, Shaded) else 0
        return below + self._own()

    def _own(self) -> int:
        return (len(self.powers) + self.is_ahead) * self.channels

    @property
    def looks_ahead(self) -> bool:
        """Whether parts of a chord differ."""
        below = self.estimator
        return self.is_ahead or (isinstance(below, Shaded) and below.looks_ahead)

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Observe as the other does."""
        return self.estimator.observe(image, background, noise)

    def other_lights(self) -> tuple[AlphaEstimator, ...]:
        """Lay the same shade over the other's."""
        return tuple(replace(self, estimator=other) for other in self.estimator.other_lights())

    def unknowns(self) -> int:
        """Those of the other, and the shade's."""
        return self.estimator.unknowns() + self._own()

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the other's colour and the shade on top of it."""
        colour = self.estimator.foreground(chord, self._below(appearance))
        return colour if appearance is None else colour + self._shade(chord, colour, appearance)[0]

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Give the same and its derivative in the chord's offset."""
        colour, slope = self.estimator.foreground_and_slope(chord, self._below(appearance))
        if appearance is None:
            return colour, slope
        shade, change = self._shade(chord, colour, appearance)
        return colour + shade, change if slope is None else slope + change

    def ahead(self, appearance: Tensor) -> Tensor:
        """Give by how much the leading rim is brighter than the ball's middle [Q]."""
        own = appearance[-self._own() :].reshape(-1, self.channels)
        ahead = own[-1] if self.is_ahead else torch.zeros_like(own[0])
        below = self.estimator
        return (
            ahead + below.ahead(appearance[: -self._own()]) if isinstance(below, Shaded) else ahead
        )

    def _below(self, appearance: Tensor | None) -> Tensor | None:
        known = self.estimator.unknowns()
        return None if appearance is None or not known else appearance[:known]

    def _shade(self, chord: Chord, like: Tensor, appearance: Tensor) -> tuple[Tensor, Tensor]:
        """Give the shade alone and its derivative in the chord's offset."""
        s = chord.offset[..., None].to(like)
        shade, change = torch.zeros_like(like), torch.zeros_like(like)
        rows = appearance[self.estimator.unknowns() :].to(like).reshape(-1, self.channels)
        if self.is_ahead:
            middle = torch.as_tensor((chord.start + chord.stop) / 2, dtype=like.dtype)[..., None]
            height = (1 - s * s).clamp_min(0).sqrt()
            shade = shade + rows[-1] * height * middle
            change = change - rows[-1] * middle * s / height.clamp_min(STEEPEST)
        for power, row in zip(self.powers, rows, strict=False):
            even = 1 / (power + 1) if power and power % 2 == 0 else 0.0
            shade = shade + row * (s**power - even)
            if power:
                change = change + row * power * s ** (power - 1)
        return shade, change
