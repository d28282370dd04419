"""Paths from which the search for the rough motion starts: straight ones, arcs, and corners."""

import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.rough_path import RoughPath
from toolkit.types import Streak

FIRST_TRAVEL = 0.3
"""Half widths: with no travel at all nothing would tell the fit which way to go on."""
TRACED = 1.0
"""Widths of travel from which the axis may show how a path bends."""
CORNERS = (-0.25, 0.0, 0.25)
"""Shares of the exposure at which a corner is tried."""
POINTS = 33
"""Instants at which a path is approximated by another kind."""


def straight_start(streak: Streak, camera: Camera, ball_radius: float) -> RoughPath:
    """Place a straight path, square to the line of sight, where the streak's mask lies."""
    half_width = float(streak.half_width)
    place = streak.mask[0, 0].nonzero().double().flip(-1)
    centre = place.mean(0)
    along = torch.linalg.eigh((place - centre).mT @ (place - centre))[1][:, 1]
    travel = max(float(streak.travel), FIRST_TRAVEL * half_width) * along
    across = half_width * torch.stack([-along[1], along[0]])
    sides = torch.stack([-travel / 2, travel / 2, -across, across])
    first, last, left, right = camera.unproject(centre + sides)
    # the ball touches the cone that its outline makes
    half_angle = torch.atan2(
        torch.linalg.vector_norm(right - left), torch.linalg.vector_norm(right + left)
    )
    distance = ball_radius / half_angle.sin()
    return RoughPath(coefficients=distance * torch.stack([(first + last) / 2, last - first]))


def arc_starts(straight: RoughPath, streak: Streak, camera: Camera) -> list[RoughPath]:
    """Give the straight path that was found as an arc, and the arc along a long streak's axis."""
    flat = straight.accelerated()
    if streak.widths < TRACED:
        return [flat]
    return [flat, _nearest(*_along_axis(straight, streak, camera), flat)]


def corner_starts(arc: RoughPath, streak: Streak, camera: Camera) -> list[RoughPath]:
    """Give paths with a corner at several instants of an arc, and that along the streak's axis."""
    time = torch.linspace(-0.5, 0.5, POINTS, dtype=torch.float64)
    whole, passed = arc.at(time), _along_axis(arc, streak, camera)
    empty = torch.zeros(3, 3, dtype=torch.float64)
    kinds = [RoughPath(coefficients=empty, corner=corner) for corner in CORNERS]
    along_axis = [_nearest(*passed, kind) for kind in kinds]
    closest = min(
        along_axis, key=lambda path: float((path.at(passed[0]) - passed[1]).square().sum())
    )
    return [*(_nearest(time, whole, kind) for kind in kinds), closest]


def turned_starts(path: RoughPath) -> list[RoughPath]:
    """Give the paths whose corner is where one ended or began, which sweep a similar region."""
    first, last = path.at(torch.tensor([-0.5, 0.5], dtype=torch.float64))
    corner = path.coefficients[0]
    return [_through(corner, first, last), _through(first, last, corner)]


def _through(first: Tensor, corner: Tensor, last: Tensor) -> RoughPath:
    """Give the path from place to place [3] at one speed."""
    before, after = corner - first, last - corner
    lengths = torch.linalg.vector_norm(torch.stack([before, after]), dim=-1)
    share = (lengths / lengths.sum()).clamp(0.1, 0.9)
    velocities = torch.stack([before, after]) / share[:, None]
    return RoughPath(
        coefficients=torch.cat([corner[None], velocities]), corner=float(share[0]) - 0.5
    )


def _along_axis(path: RoughPath, streak: Streak, camera: Camera) -> tuple[Tensor, Tensor]:
    """Give times and places of a ball that follows the streak's axis, as far away as a path."""
    axis, half_width = streak.axis[0], float(streak.half_width)
    length = torch.linalg.vector_norm(axis.diff(dim=0), dim=-1).cumsum(0)
    length = torch.cat([length.new_zeros(1), length])
    # the ball's centre stays a half width from the tips
    edge = min(half_width, 0.45 * float(length[-1]))
    is_inner = (length >= edge) & (length <= length[-1] - edge)
    inner, place = axis[is_inner], length[is_inner]
    time = (place - place[0]) / (place[-1] - place[0]) - 0.5
    distance = torch.linalg.vector_norm(path.at(torch.zeros_like(time[:1])))
    return time, distance * camera.unproject(inner)


def _nearest(time: Tensor, points: Tensor, kind: RoughPath) -> RoughPath:
    """Give the path of a kind that is nearest to points [T, 3] at times [T]."""
    coefficients = torch.linalg.lstsq(kind.basis(time), points).solution
    return RoughPath(coefficients=coefficients, corner=kind.corner)
