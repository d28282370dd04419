"""How a ball's look changes where the view of it turns, while lamp and room stay.

A disc shows the part of the ball that faces the viewer. Seen along another ray, that part is
another one: with the view turned by d = (d_x, d_y), radians right and down, the disc shows at
(x, y) what it showed at (x - c d_x, y - c d_y), c = sqrt(1 - x^2 - y^2). [derived]
A glossy highlight moves by half of that, which one picture alone does not tell from shading.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit import Camera, Disc, SharpBall

NODES = 33
"""Along a side of the picture, at which viewing rays are found; those between are interpolated."""
SIZE = 65
"""Nodes across the ball at which the change of its look is found."""
SMOOTHING = 1 / 12
"""Standard deviation, radians of the ball's surface, over which that is averaged against noise."""
MARGIN = 6
"""Nodes beyond the rim that the averaging reaches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewTurn:
    """By how much the view is turned at each place of the picture."""

    turns: Tensor  # [1, 2, NODES, NODES] radians, right and down
    width: int  # px of the picture
    height: int
    radius: float  # radians, of the ball in the sharp picture

    @classmethod
    def of(cls, camera: Camera, disc: Disc) -> "ViewTurn":
        """Measure turns from the view of a sharp ball's disc; 0 where the lens shows nothing."""
        x, y = (
            torch.linspace(0, size - 1, NODES, dtype=torch.float64)
            for size in (camera.width, camera.height)
        )
        rays = camera.unproject(torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1))
        outline = torch.tensor([[0.0, 0.0], [0.0, 1.0], [0.0, -1.0]], dtype=torch.float64)
        view, top, bottom = camera.unproject(disc.from_unit(outline))
        # the picture's axes, carried from the middle of the view by the smallest rotation
        axes = torch.eye(3, dtype=torch.float64)
        right, down = (axis - (axis @ view) / (1 + view[2]) * (view + axes[2]) for axis in axes[:2])
        turns = torch.nan_to_num(rays @ torch.stack([right, down], dim=-1))
        radius = float(torch.nan_to_num((top - bottom) @ down).abs()) / 2
        return cls(
            turns=turns.movedim(-1, 0)[None],
            width=camera.width,
            height=camera.height,
            radius=radius,
        )

    def at(self, place: Tensor) -> Tensor:
        """Give the turn at pixels [..., 2] and the ball's radius, [..., 3].

        Beyond the picture's border the turn is that at the border.
        """
        size = torch.tensor([self.width - 1, self.height - 1], dtype=place.dtype)
        grid = (2 * place / size - 1).reshape(1, 1, -1, 2)
        turns = torch.nn.functional.grid_sample(
            self.turns.to(place), grid, padding_mode="border", align_corners=True
        )
        turns = turns[0, :, 0].mT.reshape(place.shape)
        return torch.nn.functional.pad(turns, (0, 1), value=self.radius)


def change_of_look(ball: SharpBall) -> tuple[Tensor, Tensor]:
    """Differentiate a ball's light in the turn of the view, right and down.

    Returns:
        Two images [3, SIZE, SIZE] over the disc in which a place lies from the middle as far as its
        angle on the ball is: there the light of a matt ball is smooth up to the rim.
    """
    spacing = math.pi / (SIZE - 1)
    line = (torch.arange(SIZE + 2 * MARGIN) - (SIZE - 1) / 2 - MARGIN) * spacing
    y, x = torch.meshgrid(line, line, indexing="ij")
    angle = torch.hypot(x, y)
    outward = torch.stack([x, y], dim=-1) / angle.clamp_min(1e-6)[..., None]
    light = _mirrored(ball.rgb.float(), outward, angle)
    right, down = _slopes(light, spacing)
    inner = (slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
    e_x, e_y = outward[inner].unbind(-1)
    angle = angle[inner]
    # the surface moves by 1 along the circle through the middle, by angle / tan(angle) across it
    across = torch.where(angle > 1e-3, angle / angle.tan(), 1)
    along = (1 - across) * (e_x * right + e_y * down)
    return -(across * right + along * e_x), -(across * down + along * e_y)


def to_angles(place: Tensor) -> Tensor:
    """Map the unit disc [..., 2] to that of `change_of_look`, scaled so that the rim is at 1."""
    distance = torch.linalg.vector_norm(place, dim=-1, keepdim=True).clamp(1e-6, 1)
    share: Tensor = torch.asin(distance) / distance * (2 / math.pi)
    return place * share


def _mirrored(rgb: Tensor, outward: Tensor, angle: Tensor) -> Tensor:
    """Give the light [3, N, N] by angles; beyond the rim it goes on as it came."""
    at = outward * angle.sin()[..., None]
    light, rim = (
        torch.nn.functional.grid_sample(
            rgb[None], places[None], padding_mode="border", align_corners=True
        )[0]
        for places in (at, outward)
    )
    return torch.where(angle > math.pi / 2, 2 * rim - light, light)


def _slopes(light: Tensor, spacing: float) -> tuple[Tensor, Tensor]:
    """Give the slopes right and down of smoothed images [3, N, N], MARGIN nodes cut off."""
    node = torch.arange(-MARGIN, MARGIN + 1) * spacing
    mean = torch.exp(-0.5 * (node / SMOOTHING) ** 2)
    mean = mean / mean.sum()
    slope = mean * node
    slope = slope / (slope * node).sum()
    kernels = torch.stack([torch.outer(mean, slope), torch.outer(slope, mean)])[:, None]
    slopes = torch.nn.functional.conv2d(light[:, None], kernels)
    return slopes[:, 0], slopes[:, 1]
