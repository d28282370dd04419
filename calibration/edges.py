"""How sharp the edges of a board's squares are, and how much of the board met white."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAMPLES = 41
ALONG = (0.35, 0.5, 0.65)
"""Where profiles cross an edge, as shares of its length; their mean has less noise."""
PLATEAU = 5
"""Samples at each end of a profile that tell ink and paper."""
LEAST_CONTRAST = 8.0
"""Grey levels between ink and paper below which a profile says nothing."""
WIDTH_OF_SPREAD = 4.6
"""From the integral of p (1 - p) over an edge that rises from 0 to 1 to its 10 to 90 % width.

4.54 for a Gaussian edge, 4.8 for a ramp. Derived; unlike crossings it averages over the noise.
"""


def edge_widths(grey: NDArray[Any], grid: Array, *, reach: float = 0.3) -> tuple[float, float]:
    """Give the median 10 to 90 % width of the edges that run along x, and of those along y, px.

    Motion widens only the edges across it, so both are told. Half as long as a profile reaches, a
    width stays behind the truth.

    Args:
        grey: brightness [H, W].
        grid: corners [R, C, 2] px; NaN where one was not found.
        reach: length of a profile on each side of the edge, in squares.

    Returns:
        NaN for a direction without an edge that can be seen.
    """
    return _widths(grey, grid, reach), _widths(grey, grid.swapaxes(0, 1), reach)


def clipped_share(clipped: NDArray[np.bool_], corners: Array) -> float:
    """Give the share of the board's inner part, the hull of its corners, that met white."""
    hull = cv2.convexHull(corners.astype(np.float32)).astype(np.int32)
    left, top = np.maximum(hull.min((0, 1)), 0)
    part = clipped[top : hull[..., 1].max() + 1, left : hull[..., 0].max() + 1]
    inside = np.zeros(part.shape, dtype=np.uint8)
    cv2.fillConvexPoly(inside, hull - [left, top], 1)
    return float(part[inside > 0].mean()) if inside.any() else 0.0


def _widths(grey: NDArray[Any], grid: Array, reach: float) -> float:
    start, along = grid[:, :-1], np.diff(grid, axis=1)  # [R, C - 1, 2]
    gaps = np.linalg.norm(np.diff(grid, axis=0), axis=-1)  # [R - 1, C]
    across = np.fmin(np.vstack([gaps, gaps[-1:]]), np.vstack([gaps[:1], gaps]))
    half = reach * np.fmin(across[:, :-1], across[:, 1:])
    known = np.isfinite(start + along).all(axis=-1) & np.isfinite(half)
    if not known.any():
        return float("nan")
    profiles = _profiles(grey, start[known], along[known], half[known])
    low, high = profiles[:, :PLATEAU].mean(1), profiles[:, -PLATEAU:].mean(1)
    seen = np.abs(high - low) > LEAST_CONTRAST
    if not seen.any():
        return float("nan")
    risen = np.clip((profiles[seen] - low[seen, None]) / (high - low)[seen, None], 0, 1)
    spread = np.trapezoid(risen * (1 - risen), axis=1) * 2 * half[known][seen] / (SAMPLES - 1)
    return float(WIDTH_OF_SPREAD * np.median(spread))


def _profiles(grey: NDArray[Any], start: Array, along: Array, half: Array) -> Array:
    """Sample brightness across edges [E, SAMPLES], from one side to the other."""
    normal = along[:, ::-1] * [-1, 1] / np.linalg.norm(along, axis=-1, keepdims=True)
    offset = half[:, None] * np.linspace(-1, 1, SAMPLES)
    middle = start[:, None] + along[:, None] * np.array(ALONG)[:, None]  # [E, 3, 2]
    places = middle[:, :, None] + normal[:, None, None] * offset[:, None, :, None]
    x, y = places.reshape(-1, SAMPLES, 2).astype(np.float32).transpose(2, 0, 1)
    sampled = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    means: Array = sampled.reshape(-1, len(ALONG), SAMPLES).astype(np.float64).mean(axis=1)
    return means
