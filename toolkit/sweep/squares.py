"""Squares of pixels in a window, single ones among them: which they hold and what these show."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

LARGE = 3
"""px of a square that tells by itself how an image changes across it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Squares:
    """M squares of a window, all alike in size."""

    side: int  # px
    corner: Tensor  # [M, 2] column and row of the upper left pixel
    window: tuple[int, int]  # height and width, px

    @classmethod
    def of(cls, mask: NDArray[np.uint8], side: int, window: tuple[int, int]) -> "Squares":
        """Take those that are marked among all [H // side, W // side]."""
        row, column = np.divmod(np.flatnonzero(mask), mask.shape[1])
        corner = torch.from_numpy(np.stack([column, row], axis=-1) * side)
        return cls(side=side, corner=corner, window=window)

    def __len__(self) -> int:
        """Number of squares."""
        return len(self.corner)

    def __getitem__(self, chosen: Tensor) -> "Squares":
        """Give some of them."""
        return Squares(side=self.side, corner=self.corner[chosen], window=self.window)

    @property
    def place(self) -> Tensor:
        """Column and row of their middles [M, 2]."""
        return self.corner.double() + (self.side - 1) / 2

    @property
    def blur(self) -> Tensor:
        """Variance of a place within each beyond that in a single pixel [M], px^2 along a side."""
        return torch.full((len(self),), (self.side**2 - 1) / 12, dtype=torch.float64)

    def index(self, border: int = 0) -> Tensor:
        """Number the pixels of each square and of a border about it [n, M], row by row.

        Those beyond the window are replaced by the nearest inside.
        """
        height, width = self.window
        steps = torch.arange(-border, self.side + border)[:, None]
        column, row = self.corner[:, 0] + steps, self.corner[:, 1] + steps
        if border:
            column, row = column.clamp(0, width - 1), row.clamp(0, height - 1)
        return (row[:, None] * width + column).flatten(0, 1)

    def pick(self, *images: Tensor, border: int = 0) -> list[Tensor]:
        """Give what the pixels of each square show in images [Q, H, W]: [Q, n, M] of each."""
        index = self.index(border)
        flat = index.flatten()
        # several times faster than to index by a matrix
        picked = (image.flatten(1).index_select(1, flat) for image in images)
        return [values.reshape(len(values), *index.shape) for values in picked]

    def ring(self, image: Tensor) -> Tensor:
        """Average an image [Q, H, W] around each square [Q, M], 2 and 3 px beyond its border."""
        count = self.side + 6
        steps = torch.arange(count)
        is_beyond = (steps < 2) | (steps >= count - 2)
        weight = (is_beyond[:, None] | is_beyond).flatten().to(image)
        (values,) = self.pick(image, border=3)
        return (weight / weight.sum()) @ values

    def slope(self, image: Tensor) -> Tensor:
        """Give the change of an image [Q, H, W] across each square, per px [2, Q, M].

        It is that of the plane nearest to its pixels, to the right and downwards; a small square
        takes those about it as well.
        """
        border = 1 if self.side < LARGE else 0
        count = self.side + 2 * border
        steps = torch.arange(count, dtype=image.dtype) - (count - 1) / 2
        right = steps.repeat(count) / (count * (steps * steps).sum())
        down = right.reshape(count, count).mT.flatten()
        (values,) = self.pick(image, border=border)
        return torch.stack([kernel @ values for kernel in (right, down)])
