"""The shape of a region of the picture: whether a ball can have left it, and its middle line.

A ball leaves the band of its own width about its path: a disc where it stood still. All lengths are
px of the picture given.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from toolkit.splines import SplineBasis, fit_spline

Mask = NDArray[np.uint8]
Map = NDArray[np.float32]
Points = NDArray[np.float64]
Places = NDArray[np.int_]
Order = NDArray[np.float32]

CANDIDATES = 6
"""Regions that are looked at, the largest."""
AXIS_POINTS = 64
SMALLER = 0.6
"""Half width of the discs that a region is covered with, over its own."""
MIN_EVENNESS = 0.6
"""Share of a region that they must cover; noise and balls that come nearer cost some."""
LONG = 1.0
"""Widths of travel from which no other thing is likely to look like a ball's trail."""
EVEN, BENT = (5.0, 8), (2.5, 40)
"""Half widths from one bend of the middle line to the next, and its most numbers: of a convex
region, and of another."""
CORES = (0.7, 0.5, 0.3)
"""Depths, in half widths, down to which a bent region is looked at, the first that will do."""
SLACK, LOST = 0.6, 0.01
"""Half widths by which such a core may come short of a tip; share of the region that is lost."""
STOUT = 2.0
"""Length over width below which a region may be too short for its tips to be found."""
SOLID = 0.95
"""Share of its convex hull that such a region fills."""
GROWN = 1.5
"""Area, in squares of the half width, by which a faint rest must reach beyond a region."""
ALIKE = 0.9
"""Evenness of a region with such a rest: no shadow is as wide as the ball all along."""
WIDER = 2.5
"""Factor by which the half width may grow: of a faint streak little but the middle is clear."""
COVERED = (0.35, 2.0)
"""Range of a region's opacity, summed, over the ball's area: what it is whatever the motion."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A connected region of the picture that a ball may have left."""

    mask: Mask  # [H, W] 0 or 1
    axis: Points  # [N, 2] px, from tip to tip
    half_width: float  # px
    travel: float  # px, of the ball's centre
    evenness: float  # share of the region that is as wide as a ball's trail would be

    @property
    def widths(self) -> float:
        """How many of its own widths the ball went."""
        return self.travel / (2 * self.half_width)


def regions(found: Mask, faint: Mask, min_area: int) -> Iterator[Region]:
    """Yield the largest connected regions with their axes, holes filled, and their faint rests.

    Args:
        found: [H, W], 1 where a ball is clearly seen.
        faint: the same where anything is seen.
        min_area: px of what is clearly seen.
    """
    closed = cv2.morphologyEx(found, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    seen = np.zeros_like(found)
    by_area = sorted(range(1, count), key=lambda i: stats[i, cv2.CC_STAT_AREA], reverse=True)
    for label in by_area[:CANDIDATES]:
        if stats[label, cv2.CC_STAT_AREA] < min_area:
            return
        mask = _fill_holes((labels == label).astype(np.uint8))
        if not (mask & seen).any():  # no part of what hung on to a larger one
            region = _with_faint_rest(_region(mask), faint)
            seen |= region.mask
            yield region


def _region(mask: Mask) -> Region:
    axis, half_width = _straight_axis(mask) or trace_axis(mask)
    # a disc of radius r that travels L sweeps pi r^2 + 2 r L
    travel = float(mask.sum()) / (2 * half_width) - math.pi / 2 * half_width
    return Region(
        mask=mask,
        axis=axis,
        half_width=half_width,
        travel=max(travel, 0.0),
        evenness=_evenness(mask, half_width),
    )


def _with_faint_rest(region: Region, faint: Mask) -> Region:
    """Give a region with what hangs on to it of a fainter one, if one ball can have left both.

    A ball is faint where it flies fast, yet it leaves a band as wide there.

    Args:
        region: of what is seen clearly.
        faint: [H, W], 1 where anything is seen.
    """
    closed = cv2.morphologyEx(faint | region.mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, labels = cv2.connectedComponents(closed, connectivity=8)
    row, column = np.argwhere(region.mask)[0]
    mask = (labels == labels[row, column]).astype(np.uint8)
    away = cv2.distanceTransform(1 - region.mask, cv2.DIST_L2, 5) > region.half_width
    if np.count_nonzero(away & (mask > 0)) < GROWN * region.half_width**2:
        return region
    grown = _region(_fill_holes(mask))
    is_alike = grown.evenness > ALIKE and grown.half_width < WIDER * region.half_width
    return grown if is_alike else region


def is_of_a_ball(region: Region, opacity: Map | None) -> bool:
    """Whether a ball can have left a region: it must be even, and a short one as opaque as a ball.

    Args:
        region: to be judged.
        opacity: of every pixel [H, W]; None where only its course is known, not its scale.
    """
    if region.evenness < MIN_EVENNESS:
        return False
    if opacity is None or region.widths >= LONG:
        return True
    low, high = COVERED
    covered = float(opacity[region.mask > 0].sum()) / (math.pi * region.half_width**2)
    return low < covered < high


def _straight_axis(mask: Mask) -> tuple[Points, float] | None:
    """Lay the axis of a short, convex region along its longest extent, and give its half width.

    Such a region is as wide as long or nearly, and its tips are no places that a walk would find.
    """
    points = _points(mask)
    (_, sides, _) = cv2.minAreaRect(points)
    if max(sides) > STOUT * min(sides) or not _is_convex(points):
        return None
    places = points.astype(np.float64)
    middle = places.mean(0)
    along = np.linalg.eigh(np.cov((places - middle).T))[1][:, 1]
    first, last = _extent(places - middle, along)
    left, right = _extent(places - middle, along[::-1] * (-1, 1))
    share = np.linspace(first, last, AXIS_POINTS)[:, None]
    axis = middle + share * along + (left + right) / 2 * along[::-1] * (-1, 1)
    depth = float(cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, 5).max())
    return axis, min(depth, (right - left) / 2)


def _points(mask: Mask) -> NDArray[np.int32]:
    """Give the pixels (x, y) of a region [N, 2]."""
    return np.asarray(cv2.findNonZero(mask), np.int32).reshape(-1, 2)


def _is_convex(points: NDArray[np.int32]) -> bool:
    return len(points) >= SOLID * cv2.contourArea(cv2.convexHull(points))


def _projected(points: NDArray[np.int_]) -> NDArray[np.float32]:
    """Give how far each point lies along the longest extent of all, from the first one on, px."""
    places = points - points.mean(0)
    share = places @ np.linalg.eigh(places.T @ places)[1][:, 1]
    return np.asarray(share - share.min(), np.float32)


def _extent(places: Points, direction: Points) -> tuple[float, float]:
    """Give where points [N, 2] begin and end along a direction, whole pixels counted."""
    share = places @ direction
    return float(share.min()) - 0.5, float(share.max()) + 0.5


def _fill_holes(mask: Mask) -> Mask:
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(mask)
    cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
    return filled


def _evenness(mask: Mask, half_width: float) -> float:
    """Share of a region that discs, somewhat smaller than the ball's, cover without leaving it.

    All of what a ball swept is covered so, whatever its path. [derived]
    """
    left, top, width, height = cv2.boundingRect(mask)
    mask = np.pad(mask[top : top + height, left : left + width], 1)
    reach = SMALLER * half_width
    depth = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    uncovered = cv2.distanceTransform((depth < reach).astype(np.uint8), cv2.DIST_L2, 5) > reach
    return 1 - int(np.count_nonzero(uncovered & (mask > 0))) / int(np.count_nonzero(mask))


def trace_axis(mask: Mask) -> tuple[Points, float]:
    """Trace the middle line of an elongated region, from tip to tip, and its half width.

    Pixels are ordered by their distance from one tip measured inside the region; the middles of
    equal distances make the line, which therefore follows any bend that does not cross itself.
    In a convex region the distance along its longest extent does as well, and is sooner found.
    [derived]

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
    if _is_convex(points.astype(np.int32)):
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
    inside = (far >= edge) & (far <= length - edge)
    spacing, most = BENT if cut else EVEN
    basis = SplineBasis(
        start=edge,
        stop=length - edge,
        size=int(np.clip(2 + length / (spacing * half_width), 2, most)),
    )
    order, places = (torch.from_numpy(v[inside].astype(np.float64)) for v in (far, points))
    coefficients, _ = fit_spline(basis, order, places, torch.ones_like(order))
    along = torch.linspace(-cut, length + cut, AXIS_POINTS, dtype=torch.float64)
    inner = along.clamp(basis.start, basis.stop)
    ahead = basis(inner, 1) @ coefficients
    ahead = ahead / torch.linalg.vector_norm(ahead, dim=-1, keepdim=True).clamp_min(1)
    middle = basis(inner) @ coefficients + (along - inner)[:, None] * ahead
    return np.asarray(middle.numpy(), np.float64)


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
