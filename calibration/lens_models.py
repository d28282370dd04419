"""The lens models that are compared, from the fewest terms to the most."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolkit import brown, fisheye

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class LensModel:
    """A camera model and which of its coefficients are fitted; the others stay zero."""

    name: str
    family: str  # the camera's model in camera.toml
    size: int  # coefficients it stores
    fitted: tuple[int, ...]  # which of them are fitted

    @property
    def columns(self) -> tuple[int, ...]:
        """Which of [fx fy cx cy, distortion...] are fitted."""
        return (0, 1, 2, 3, *(4 + index for index in self.fitted))

    def shown(self, x: Array, y: Array, coefficients: Array) -> tuple[Array, Array]:
        """Where the lens shows ideal normalised points; coefficients [size, ...] broadcast."""
        if self.family == "fisheye":
            return fisheye.distorted(x, y, tuple(coefficients))
        return brown.distorted(x, y, self._all(coefficients))

    def J_shown(self, x: Array, y: Array, coefficients: Array) -> tuple[Array, Array, Array]:
        """Give the derivative of `shown`, the symmetric [[a, b], [b, d]]: a, b and d."""
        if self.family == "fisheye":
            return fisheye.J_distorted(x, y, tuple(coefficients))
        return brown.J_distorted(x, y, self._all(coefficients))

    def J_fitted(self, x: Array, y: Array, coefficients: Array) -> list[tuple[Array, Array]]:
        """Give the derivative of `shown` in each fitted coefficient, (x, y)."""
        if self.family == "fisheye":
            every = fisheye.J_coefficients(x, y)
        else:
            every = brown.J_coefficients(x, y, self._all(coefficients))
        return [every[index] for index in self.fitted]

    def _all(self, coefficients: Array) -> tuple[Any, ...]:
        """k1 k2 p1 p2 k3 k4 k5 k6."""
        return (*coefficients, *(0.0,) * (8 - self.size))


K1_K2 = LensModel(name="pinhole k1 k2", family="pinhole", size=4, fitted=(0, 1))
PINHOLE_4 = LensModel(name="pinhole 4", family="pinhole", size=4, fitted=(0, 1, 2, 3))
PINHOLE_5 = LensModel(name="pinhole 5", family="pinhole", size=5, fitted=(0, 1, 2, 3, 4))
RATIONAL = LensModel(name="rational 8", family="rational", size=8, fitted=tuple(range(8)))
FISHEYE = LensModel(name="fisheye 4", family="fisheye", size=4, fitted=(0, 1, 2, 3))

MODELS = (K1_K2, PINHOLE_4, PINHOLE_5, FISHEYE, RATIONAL)
"""In the order they are considered: a narrow fisheye is a pinhole, so that one comes first."""
FAMILIES = ("auto", "pinhole", "rational", "fisheye")


def models_of(family: str) -> tuple[LensModel, ...]:
    """Give the models to compare for one of `FAMILIES`."""
    return tuple(model for model in MODELS if family in ("auto", model.family))
