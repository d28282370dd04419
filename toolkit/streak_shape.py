"""The shape of a region of the picture: whether a ball can have left it, and its middle line.

A ball leaves the band of its own width about its path: a disc where it stood still. All lengths are
px of the picture given.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.middle_line import AXIS_POINTS, Map, Mask, Points, is_convex, trace_axis

CANDIDATES = 6
"""Regions that are looked at, the largest."""
SMALLER = 0.6
"""Half width of the discs that a region is covered with, over its own."""
MIN_EVENNESS = 0.6
"""Share of a region that they must cover; noise and balls that come nearer cost some."""
LONG = 1.0
"""Widths of travel from which no other thing is likely to look like a ball's trail."""
STOUT = 2.0
"""Length over width below which a region may be too short for its tips to be found."""
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
    left, top, width, height = cv2.boundingRect(found | faint)
    left, top, right, bottom = max(left - 2, 0), max(top - 2, 0), left + width + 2, top + height + 2
    area = (slice(top, bottom), slice(left, right))
    for region in _regions(found[area], faint[area], min_area):
        mask = np.zeros_like(found)
        mask[area] = region.mask
        yield replace(region, mask=mask, axis=np.add(region.axis, (left, top)))


def _regions(found: Mask, faint: Mask, min_area: int) -> Iterator[Region]:
    """Do the same for pictures that hold little else, and 2 px of nothing about it."""
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
    if max(sides) > STOUT * min(sides) or not is_convex(points):
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
