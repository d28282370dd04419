"""The middle line of an elongated region of the picture, from tip to tip, however it bends."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.splines import SplineBasis, fit_spline

Mask = NDArray[np.uint8]
Map = NDArray[np.float32]
Points = NDArray[np.float64]
Places = NDArray[np.int_]
Order = NDArray[np.float32]

AXIS_POINTS = 64
"""Of the line that is given."""
EVEN, BENT = (5.0, 8), (2.5, 40)
"""Half widths from one bend of the middle line to the next, and its most numbers: of a convex
region, and of another."""
CORES = (0.7, 0.5, 0.3)
"""Depths, in half widths, down to which a bent region is looked at, the first that will do."""
YIELD, TIP = 0.5, 6
"""Half widths by which the line of a bent region must leave a smoother one to be taken instead;
points at either tip that do not count."""
SLACK, LOST = 0.6, 0.01
"""Half widths by which such a core may come short of a tip; share of the region that is lost."""
SOLID = 0.95
"""Share of its convex hull that a convex region fills, given its ragged rim."""


def trace_axis(mask: Mask) -> tuple[Points, float]:
    """Trace the middle line of an elongated region, from tip to tip, and its half width.

    In a convex region pixels are ordered along its longest extent. In another one a walk from tip
    to tip, kept to the core of the region, gives the order: that of its place nearest to each. The
    middles of all that have the same make the line, which follows any bend that does not cross
    itself. [derived]

    Args:
        mask: [H, W], 1 inside the region.

    Returns:
        Points [N, 2] px and the half width, px.
    """
    columns, rows = np.nonzero(mask.any(0))[0], np.nonzero(mask.any(1))[0]
    left, top = int(columns[0]) - 1, int(rows[0]) - 1
    window = np.pad(mask, 1)[rows[0] : rows[-1] + 3, columns[0] : columns[-1] + 3]
    ys, xs = np.nonzero(window)
    points = np.stack([xs + left, ys + top], axis=-1)
    depth: Map = np.asarray(cv2.distanceTransform(window, cv2.DIST_L2, 5), np.float32)
    half_width = float(depth.max())
    if is_convex(points.astype(np.int32)):
        far = _projected(points)
        half_width = min(half_width, mask.sum() / max(2 * float(far.max()), 1.0) * 1.2)
        return _middles(far, points, half_width, 0.0), half_width
    far = _walked(window)[ys, xs]
    half_width = min(half_width, mask.sum() / max(2 * float(far.max()), 1.0) * 1.2)
    # a walk cuts corners, the less so the narrower the band in which it must keep
    core, share = _core(window, depth, half_width)
    along = _along(_way(_walked(core)) + np.array([left, top]), points)
    inside = (along > 0) & (along < along.max())
    cut = share * half_width
    line = _middles(along[inside], points[inside], half_width, cut)
    # where two arms meet they are as deep as none of them
    return line, min(half_width, mask.sum() / (2 * (float(along.max()) + 2 * cut)) * 1.2)


def _core(window: Mask, depth: Map, half_width: float) -> tuple[Mask, float]:
    """Keep the middle of a region, as narrow as leaves it in one piece, and say how narrow."""
    for share in CORES:
        core = (depth >= share * half_width).astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(core, connectivity=8)
        largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()) if count > 1 else 0
        core = (labels == largest).astype(np.uint8)
        # what lies within the share and a little of the core is all of the region
        away = cv2.distanceTransform(1 - core, cv2.DIST_L2, 5) > (share + SLACK) * half_width
        if count > 1 and np.count_nonzero(away & (window > 0)) < LOST * np.count_nonzero(window):
            return core, share
    return window, 0.0


def _middles(far: Order, points: Places, half_width: float, cut: float) -> Points:
    """Lay a smooth line through points [M, 2] in an order [M], and on by what is cut at each tip.

    The line is straight over the last half width of the order at either tip.
    """
    length = float(far.max())
    edge = min(half_width, length / 4)
    order, places = torch.from_numpy(far).double(), torch.from_numpy(points).double()
    inside = (order >= edge) & (order <= length - edge)
    lines = []
    for spacing, most in (EVEN, BENT) if cut else (EVEN,):
        size = int(np.clip(2 + length / (spacing * half_width), 2, most))
        basis = SplineBasis(start=edge, stop=length - edge, size=size)
        coefficients, _ = fit_spline(
            basis, order[inside], places[inside], torch.ones_like(order[inside])
        )
        lines.append(_drawn(basis, coefficients, -cut, length + cut))
    # what hangs on to a streak bends the more yielding line, and turns its tips
    apart = torch.linalg.vector_norm(lines[-1] - lines[0], dim=-1)[TIP:-TIP]
    best = lines[0] if float(apart.max()) < YIELD * half_width else lines[-1]
    return np.asarray(best.numpy(), np.float64)


def _drawn(basis: SplineBasis, coefficients: Tensor, first: float, last: float) -> Tensor:
    """Give points of a line [N, 2] px, which goes on straight where the basis ends."""
    along = torch.linspace(first, last, AXIS_POINTS, dtype=torch.float64)
    inner = along.clamp(basis.start, basis.stop)
    ahead = basis(inner, 1) @ coefficients
    ahead = ahead / torch.linalg.vector_norm(ahead, dim=-1, keepdim=True).clamp_min(1)
    line: Tensor = basis(inner) @ coefficients + (along - inner)[:, None] * ahead
    return line


def _walked(window: Mask) -> NDArray[np.float32]:
    """Give each pixel's distance from a tip, inside the region."""
    ys, xs = np.nonzero(window)
    tip = _farthest(window, (int(ys[0]), int(xs[0])))
    return _walk(window, _farthest(window, tip))


def _way(distance: NDArray[np.float32]) -> Points:
    """Walk from where the distance is 0 to where it is largest: pixels (x, y) [N, 2]."""
    row, column = (int(place) for place in np.unravel_index(distance.argmax(), distance.shape))
    way = [(column, row)]
    while distance[row, column] > 0:
        near = distance[row - 1 : row + 2, column - 1 : column + 2]
        near = np.where(near < 0, np.inf, near)
        down, right = divmod(int(near.argmin()), 3)
        row, column = row + down - 1, column + right - 1
        way.append((column, row))
    return np.array(way[::-1], np.float64)


def _along(line: Points, points: Places) -> Order:
    """Give how far along a line [N, 2] the point nearest to each of some [M, 2] is, px."""
    steps = np.linalg.norm(np.diff(line, axis=0), axis=-1)
    nearest = torch.cdist(torch.from_numpy(points).double(), torch.from_numpy(line)).argmin(1)
    return np.asarray(np.concatenate([[0.0], steps.cumsum()])[nearest.numpy()], np.float32)


def _farthest(window: Mask, seed: tuple[int, int]) -> tuple[int, int]:
    distance = _walk(window, seed)
    row, column = np.unravel_index(int(distance.argmax()), distance.shape)
    return int(row), int(column)


def _walk(window: Mask, seed: tuple[int, int]) -> NDArray[np.float32]:
    """Count the steps from the seed to every pixel of the region, about 1 px each; -1 elsewhere."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    square = np.ones((3, 3), np.uint8)
    reached = np.zeros_like(window)
    reached[seed] = 1
    distance = np.where(reached > 0, 0, -1).astype(np.float32)
    step = 0
    while True:
        step += 1
        # a cross after every two squares advances nearly equally far in every direction
        grown = np.zeros_like(window)
        cv2.dilate(reached, cross if step % 3 == 0 else square, dst=grown)
        grown &= window
        new = grown != reached
        if not new.any():
            if step % 3:
                return distance
            continue  # a cross may stop where only a corner leads on
        distance[new] = step
        reached = grown


def is_convex(points: NDArray[np.int32]) -> bool:
    """Whether the pixels of a region nearly fill their convex hull."""
    return len(points) >= SOLID * cv2.contourArea(cv2.convexHull(points))


def _projected(points: NDArray[np.int_]) -> NDArray[np.float32]:
    """Give how far each point lies along the longest extent of all, from the first one on, px."""
    places = points - points.mean(0)
    share = places @ np.linalg.eigh(places.T @ places)[1][:, 1]
    return np.asarray(share - share.min(), np.float32)
