"""Shot and background, reduced so far that a look at the whole of both takes little time."""

import math
from dataclasses import dataclass, replace

from torch import Tensor

from toolkit.background import scale_background
from toolkit.block_means import block_means, whole_periods
from toolkit.types import LinearImage

MAX_SIDE = 540
"""px; larger pictures are reduced to this: the search for a whole streak needs no more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Overview:
    """Both pictures reduced to the means of their blocks."""

    image: LinearImage
    background: LinearImage
    factor: int  # px along a block; a mosaic's blocks hold whole periods of its pattern

    @classmethod
    def of(
        cls, image: LinearImage, background: LinearImage, factor: int | None = None
    ) -> "Overview":
        """Reduce both by a factor; where none is told, by what leaves at most MAX_SIDE."""
        if factor is None:
            factor = max(1, math.ceil(max(image.width, image.height) / MAX_SIDE))
            factor = factor if factor == 1 else whole_periods(image, factor)
        return cls(
            image=block_means(image, factor),
            background=block_means(background, factor),
            factor=factor,
        )

    def lit(self, light: Tensor) -> "Overview":
        """Give the same with the background in another light, each channel times its ratio [3]."""
        return replace(self, background=scale_background(self.background, light))
