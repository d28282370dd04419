"""How sharp the edges of a board's squares are, and how much of the board met white."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAMPLES = 41
ALONG = (0.35, 0.5, 0.65)
"""Where profiles cross an edge, as shares of its length; their mean has less noise."""
TRAPEZOID = np.array([0.5, *[1.0] * (SAMPLES - 2), 0.5])
"""Weights of the samples in an integral."""
PLATEAU = 5
"""Samples at each end of a profile that tell ink and paper."""
LEAST_CONTRAST = 8.0
"""Grey levels between ink and paper below which a profile says nothing."""
WIDTH_OF_SPREAD = 4.6
"""From the integral of p (1 - p) over an edge that rises from 0 to 1 to its 10 to 90 % width.

4.54 for a Gaussian edge, 4.8 for a ramp. Derived; unlike crossings it averages over the noise.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Edges:
    """What the edges of a board's squares look like; NaN where none can be seen."""

    widths: tuple[float, float]  # px, 10 to 90 %, of those that run along x, and along y
    shift: float  # px, how far the white squares reach into the dark ones


def edges_of(grey: NDArray[Any], grid: Array, *, reach: float = 0.3) -> Edges:
    """Measure the edges between the corners of a board.

    Widths are medians; motion widens only the edges across it, so both directions are told. Once an
    edge is wider than a profile reaches, its width stays behind the truth. Where light and dark are
    coded evenly to the eye white reaches over by a fraction of the width; where it was clipped it
    reaches further.

    Args:
        grey: brightness [H, W].
        grid: corners [R, C, 2] px; NaN where one was not found.
        reach: length of a profile on each side of the edge, in squares.
    """
    parts = [_segments(grid, reach), _segments(grid.swapaxes(0, 1), reach)]
    start, along, half = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    widths, shifts = _measure(_profiles(grey, start, along, half), half)
    count = len(parts[0][2])
    return Edges(
        widths=(_median(widths[:count]), _median(widths[count:])),
        shift=_median(shifts),
    )


def clipped_share(clipped: NDArray[np.bool_], corners: Array) -> float:
    """Give the share of the board's inner part, the hull of its corners, that met white."""
    hull = cv2.convexHull(corners.astype(np.float32)).astype(np.int32)
    left, top = np.maximum(hull.min((0, 1)), 0)
    part = clipped[top : hull[..., 1].max() + 1, left : hull[..., 0].max() + 1]
    inside = np.zeros(part.shape, dtype=np.uint8)
    cv2.fillConvexPoly(inside, hull - [left, top], 1)
    return float(part[inside > 0].mean()) if inside.any() else 0.0


def _segments(grid: Array, reach: float) -> tuple[Array, Array, Array]:
    """Edges that run along a grid's rows: start and run [E, 2], half length of a profile [E]."""
    start, along = grid[:, :-1], np.diff(grid, axis=1)  # [R, C - 1, 2]
    gaps = np.hypot(*np.diff(grid, axis=0).transpose(2, 0, 1))  # [R - 1, C]
    across = np.fmin(np.vstack([gaps, gaps[-1:]]), np.vstack([gaps[:1], gaps]))
    half = reach * np.fmin(across[:, :-1], across[:, 1:])
    known = np.isfinite(start[..., 0] + along[..., 0] + half)
    return start[known], along[known], half[known]


def _measure(profiles: Array, half: Array) -> tuple[Array, Array]:
    """Width and shift of each edge, px; NaN where ink and paper look alike."""
    low, high = profiles[:, :PLATEAU].mean(1), profiles[:, -PLATEAU:].mean(1)
    rise = np.where(np.abs(high - low) > LEAST_CONTRAST, high - low, np.nan)
    risen = np.clip((profiles - low[:, None]) / rise[:, None], 0, 1)
    step = 2 * half / (SAMPLES - 1)
    area = risen @ TRAPEZOID
    widths = WIDTH_OF_SPREAD * (area - (risen * risen) @ TRAPEZOID) * step
    return widths, np.where(rise > 0, area * step - half, half - area * step)


def _median(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(np.median(seen)) if len(seen) else float("nan")


def _profiles(grey: NDArray[Any], start: Array, along: Array, half: Array) -> Array:
    """Sample brightness across edges [E, SAMPLES], from one side to the other."""
    normal = along[:, ::-1] * [-1, 1] / np.hypot(along[:, :1], along[:, 1:])
    offset = half[:, None] * np.linspace(-1, 1, SAMPLES)
    middle = start[:, None] + along[:, None] * np.array(ALONG)[:, None]  # [E, 3, 2]
    places = middle[:, :, None] + normal[:, None, None] * offset[:, None, :, None]
    x, y = places.reshape(-1, SAMPLES, 2).astype(np.float32).transpose(2, 0, 1)
    if not len(x):
        return np.zeros((0, SAMPLES))
    sampled = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    means: Array = sampled.reshape(-1, len(ALONG), SAMPLES).mean(axis=1, dtype=np.float64)
    return means
