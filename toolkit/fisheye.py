"""The fisheye lens: where it shows ideal normalised points, and back.

A ray at the angle theta from the axis is seen at theta (1 + k1 theta^2 + ... + k4 theta^8) focal
lengths from the middle. Points are (x/z, y/z), so rays 90 degrees off the axis and beyond have
none. Source: the model of cv2.fisheye (Kannala & Brandt 2006 without its asymmetric terms), no
skew.
"""

import math
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]
Values = TypeVar("Values", Tensor, Array)
Coefficients = tuple[Any, ...]
"""Numbers, or arrays that broadcast with the points."""

STEPS = 60
"""Newton or halving steps at most; four or five do."""
NEAR = 1e-3
"""Squared radius below which a series is used: it is exact to the last digits, the rest is not."""


def distorted(x: Values, y: Values, coefficients: Coefficients) -> tuple[Values, Values]:
    """Where the lens shows ideal normalised points."""
    scale, _ = _scale_and_slope(x * x + y * y, coefficients)
    return x * scale, y * scale


def J_distorted(x: Values, y: Values, coefficients: Coefficients) -> tuple[Values, Values, Values]:
    """Derivative of `distorted`, the symmetric [[a, b], [b, d]]: a, b and d."""
    scale, slope = _scale_and_slope(x * x + y * y, coefficients)
    return scale + 2 * x * x * slope, 2 * x * y * slope, scale + 2 * y * y * slope


def J_coefficients(x: Values, y: Values) -> list[tuple[Values, Values]]:
    """Derivative of `distorted` in each of k1 to k4, (x, y); it depends on the point alone."""
    r2 = x * x + y * y
    ratio, _ = _angle_over_tangent(r2)
    rises = [ratio * (ratio * ratio * r2) ** power for power in (1, 2, 3, 4)]
    return [(x * rise, y * rise) for rise in rises]


def undistorted(
    seen_x: Array, seen_y: Array, coefficients: tuple[float, ...]
) -> tuple[Array, Array]:
    """Invert `distorted`; NaN where the lens shows no ray less than 90 degrees off the axis."""
    seen = np.hypot(seen_x, seen_y)
    low, high = np.zeros_like(seen), np.full_like(seen, min(fold(coefficients), math.pi / 2))
    reach, _ = _polynomial(high, coefficients)
    theta = np.minimum(seen, 0.5 * high)
    for _ in range(STEPS):
        now, slope = _polynomial(theta, coefficients)
        low, high = np.where(now < seen, theta, low), np.where(now < seen, high, theta)
        step = theta + (seen - now) / slope
        # a Newton step that leaves what is known to hold the answer is replaced by halving
        moved = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        is_settled = np.abs(moved - theta) <= 1e-15 + 1e-15 * theta
        theta = moved
        if (is_settled | ~(seen < reach)).all():
            break
    scale = np.where(seen > 0, np.tan(theta) / np.where(seen > 0, seen, 1), 1.0)
    scale = np.where(seen < reach, scale, np.nan)
    return seen_x * scale, seen_y * scale


@lru_cache(maxsize=64)
def fold(coefficients: tuple[float, ...]) -> float:
    """Angle up to which the distance from the middle rises, rad, or infinity."""
    k1, k2, k3, k4 = coefficients
    roots = Polynomial([1, 3 * k1, 5 * k2, 7 * k3, 9 * k4]).trim().roots()  # in theta^2
    squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(squares.min()) ** 0.5 if squares.size else float("inf")


def _polynomial(theta: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    """Distance from the middle in focal lengths, and its derivative in theta."""
    k1, k2, k3, k4 = coefficients
    t2 = theta * theta
    value = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
    return value, slope


def _scale_and_slope(r2: Values, coefficients: Coefficients) -> tuple[Values, Values]:
    """Seen over ideal radius, and the derivative of that in the squared ideal radius."""
    k1, k2, k3, k4 = coefficients
    ratio, change = _angle_over_tangent(r2)
    t2 = ratio * ratio * r2
    bend = 1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))
    rise = k1 + t2 * (2 * k2 + t2 * (3 * k3 + t2 * 4 * k4))
    return ratio * bend, change * bend + ratio * ratio * rise / (1 + r2)


def _angle_over_tangent(r2: Values) -> tuple[Values, Values]:
    """Angle from the axis over its tangent r, and the derivative of that in r^2."""
    xp: Any = torch if isinstance(r2, Tensor) else np
    is_near = r2 < NEAR
    safe = xp.where(is_near, xp.ones_like(r2), r2)  # a root at zero has no derivative
    r = xp.sqrt(safe)
    ratio = xp.arctan(r) / r
    change = (1 / (1 + safe) - ratio) / (2 * safe)
    series = 1 + r2 * (-1 / 3 + r2 * (1 / 5 + r2 * (-1 / 7 + r2 * (1 / 9 - r2 / 11))))
    slope = -1 / 3 + r2 * (2 / 5 + r2 * (-3 / 7 + r2 * (4 / 9 - r2 * 5 / 11)))
    return xp.where(is_near, series, ratio), xp.where(is_near, slope, change)
