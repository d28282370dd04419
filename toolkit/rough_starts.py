"""Paths from which the search for the rough motion starts: straight ones, arcs, and corners."""

import cv2
import numpy as np
import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.rough_path import RoughPath
from toolkit.rough_pixels import Blocks
from toolkit.types import Streak

FIRST_TRAVEL = 0.3
"""Half widths: with no travel at all nothing would tell the fit which way to go on."""
INSIDE = 0.6
"""Half widths from the streak's outline from which the ball's centre may have been."""
POINTS = 33
"""Instants at which a path is approximated by another kind."""
MIDDLE = 0.5
"""Half widths from the middle line up to which blocks tell how long the ball was there."""
CORNERS = 33
"""Instants at which a flight may have turned a corner."""
LATEST = 0.45
"""Share of the exposure from its middle up to which they lie."""
LONGEST_GAP = 1.0
"""Half widths between the places of a flight."""


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


def arc_starts(straight: RoughPath, places: Tensor) -> list[RoughPath]:
    """Give a straight path as an arc, and the arc through the extremes of the streak [3, 3] m."""
    time = torch.linspace(-0.5, 0.5, POINTS, dtype=torch.float64)
    flat, corner = straight.accelerated(), _through(*places)
    return [flat, _nearest(time, corner.at(time), flat)]


def corner_starts(arc: RoughPath, places: Tensor) -> list[RoughPath]:
    """Give an arc as a path with a corner, and those with one at each extreme of the streak."""
    time = torch.linspace(-0.5, 0.5, POINTS, dtype=torch.float64)
    first, middle, last = places
    bent = RoughPath(coefficients=torch.zeros(3, 3, dtype=torch.float64), corner=0.0)
    return [
        _nearest(time, arc.at(time), bent),
        _through(first, middle, last),
        _through(middle, first, last),
        _through(first, last, middle),
    ]


def flight_starts(
    blocks: Blocks, streak: Streak, distance: float, camera: Camera
) -> tuple[RoughPath, RoughPath]:
    """Give the free flight, and that with a corner, that the streak's middle line tells.

    Opacity is how long the ball was at each place, and so the clock of its flight. [derived]

    Args:
        blocks: about the streak.
        streak: its axis in order.
        distance: of the ball, m.
        camera: of the shot.
    """
    line = _without_tips(streak.axis[0], float(streak.half_width))
    steps = torch.linalg.vector_norm(line.diff(dim=0), dim=-1)
    apart, nearest = torch.cdist(blocks.place, line).min(1)
    is_used = (apart < MIDDLE * blocks.half_width) & torch.isfinite(blocks.variance).all(1)
    nearest = nearest[is_used]
    total = torch.zeros(len(line), blocks.change.shape[1], dtype=torch.float64)
    total.index_add_(0, nearest, blocks.change[is_used])
    count = torch.bincount(nearest, minlength=len(line)).clamp_min(1)
    stay = torch.linalg.vector_norm(total / count[:, None], dim=-1)
    passed = torch.cat([steps.new_zeros(1), ((stay[1:] + stay[:-1]) / 2 * steps).cumsum(0)])
    time = passed / passed[-1].clamp_min(1e-12) - 0.5
    points = distance * camera.unproject(line)
    none = torch.zeros(3, 3, dtype=torch.float64)
    arc = _nearest(time, points, RoughPath(coefficients=none))
    bent = torch.zeros(4, 3, dtype=torch.float64)
    corners = [
        _nearest(time, points, RoughPath(coefficients=bent, corner=corner))
        for corner in torch.linspace(-LATEST, LATEST, CORNERS).tolist()
    ]
    corner = min(corners, key=lambda path: float(((path.at(time) - points) ** 2).sum()))
    return arc, corner


def _without_tips(axis: Tensor, half_width: float) -> Tensor:
    """Give places of the ball's centre along an axis from tip to tip [N, 2] px."""
    steps = torch.linalg.vector_norm(axis.diff(dim=0), dim=-1)
    along = torch.cat([steps.new_zeros(1), steps.cumsum(0)])
    length = float(along[-1])
    cut = min(half_width, 0.4 * length)
    count = max(POINTS, int((length - 2 * cut) / (LONGEST_GAP * half_width)))
    at = np.linspace(cut, length - cut, count)
    columns = [np.interp(at, along.numpy(), values.numpy()) for values in axis.mT]
    return torch.from_numpy(np.stack(columns, axis=-1))


def extremes(streak: Streak, camera: Camera, distance: float) -> Tensor:
    """Give the two places of the ball farthest apart, and between them that farthest aside.

    Args:
        streak: whose mask tells where the ball's centre may have been.
        camera: of the shot.
        distance: of the ball, m.

    Returns:
        [3, 3] m, the one aside in the middle.
    """
    mask = streak.mask[0, 0].numpy().view(np.uint8)
    left, top, width, height = cv2.boundingRect(mask)
    window = np.pad(mask[top : top + height, left : left + width], 1)
    depth = cv2.distanceTransform(window, cv2.DIST_L2, 5)
    reach = INSIDE * min(float(depth.max()), float(streak.half_width))
    inside = np.argwhere(depth >= reach)[:, ::-1] + (left - 1, top - 1)
    points = torch.from_numpy(inside.astype(np.float64))
    hull = torch.from_numpy(cv2.convexHull(inside.astype(np.int32)).reshape(-1, 2)).double()
    farthest = int(torch.cdist(hull, hull).argmax())
    first, last = hull[farthest // len(hull)], hull[farthest % len(hull)]
    x, y = (last - first).tolist()
    aside = ((points - first) @ torch.tensor([-y, x], dtype=torch.float64)).abs()
    return distance * camera.unproject(torch.stack([first, points[int(aside.argmax())], last]))


def _through(first: Tensor, corner: Tensor, last: Tensor) -> RoughPath:
    """Give the path from place to place [3] at one speed."""
    before, after = corner - first, last - corner
    lengths = torch.linalg.vector_norm(torch.stack([before, after]), dim=-1)
    share = (lengths / lengths.sum().clamp_min(1e-9)).clamp(0.1, 0.9)
    velocities = torch.stack([before / share[0], after / (1 - share[0])])
    return RoughPath(
        coefficients=torch.cat([corner[None], velocities]), corner=float(share[0]) - 0.5
    )


def _nearest(time: Tensor, points: Tensor, kind: RoughPath) -> RoughPath:
    """Give the path of a kind that is nearest to points [T, 3] at times [T]."""
    coefficients = torch.linalg.lstsq(kind.basis(time), points).solution
    return RoughPath(coefficients=coefficients, corner=kind.corner)
