"""A ball seen sharply: where its disc lies and what light it sends from each place of it."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Disc:
    """The image of a resting ball: an ellipse, longer away from the picture's middle."""

    centre: tuple[float, float]  # px
    semi_axes: tuple[float, float]  # px, the longer one first
    angle: float  # radians from x towards y, of the longer one
    std: float  # px, of the outline

    def to_unit(self, points: Tensor) -> Tensor:
        """Map pixels [..., 2] to the unit disc: x right, y down, the rim at distance 1.

        The ellipse is stretched along its own axes, so that directions stay as nearly as can be.
        """
        return (points - self._centre(points)) @ self._stretch(points, inverse=True)

    def from_unit(self, points: Tensor) -> Tensor:
        """Map places on the unit disc [..., 2] back to pixels."""
        return points @ self._stretch(points, inverse=False) + self._centre(points)

    def _centre(self, like: Tensor) -> Tensor:
        return torch.tensor(self.centre, dtype=like.dtype)

    def _stretch(self, like: Tensor, *, inverse: bool) -> Tensor:
        angle = torch.tensor(self.angle, dtype=like.dtype)
        turn = torch.stack([angle.cos(), angle.sin(), -angle.sin(), angle.cos()]).reshape(2, 2)
        lengths = torch.tensor(self.semi_axes, dtype=like.dtype)
        return turn.mT @ torch.diag(1 / lengths if inverse else lengths) @ turn


@dataclass(frozen=True, slots=True, kw_only=True)
class SharpBall:
    """The light of a ball's disc, on a square grid over the unit disc.

    Node (row, column) of N x N lies at x = -1 + 2 column / (N - 1), y likewise by row; beyond the
    rim the light goes on as it is at the rim.
    """

    disc: Disc
    rgb: Tensor  # [3, N, N] linear light, sensor white = 1
    clipped: float = 0.0  # share of the disc that met white, where the light is too low
    others: Tensor | None = None  # [D, 3, N, N] light off by independent errors, where known
    """The mean square of their distances from the light is its variance."""
