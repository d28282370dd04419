"""A camera's response as a curve that can only rise: brightness against the logarithm of light."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

STEP = 1 / 64
"""Stops between the points at which the curve is tabulated; it is linear between them."""
KNOT_STEP = 1 / 8
"""Stops between knots: finer than a camera's knee, of which the smoothing decides anyway."""
LEAST_SLOPE = 0.01
"""Of brightness per stop, with which a flat part of a rough curve is taken over."""

Array = NDArray[Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MonotoneCurve:
    """Brightness f(u) = offset + integral of exp(spline), u in stops of light.

    The slope is an exponential, so that the curve rises whatever the spline's coefficients are.
    """

    first: float  # stops, where the table begins
    coefficients: Array  # [P] of the cubic spline, the logarithm of the slope
    offset: float  # brightness at `first`
    basis: Array  # [G, P] the spline's at each point of the table
    slope: Array  # [G] of brightness per stop
    brightness: Array  # [G] rising

    @property
    def stops(self) -> Array:
        """The table's places [G]."""
        return self.first + STEP * np.arange(len(self.slope))

    @staticmethod
    def through(stops: Array, brightness: Array, first: float, last: float) -> "MonotoneCurve":
        """Give a smooth curve from `first` to `last` stops near a rough rising one."""
        size = int(np.ceil((last - first) / STEP)) + 1
        places = first + STEP * np.arange(size)
        basis = _splines((places - first) / KNOT_STEP)
        rough = np.gradient(np.interp(places, stops, brightness), STEP)
        # the rough curve has corners: its slope is averaged over a stop
        half = round(0.5 / STEP)
        window = np.full(2 * half + 1, 1 / (2 * half + 1))
        slope = np.convolve(np.pad(rough, half, mode="edge"), window, "valid")
        bend = np.diff(np.eye(basis.shape[1]), 2, axis=0)
        wanted = basis.T @ np.log(np.maximum(slope, LEAST_SLOPE))
        coefficients = np.linalg.solve(basis.T @ basis + bend.T @ bend, wanted)
        curve = _tabulated(first, coefficients, 0.0, basis)
        middle = float(np.interp(0.5, brightness, stops))
        return curve.moved(np.zeros_like(coefficients), 0.5 - float(curve.at(middle)[0]))

    def moved(self, change: Array, offset: float) -> "MonotoneCurve":
        """Give the curve with its coefficients and its offset changed."""
        return _tabulated(self.first, self.coefficients + change, self.offset + offset, self.basis)

    def at(self, stops: Any) -> tuple[Array, Array]:
        """Give brightness and slope at places in stops, any shape; beyond the ends those there."""
        place, share = self._place(stops)
        value = self.brightness[place]
        slope = self.slope[place]
        return (
            value + share * (self.brightness[place + 1] - value),
            slope + share * (self.slope[place + 1] - slope),
        )

    def J_brightness(self) -> Array:
        """Give the derivative of the table in coefficients and offset [G, P + 1]."""
        weighed = self.slope[:, None] * self.basis
        steps = np.cumsum((weighed[1:] + weighed[:-1]) * (STEP / 2), axis=0)
        J = np.ones((len(self.slope), self.basis.shape[1] + 1))
        J[0, :-1], J[1:, :-1] = 0, steps
        return J

    def rows(self, table: Array, stops: Any) -> Array:
        """Interpolate the rows of a table [G, N] at places in stops [...], giving [..., N]."""
        place, share = self._place(stops)
        low = table[place]
        between: Array = low + share[..., None] * (table[place + 1] - low)
        return between

    def inverse(self, brightness: Array) -> Array:
        """Give the stops at which the curve reaches each brightness; the ends are the farthest."""
        return np.interp(brightness, self.brightness, self.stops)

    def _place(self, stops: Any) -> tuple[NDArray[np.intp], Array]:
        place = np.clip((np.asarray(stops) - self.first) / STEP, 0, len(self.slope) - 1.001)
        whole = place.astype(np.intp)
        return whole, place - whole


def _tabulated(first: float, coefficients: Array, offset: float, basis: Array) -> MonotoneCurve:
    slope = np.exp(basis @ coefficients)
    steps = np.cumsum((slope[1:] + slope[:-1]) * (STEP / 2))
    return MonotoneCurve(
        first=first,
        coefficients=coefficients,
        offset=offset,
        basis=basis,
        slope=slope,
        brightness=offset + np.append(0.0, steps),
    )


def _splines(place: Array) -> Array:
    """Cubic B-splines with knots at whole numbers, at places from 0 on: [G, P]."""
    count = int(np.ceil(place[-1])) + 3
    knot = np.clip(np.floor(place).astype(int), 0, count - 4)
    s = place - knot
    basis = np.zeros((len(place), count))
    row = np.arange(len(place))
    basis[row, knot] = (1 - s) ** 3 / 6
    basis[row, knot + 1] = (3 * s**3 - 6 * s**2 + 4) / 6
    basis[row, knot + 2] = (-3 * s**3 + 3 * s**2 + 3 * s + 1) / 6
    basis[row, knot + 3] = s**3 / 6
    return basis
