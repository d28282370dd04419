"""Pixels of a bracket that saw the same light, averaged into one observation a frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.monotone_curve import MonotoneCurve

Array = NDArray[Any]

WIDTH = 1 / 32
"""Stops of light that one group spans."""
LEAST = 12
"""Pixels that make a group."""
DARKEST, BRIGHTEST = 0.02, 0.98
"""Brightness between which values are used: beyond, noise is cut off at black or white."""
TAPER = 0.02
"""Of brightness, over which a value's weight falls to nothing at either end."""
OUTLYING = 6.0
"""Standard deviations from which a pixel does not show the same light in all frames."""
QUANTISED = 0.3
"""Steps of the stored values: standard deviation that rounding alone leaves."""
LEVELS = 32
"""Steps of brightness over which the noise is pooled."""
SEARCHES = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelGroups:
    """Mean brightness of each group in each frame."""

    light: Array  # [M] stops
    mean: Array  # [F, M] brightness
    precision: Array  # [F, M] of the mean, 0 where it is not used
    strange: Array  # [F] share of pixels that do not fit in this frame

    @property
    def used(self) -> NDArray[np.bool_]:
        """Where a mean is used [F, M]."""
        return self.precision > 0


def find_light(curve: MonotoneCurve, values: Array, stops: Array, light: Array) -> Array:
    """Give the light of each pixel [N] in stops that makes its values [F, N] likeliest.

    A value's weight depends on what is expected there, not on the value itself: else noise would
    choose which values count near black and white.
    """
    for _ in range(SEARCHES):
        expected, slope = curve.at(light + stops[:, None])
        w = _taper(expected)
        pull = (w * slope * (values - expected)).sum(0)
        light = light + np.clip(pull / ((w * slope * slope).sum(0) + 1e-7), -0.5, 0.5)
    return light


def group_pixels(
    curve: MonotoneCurve, values: Array, stops: Array, light: Array, step: float
) -> PixelGroups:
    """Average pixels of nearly the same light; what one frame shows otherwise is left out.

    Grouping by the likeliest light shifts all means of a group as another light would, which the
    fit leaves open; grouping by one frame's brightness would bend the curve. [derived]

    Args:
        curve: as far as it is known.
        values: brightness [F, N].
        stops: of the exposure times [F].
        light: of each pixel [N], stops.
        step: between stored values, white = 1.
    """
    expected, _ = curve.at(light + stops[:, None])
    inside = (expected > DARKEST) & (expected < BRIGHTEST)
    error = values - expected
    spread = 1.4826 * float(np.median(np.abs(error[inside]))) if inside.any() else 0.0
    off = inside & (np.abs(error) > OUTLYING * np.hypot(spread, QUANTISED * step))
    strange = off.sum(1) / np.maximum(inside.sum(1), 1)
    good = ~off.any(0) & (inside.sum(0) >= 2)
    member, chosen = _members(light[good])
    error, light = error[:, good][:, chosen], light[good][chosen]
    count = np.bincount(member)
    middle = np.bincount(member, light) / count
    mean_error = np.stack([np.bincount(member, row) / count for row in error])
    square = np.stack([np.bincount(member, row * row) / count for row in error])
    expected, _ = curve.at(middle + stops[:, None])
    used = (expected > DARKEST) & (expected < BRIGHTEST)
    mean = expected + mean_error
    variance = _pooled(mean, square - mean_error**2, used * count, (QUANTISED * step) ** 2)
    return PixelGroups(light=middle, mean=mean, precision=used * count / variance, strange=strange)


def _taper(brightness: Array) -> Array:
    rise = np.clip((brightness - DARKEST) / TAPER, 0, 1)
    fall: Array = rise * np.clip((BRIGHTEST - brightness) / TAPER, 0, 1)
    return fall + 1e-9


def _members(light: Array) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Number the groups that are large enough; give each pixel's, and which pixels have one."""
    if not len(light):
        return np.zeros(0, np.intp), np.zeros(0, np.bool_)
    place = np.floor((light - light.min()) / WIDTH).astype(np.intp)
    large = np.bincount(place) >= LEAST
    number = np.cumsum(large) - 1
    chosen = large[place]
    return number[place[chosen]], chosen


def _pooled(mean: Array, variance: Array, count: Array, least: float) -> Array:
    """Give the variance of one value at each mean, pooled over all groups as bright."""
    level = np.clip((mean * LEVELS).astype(np.intp), 0, LEVELS - 1).ravel()
    total = np.bincount(level, (variance * count).ravel(), LEVELS)
    pooled = total / np.maximum(np.bincount(level, count.ravel(), LEVELS), 1)
    return np.maximum(pooled, least)[level].reshape(mean.shape)
