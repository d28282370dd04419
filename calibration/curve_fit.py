"""The likeliest rising response curve behind a bracket, with its covariance.

Where all exposures differ by whole stops the pictures leave a ripple of one stop's period open
(Grossberg & Nayar 2003): only smoothness decides. So the prior is of the fit's essence: a power law
costs nothing, and what the curve bends more is held against it, by as much as the marginal
likelihood asks for; a few sharp bends, such as a knee, cost less than many small ones.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.curve_start import rough_curve, rough_light
from calibration.monotone_curve import MonotoneCurve
from calibration.pixel_groups import PixelGroups, find_light, group_pixels

Array = NDArray[Any]

ROUNDS = 3
"""Times that the pixels are grouped anew by the curve found so far."""
STEPS = 40
TAILS = 2.0
"""Degrees of freedom of the bends' t distribution."""
EXPECTED = (TAILS + 1) / (TAILS + 3)
"""Expected information of such a bend over that of the normal one with the same scale."""
TINY = 1e-9
"""Added to every sum of squares, so that what nothing tells has an inverse."""
SETTLED = 1e-4
"""Step of every coefficient below which the fit has settled."""
LONGEST = 1.0
"""Of a step in any coefficient."""
BELOW, ABOVE = 1.0, 0.6
"""Stops by which the curve goes on beyond the rough one."""
MOST = 14.0
"""Stops below white at which a curve's table begins at last: darker light is lost in the fog."""
PINNED = 1e8
"""Precision by which one point holds the scale, which the pictures leave open."""
DARKEST = 0.008
"""Brightness at which the curve's table begins."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveFit:
    """A response curve, the light it was found with, and how well all is known."""

    curve: MonotoneCurve
    covariance: Array  # [P + 1, P + 1] of coefficients and offset
    stops: Array  # [F] of the exposure times
    misfit: float  # squared, over what noise leaves; 1 is noise
    groups: PixelGroups
    excess: float  # variance of a group's mean beyond its pixels' noise
    span: tuple[float, float]  # stops between which the curve was seen


@dataclass(slots=True, kw_only=True, eq=False)
class _State:
    """What the search moves."""

    curve: MonotoneCurve
    light: Array
    smoothing: float = 10.0
    misfit: float = 1.0
    excess: float = 0.0  # variance of a group's mean beyond its pixels' noise
    covariance: Array | None = None


def fit_curve(values: Array, times: Array, step: float) -> CurveFit:
    """Find the curve by which all frames tell the same light.

    Each pixel's light is unknown. Source: maximum likelihood, the light eliminated; smoothing by
    Fellner and Schall's update (Wood & Fasiolo 2017). [derived]

    Args:
        values: brightness [F, N], white = 1.
        times: exposure times [F], seconds.
        step: between stored values.
    """
    stops = np.log2(times) - np.log2(times).mean()
    rough = rough_curve(values, stops)
    light = rough_light(values, stops, rough)
    told = np.isfinite(light)
    values, light = values[:, told], light[told]
    low, high = np.interp([DARKEST, 1.0], *rough)
    state = _State(
        curve=MonotoneCurve.through(
            rough[1], rough[0], max(low - BELOW, high - MOST), high + ABOVE
        ),
        light=light,
    )
    pixels = light
    for _ in range(ROUNDS):
        pixels = find_light(state.curve, values, stops, pixels)
        groups = group_pixels(state.curve, values, stops, pixels, step)
        state.light = groups.light
        _settle(state, groups, stops)
        state.excess = _excess(state, groups, stops)
    assert state.covariance is not None
    seen = (state.light + stops[:, None])[groups.used]
    return CurveFit(
        curve=state.curve,
        covariance=state.covariance,
        stops=stops,
        misfit=state.misfit,
        groups=replace(groups, light=state.light),
        excess=state.excess,
        span=(float(seen.min()), float(seen.max())) if seen.size else (0.0, 0.0),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Normal:
    """Normal equations of coefficients and offset [Q], the light eliminated."""

    matrix: Array  # [Q, Q]
    gradient: Array  # [Q]
    cost: float
    light_matrix: Array  # [M]
    light_gradient: Array  # [M]
    mixed: Array  # [M, Q]


def _settle(state: _State, groups: PixelGroups, stops: Array) -> None:
    """Move curve, light and smoothing until nothing moves any more."""
    size = len(state.curve.coefficients)
    bends = np.pad(np.diff(np.eye(size), 2, axis=0), ((0, 0), (0, 1)))
    middle = float(state.curve.inverse(np.array([0.5]))[0])
    damping = 1e-6
    normal = _normal(state, groups, stops, middle)
    for _ in range(STEPS):
        own = bends[:, :size] @ state.curve.coefficients
        bend_weights = (TAILS + 1) / (TAILS + state.smoothing * own**2)
        prior = state.smoothing * bends.T @ (bend_weights[:, None] * bends)
        place = np.append(state.curve.coefficients, 0.0)
        matrix = normal.matrix / state.misfit + prior + TINY * np.eye(len(prior))
        gradient = normal.gradient / state.misfit - prior @ place
        change = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), gradient)
        change *= min(1.0, LONGEST / float(np.abs(change[:size]).max()))
        moved = _moved(state, normal, change)
        found = _normal(moved, groups, stops, middle)
        rise = (found.cost - normal.cost) / state.misfit
        rise += float((place + change) @ prior @ (place + change) - place @ prior @ place)
        if rise > 1e-6 * normal.cost and damping < 1e6:
            damping = max(damping * 10, 1e-4)
            continue
        damping /= 5
        state.curve, state.light = moved.curve, moved.light
        normal = found
        gain = _update(state, normal, groups, bends, bend_weights)
        if float(np.abs(change).max()) < SETTLED and gain < 0.02:
            break
    own = bends[:, :size] @ state.curve.coefficients
    # the weights of the search hold bends tighter than a t distribution does: by its expected
    # information at most, a bend is known by the prior
    bend_weights = np.minimum((TAILS + 1) / (TAILS + state.smoothing * own**2), EXPECTED)
    prior = state.smoothing * bends.T @ (bend_weights[:, None] * bends)
    state.covariance = np.linalg.inv(normal.matrix / state.misfit + prior + TINY * np.eye(size + 1))


def _moved(state: _State, normal: _Normal, change: Array) -> _State:
    size = len(state.curve.coefficients)
    light = (normal.light_gradient - normal.mixed @ change) / normal.light_matrix
    return _State(
        curve=state.curve.moved(change[:size], float(change[size])),
        light=state.light + np.clip(light, -0.3, 0.3),
        excess=state.excess,
    )


def _normal(state: _State, groups: PixelGroups, stops: Array, middle: float) -> _Normal:
    place = state.light + stops[:, None]
    brightness, slope = state.curve.at(place)
    table = state.curve.J_brightness()
    J = state.curve.rows(table, place)
    w, error = _precision(groups, state.excess), groups.mean - brightness
    light_matrix = (w * slope * slope).sum(0) + 1e-9
    light_gradient = (w * slope * error).sum(0)
    flat, root = J.reshape(-1, J.shape[-1]), np.sqrt(w).ravel()
    mixed = np.einsum("fm,fmq->mq", w * slope, J, optimize=True)
    weighed = flat * root[:, None]
    matrix = weighed.T @ weighed - (mixed / light_matrix[:, None]).T @ mixed
    gradient = flat.T @ (w * error).ravel() - mixed.T @ (light_gradient / light_matrix)
    pin = state.curve.rows(table, np.array(middle))
    off = float(state.curve.at(middle)[0]) - 0.5
    return _Normal(
        matrix=matrix + PINNED * np.outer(pin, pin),
        gradient=gradient - PINNED * off * pin,
        cost=float((w * error * error).sum()) + PINNED * off * off,
        light_matrix=light_matrix,
        light_gradient=light_gradient,
        mixed=mixed,
    )


def _precision(groups: PixelGroups, excess: float) -> Array:
    return groups.precision / (1 + excess * groups.precision)


def _excess(state: _State, groups: PixelGroups, stops: Array) -> float:
    """Give the variance that groups of any size miss the curve by, as flare and motion leave it.

    Moments, large groups weighed most: they show it best. Without it the many pixels of a wall
    would outvote the few of a window, though both err by as much.
    """
    brightness, _ = state.curve.at(state.light + stops[:, None])
    used = groups.used
    w = _precision(groups, state.excess)[used]
    freedom = max(w.size - len(state.light), 1)
    square = (groups.mean - brightness)[used] ** 2 * (w.size / freedom)
    beyond = float((w * w * (square - 1 / groups.precision[used])).sum() / (w * w).sum())
    return max(beyond, 0.0)


def _update(
    state: _State, normal: _Normal, groups: PixelGroups, bends: Array, bend_weights: Array
) -> float:
    """Set smoothing and misfit by what was found; give how far the smoothing's logarithm moved."""
    size = len(state.curve.coefficients)
    prior = state.smoothing * bends.T @ (bend_weights[:, None] * bends)
    matrix = normal.matrix / state.misfit + prior + TINY * np.eye(len(prior))
    covariance = np.linalg.inv(matrix)
    own = bends[:, :size] @ state.curve.coefficients
    numbers = float(np.trace(covariance @ normal.matrix)) / state.misfit
    freedom = int(groups.used.sum()) - len(groups.light) - numbers
    state.misfit = max(1.0, normal.cost / max(freedom, 1.0))
    left = max(len(own) - float(np.trace(covariance @ prior)), 0.5)
    smoothing = left / max(float((bend_weights * own**2).sum()), 1e-9)
    moved = float(np.clip(np.log(smoothing / state.smoothing), -1.5, 1.5))
    state.smoothing = float(np.clip(state.smoothing * np.exp(moved), 1e-2, 1e7))
    return abs(moved)
