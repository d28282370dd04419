"""A ball whose colour leans from one side of the streak to the other, as shading makes it.

An estimator that knows of no shade leaves a misfit common to the whole streak. Where the picture
shows one, each channel may rise or fall across the streak, and towards its rims, by as much as
shading does; how much is fitted along with all else, and what is then known of the width, and so
of the depth, is rightly less. [derived]
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord, Observation
from toolkit.types import LinearImage, NoiseModel

TERMS = 2
"""Powers of the chord's offset in each channel: one leans, the other darkens or lights both rims."""


@dataclass(frozen=True, kw_only=True)
class Shaded(AlphaEstimator):
    """Another estimator's ball with a shade laid over it."""

    estimator: AlphaEstimator
    channels: int

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Observe as the other does."""
        return self.estimator.observe(image, background, noise)

    def unknowns(self) -> int:
        """Those of the other, and the shade's."""
        return self.estimator.unknowns() + TERMS * self.channels

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the other's colour and the shade on top of it."""
        return self.foreground_and_slope(chord, appearance)[0]

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Give the same and its derivative in the chord's offset."""
        known = self.estimator.unknowns()
        looks = None if appearance is None or not known else appearance[:known]
        colour, slope = self.estimator.foreground_and_slope(chord, looks)
        if appearance is None:
            return colour, slope
        lean, rims = appearance[known:].to(colour).reshape(TERMS, self.channels)
        s = chord.offset[..., None].to(colour)
        change = lean + 2 * s * rims
        shade = lean * s + rims * (s * s - 0.5)
        return colour + shade, change.expand_as(colour) if slope is None else slope + change
