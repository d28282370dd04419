"""The lens of OpenCV's pinhole cameras: where it shows ideal normalised points.

Coefficients are k1 k2 p1 p2 k3 k4 k5 k6, zero where a model has fewer: radial distortion
(1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), and tangential p1 p2. Source: Brown
1971, in OpenCV's terms.
"""

from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]
Values = TypeVar("Values", Tensor, Array)
Coefficients = tuple[Any, ...]
"""Numbers, or arrays that broadcast with the points."""


def distorted(x: Values, y: Values, coefficients: Coefficients) -> tuple[Values, Values]:
    """Where the lens shows ideal normalised points."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if np.any((k4, k5, k6)):
        radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy = 2 * x * y
    tangential_x = p1 * xy + p2 * (r2 + 2 * x * x)
    tangential_y = p1 * (r2 + 2 * y * y) + p2 * xy
    return x * radial + tangential_x, y * radial + tangential_y


def J_distorted(x: Values, y: Values, coefficients: Coefficients) -> tuple[Values, Values, Values]:
    """Derivative of `distorted`, the symmetric [[a, b], [b, d]]: a, b and d."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # d radial / d x = 2 slope * x
    if np.any((k4, k5, k6)):
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        slope = (slope - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / below
    mixed = 2 * (x * y * slope + p1 * x + p2 * y)
    return (
        radial + 2 * (x * x * slope + p1 * y + 3 * p2 * x),
        mixed,
        radial + 2 * (y * y * slope + 3 * p1 * y + p2 * x),
    )


def J_coefficients(x: Values, y: Values, coefficients: Coefficients) -> list[tuple[Values, Values]]:
    """Derivative of `distorted` in each of k1 k2 p1 p2 k3 k4 k5 k6, (x, y)."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    below = 1 / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) * below
    rises = [r2 * below, r2**2 * below, r2**3 * below]
    rises += [-radial * rise for rise in rises]
    first, second, third, *rest = [(x * rise, y * rise) for rise in rises]
    p1, p2 = (2 * x * y, r2 + 2 * y * y), (r2 + 2 * x * x, 2 * x * y)
    return [first, second, p1, p2, third, *rest]


@lru_cache(maxsize=64)
def fold(coefficients: tuple[float, ...]) -> float:
    """Normalised radius up to which radial distortion rises and has no pole, or infinity."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    above, below = Polynomial([1, k1, k2, k3]), Polynomial([1, k4, k5, k6])  # in r^2
    # numerator of the derivative of r * above / below
    slope = above * below + Polynomial([0, 2]) * (above.deriv() * below - above * below.deriv())
    roots = np.concatenate([slope.trim().roots(), below.trim().roots()])
    squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(squares.min()) ** 0.5 if squares.size else float("inf")
