"""Smooth shades on the surface of a ball, linear in their numbers.

Four numbers are light linear in the normal, which a matt ball before one lamp has where that shines
on it; a spline, even in the angle of the normal, is whatever else is smooth; and lamps end where
they are across the normal. [derived]
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

CELLS = 12
"""Of the spline along a diameter, even in the angle of the normal."""
MOST_TURN = 0.3
"""Radians by which a lamp is turned at once, at most."""
LAMPS = 256
"""Directions, over half a sphere, in which a lamp is sought first."""


def shade_size() -> int:
    """Say how many numbers a shade has but for lamps."""
    return 4 + (CELLS + 3) ** 2


def _chart(unit: Tensor) -> Tensor:
    """Give places even in the angle of the normal, on the unit disc too."""
    length = torch.linalg.vector_norm(unit, dim=-1, keepdim=True).clamp(1e-12, 1)
    place: Tensor = unit / length * (torch.asin(length) / (math.pi / 2))
    return place


def lamp_directions() -> Tensor:
    """Give directions evenly over half a sphere, [LAMPS, 3]."""
    number = torch.arange(LAMPS, dtype=torch.float64)
    height, turn = (number + 0.5) / LAMPS, number * (math.pi * (3 - math.sqrt(5)))
    beside = (1 - height * height).sqrt()
    return torch.stack([beside * turn.cos(), beside * turn.sin(), -height], dim=-1)


def turned(lamp: Tensor, turn: Tensor) -> Tensor:
    """Turn a lamp [1, 3] by two small angles across it."""
    away = torch.eye(3, dtype=torch.float64)[int(lamp[0].abs().argmin())]
    first = torch.nn.functional.normalize(torch.linalg.cross(lamp[0], away), dim=0)
    second = torch.linalg.cross(lamp[0], first)
    turn = turn.clamp(-MOST_TURN, MOST_TURN)
    new: Tensor = torch.nn.functional.normalize(lamp + turn[0] * first + turn[1] * second, dim=-1)
    return new


def facing_places(unit: Tensor, near: Tensor) -> Tensor:
    """Give the normals' parts across the view at places of the unit disc [..., 2].

    From afar they are the places. Of a ball near by less than half is seen: with the sine of the
    angle under which its radius is seen, a ray at an angle b from its middle meets it where the
    normal leans by asin(sin b / sine) - b. Seen askew, its middle is not that of its outline: what
    moves it there is the projection that leaves the outline where it is. [derived]

    Args:
        unit: places.
        near: that sine, and the place of the middle's ray [3].
    """
    sine, across = near[0], near[1:]
    shift = across.norm().clamp_min(1e-12)
    ahead = across / shift
    along = (unit * ahead).sum(-1, keepdim=True)
    beside = (unit - along * ahead) * (1 - shift * shift).sqrt()
    place = ((along - shift) * ahead + beside) / (1 - shift * along)
    length = torch.linalg.vector_norm(place, dim=-1, keepdim=True).clamp(1e-12, 1)
    tangent = length * (sine / (1 - sine * sine).sqrt())
    lean = torch.asin((tangent / (1 + tangent * tangent).sqrt() / sine).clamp_max(1))
    facing: Tensor = place / length * torch.sin(lean - torch.atan(tangent))
    return facing


def lamp_light(unit: Tensor, lamps: Tensor) -> Tensor:
    """Give the light of lamps [G, L], but for what is linear in the normal."""
    facing = (1 - (unit * unit).sum(-1, keepdim=True)).clamp_min(0).sqrt()
    return (torch.cat([unit, -facing], dim=-1) @ lamps.mT).abs() / 2


def sparse_basis(unit: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give the numbers of a shade at places [G, 2]: rows, columns and values, [G * 20] each."""
    facing = (1 - (unit * unit).sum(-1)).clamp_min(0).sqrt()
    plain = torch.stack([torch.ones_like(facing), unit[:, 0], unit[:, 1], facing], dim=-1)
    at = (_chart(unit) + 1) * (CELLS / 2)
    cell = at.long().clamp(0, CELLS - 1)
    near = _cubic(at - cell)
    values = (near[:, 1, :, None] * near[:, 0, None]).flatten(1)
    steps = torch.arange(4)
    column = cell[:, 0, None, None] + steps
    columns = (cell[:, 1, None, None] + steps[:, None]) * (CELLS + 3) + column + 4
    columns = torch.cat([steps.expand(len(unit), 4), columns.flatten(1)], dim=1)
    rows = torch.arange(len(unit))[:, None].expand_as(columns)
    return rows.flatten(), columns.flatten(), torch.cat([plain, values], dim=1).flatten()


def dense_basis(unit: Tensor) -> Tensor:
    """Give the same as a matrix, [G, K]."""
    rows, columns, values = sparse_basis(unit)
    basis = torch.zeros(len(unit) * shade_size(), dtype=torch.float64)
    return basis.index_add_(0, rows * shade_size() + columns, values).reshape(
        len(unit), shade_size()
    )


def _cubic(x: Tensor) -> Tensor:
    """Give the four B-splines at x = 0 to 1 in a cell, [..., 4]."""
    rest = 1 - x
    middle = (4 - 6 * x * x + 3 * x**3) / 6
    other = (4 - 6 * rest * rest + 3 * rest**3) / 6
    return torch.stack([rest**3 / 6, middle, other, x**3 / 6], dim=-1)


def bending(size: int) -> tuple[Tensor, int]:
    """Give the squared second differences of the spline [K, K], and of how many numbers."""
    side = CELLS + 3
    one = torch.eye(side, dtype=torch.float64)
    bend, rise = one.diff(n=2, dim=0), one.diff(dim=0)
    parts = [torch.kron(bend, one), torch.kron(one, bend), math.sqrt(2) * torch.kron(rise, rise)]
    differences = torch.cat(parts)
    penalty = torch.zeros(size, size, dtype=torch.float64)
    penalty[4 : shade_size(), 4 : shade_size()] = differences.mT @ differences
    return penalty, side**2 - 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadeTable:
    """A shade, looked up quickly."""

    values: Tensor  # [1, 3, N, N] over the chart
    near: Tensor  # [3], see `facing_places`

    @classmethod
    def of(cls, coefficients: Tensor, lamp: Tensor, near: Tensor) -> "ShadeTable":
        """Lay out a shade [3, K + 1], the last number that of a lamp [1, 3]."""
        line = torch.linspace(-1, 1, 129, dtype=torch.float64)
        chart = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1)
        angle = torch.linalg.vector_norm(chart, dim=-1, keepdim=True)
        unit = chart * torch.sinc(angle.clamp_max(1) / 2) * (math.pi / 2)
        unit = unit.reshape(-1, 2)
        basis = torch.cat([dense_basis(unit), lamp_light(unit, lamp)], dim=1)
        light = basis @ coefficients.mT
        return cls(values=light.mT.reshape(1, 3, 129, 129), near=near)

    def at(self, unit: Tensor) -> Tensor:
        """Give the light at places of the unit disc [G, 2], [G, 3]."""
        place = _chart(facing_places(unit, self.near))
        found = torch.nn.functional.grid_sample(
            self.values, place[None, None], align_corners=True, padding_mode="border"
        )
        light: Tensor = found[0, :, 0].mT
        return light
