"""A ball of one colour, known or not: the paper's first case."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit import (
    AlphaEstimator,
    Chord,
    ConfigError,
    LinearImage,
    NoiseModel,
    Observation,
    observe_colours,
)


@dataclass(frozen=True, kw_only=True)
class Uniform(AlphaEstimator):
    """The ball shows one colour everywhere; where nobody says which, the fit finds it.

    A colour is told from the opacity by how a varying background shines through, and by the
    streak's length.
    Source: Caglioti & Giusti 2007, section 3.2.1. Deviations: all three channels are weighed by
    their noise and contrast instead of one intensity being used; the colour may be unknown.
    """

    colour: tuple[float, float, float] | None = None
    """Linear R,G,B of the ball in this light, sensor white = 1; none leaves it to the fit."""

    def __post_init__(self) -> None:
        if self.colour is None:
            return
        if len(self.colour) != 3 or not all(math.isfinite(c) and 0 <= c <= 4 for c in self.colour):
            raise ConfigError(
                f"ball colour {self.colour} is not three linear values R,G,B, sensor white = 1"
            )

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Hand on the colours as they are; behind a mosaic, those measured and no others."""
        return observe_colours(image, background, noise)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the one colour on every chord."""
        colour = self.colour if appearance is None else appearance.tolist()
        values = torch.tensor(colour, dtype=chord.offset.dtype, device=chord.offset.device)
        return values.expand(*chord.offset.shape, 3)

    def unknowns(self) -> int:
        """Three where no colour is given."""
        return 3 if self.colour is None else 0
