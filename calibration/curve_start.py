"""A first, rough response from bracketed exposures, in closed form."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

KNOTS = 40
SMOOTH = 1e-3
"""Weight of squared second differences beside one pixel."""
PIXELS = 4000
DARK, BRIGHT = 0.02, 0.98
"""Brightness between which the rough curve looks at a value."""
LEAST_RISE = 1e-4
"""Stops by which the curve rises from knot to knot, at least."""


def rough_curve(values: Array, stops: Array, seed: int = 0) -> tuple[Array, Array]:
    """Give brightness at knots [K] and the stops of light there [K], rising.

    The light of every pixel is eliminated from the linear least squares of log exposures.
    Source: Debevec & Malik 1997, eq. (3). Deviation: linear between few knots instead of one number
    a code, all pixels instead of chosen ones, and the curve made rising at the end.

    Args:
        values: brightness of each pixel in each frame [F, N], white = 1.
        stops: of the exposure times [F].
        seed: of the choice of pixels.
    """
    w = weights(values)
    usable = np.flatnonzero(np.count_nonzero(w, axis=0) > 1)
    chosen = np.random.default_rng(seed).permutation(usable)[:PIXELS]
    w, seen = w[:, chosen], values[:, chosen]
    total = w.sum(0)
    basis = _hats(seen)
    basis -= (w[..., None] * basis).sum(0) / total[:, None]
    wanted = stops[:, None] - (w * stops[:, None]).sum(0) / total
    weighed = basis * w[..., None]
    normal = np.einsum("fnk,fnl->kl", weighed, basis, optimize=True)
    bend = np.diff(np.eye(KNOTS), 2, axis=0)
    normal += SMOOTH * len(chosen) * bend.T @ bend
    normal[KNOTS // 2, KNOTS // 2] += len(chosen)  # the scale is free: this knot is at 0
    rough = np.linalg.solve(normal, np.einsum("fnk,fn->k", weighed, wanted, optimize=True))
    rising = np.maximum.accumulate(rough) + LEAST_RISE * np.arange(KNOTS)
    return np.linspace(0, 1, KNOTS), rising


def weights(values: Array) -> Array:
    """Give how much each value tells, none where it is nearly black or white; any shape."""
    inside = (values > DARK) & (values < BRIGHT)
    told: Array = inside * np.minimum(values, 1 - values)
    return told


def rough_light(values: Array, stops: Array, curve: tuple[Array, Array]) -> Array:
    """Give the light of each pixel [N] in stops; what has no usable value is not a number."""
    w = weights(values)
    brightness, light = curve
    with np.errstate(invalid="ignore"):
        mean: Array = (w * (np.interp(values, brightness, light) - stops[:, None])).sum(0) / w.sum(
            0
        )
    return mean


def _hats(values: Array) -> Array:
    place = np.clip(values, 0, 1) * (KNOTS - 1)
    knot = np.minimum(place.astype(int), KNOTS - 2)
    share = place - knot
    basis = np.zeros((*values.shape, KNOTS))
    np.put_along_axis(basis, knot[..., None], 1 - share[..., None], axis=-1)
    np.put_along_axis(basis, knot[..., None] + 1, share[..., None], axis=-1)
    return basis
