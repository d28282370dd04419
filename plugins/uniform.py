"""A ball of one known colour: the paper's first case."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit import AlphaEstimator, Chord, ConfigError, LinearImage, NoiseModel, Observation


@dataclass(frozen=True, kw_only=True)
class Uniform(AlphaEstimator):
    """The ball shows one colour everywhere, and that colour is known.

    Source: Caglioti & Giusti 2007, section 3.2.1. Deviation: all three channels are weighed by
    their noise and contrast instead of one intensity being used.
    """

    colour: tuple[float, float, float]
    """Linear R,G,B of the ball in this light, sensor white = 1."""

    def __post_init__(self) -> None:
        if len(self.colour) != 3 or not all(math.isfinite(c) and 0 <= c <= 4 for c in self.colour):
            raise ConfigError(
                f"ball colour {self.colour} is not three linear values R,G,B, sensor white = 1"
            )

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Hand on the colours as they are; behind a mosaic, those measured and no others."""
        measured = image.measured()
        variance = (
            noise.variance(image.rgb, measured)
            + noise.variance(background.rgb, measured) / background.frames
        )
        return Observation(signal=image.rgb, ground=background.rgb, variance=variance)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the one colour on every chord."""
        colour = torch.tensor(self.colour, dtype=chord.offset.dtype, device=chord.offset.device)
        return colour.expand(*chord.offset.shape, 3)
