"""Where pixels look: their rays, and how these change from one pixel to the next."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.camera import Camera

COARSE = 16
"""px between the places whose derivative of the ray is found; between them it is interpolated."""
LITTLE = 0.03
"""px by which interpolated rays may miss their pixels for one step to bring them there."""
MOST_STEPS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """Where N pixels, or squares of them, look."""

    unit: Tensor  # [3, N]
    right: Tensor  # [3, N] change of the ray for one px to the right
    down: Tensor  # [3, N] the same downwards
    blur: Tensor  # [N] variance of a place in the square beyond that in a single pixel, px^2

    def __getitem__(self, index: Tensor) -> "Rays":
        """Give those with some indices."""
        return Rays(
            unit=self.unit[:, index],
            right=self.right[:, index],
            down=self.down[:, index],
            blur=self.blur[index],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RayGrid:
    """Rays and how they change on a coarse grid, between whose places they are interpolated."""

    camera: Camera
    low: Tensor  # [2] px of its first place
    high: Tensor  # [2] px of its last
    values: Tensor  # [Y, X, 9]: the ray, its change to the right and its change downwards

    @classmethod
    def over(cls, camera: Camera, low: Tensor, high: Tensor) -> "RayGrid":
        """Lay the grid over a part of the picture, from and to [2] px, distortion inside."""
        high = torch.maximum(high, low + 1e-9)
        counts = (((high - low) / COARSE).ceil().long() + 1).clamp_min(2)
        x, y = (
            torch.linspace(float(a), float(b), int(n), dtype=torch.float64)
            for a, b, n in zip(low, high, counts, strict=True)
        )
        grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
        rays, J = camera.unproject_and_J(grid)
        return cls(
            camera=camera, low=low, high=high, values=torch.cat([rays, J.mT.flatten(-2)], dim=-1)
        )

    def rays(self, place: Tensor, blur: Tensor | None = None) -> Rays:
        """Give the rays of pixels.

        With the help of the interpolated changes one step, behind a wide lens two, makes the
        interpolated rays exact to a millionth of a px.

        Args:
            place: px, on the grid [N, 2].
            blur: variance of places in a square beyond that in a single pixel [N], px^2; else none.
        """
        fine = _interpolated(self.values, (place - self.low) / (self.high - self.low))
        unit, right, down = fine.reshape(3, 3, -1)
        for _ in range(MOST_STEPS):
            missing = (place - self.camera.project(unit.mT)).mT
            unit = unit + missing[0] * right + missing[1] * down
            unit = unit * (unit * unit).sum(0).rsqrt()
            if not float(missing.abs().max()) > LITTLE:
                break
        blur = torch.zeros_like(unit[0]) if blur is None else blur
        return Rays(unit=unit, right=right, down=down, blur=blur)


def _interpolated(grid: Tensor, share: Tensor) -> Tensor:
    """Interpolate a grid [Y, X, C] at places [N, 2] from 0 to 1, bilinearly: [C, N]."""
    rows, columns, channels = grid.shape
    at = share.mT * torch.tensor([[columns - 1.0], [rows - 1.0]], dtype=share.dtype)
    left = at[0].long().clamp_max(columns - 2)
    top = at[1].long().clamp_max(rows - 2)
    x, y = at[0] - left, at[1] - top
    flat = grid.reshape(-1, channels).mT.contiguous()
    first = top * columns + left
    corners = (flat.index_select(1, first + step) for step in (0, 1, columns, columns + 1))
    top_left, top_right, low_left, low_right = corners
    upper = torch.lerp(top_left, top_right, x)
    lower = torch.lerp(low_left, low_right, x)
    return torch.lerp(upper, lower, y)
