"""From path and opacity to speed, time and the state at mid-exposure, with their covariance.

The opacity k at the centre of a profile is the share of the exposure during which the ball covered
that ray. With gamma the angle between ray and motion it travelled 2R / sin(gamma) meanwhile, so
that it passed k sin(gamma) / (2R) exposures per metre.
Source: MATHS, note 2 on the paper's section 5, whose 2R tan(pi/2 - beta) would be zero for a ball
crossing straight ahead. [derived]
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.axis_curve import AxisCurve, AxisFit
from toolkit.splines import SplineBasis, fit_smooth, fit_spline

RATE_SIZES = (1, 2, 3, 4, 6, 8)
"""Coefficients tried for the pace along the path: 1 is a constant speed."""
DEPTH, SPEED, DURATION, PATH = 2, 6, 7, 8
"""Places in `Motion.state`: position and displacement come first."""
PATH_POINTS = 41
GRID = 401


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How fast the exposure passed along the path, in exposures per metre."""

    basis: SplineBasis
    coefficients: Tensor  # [K]
    inverse: Tensor  # [K, K] covariance of the coefficients
    weight: Tensor  # [P] of each profile, robust


@dataclass(frozen=True, slots=True, kw_only=True)
class OpacityData:
    """The opacity of each profile: P of them."""

    s: Tensor  # [P] px along the axis
    rays: Tensor  # [P, 3] unit, to the profile's centre
    opacity: Tensor  # [P]
    covariance: Tensor  # [P, 3, 3] of centre, half width, opacity
    weight: Tensor  # [P] 1 for good profiles, else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Everything path and pace imply; lengths per exposure until the exposure time is known."""

    position: Tensor  # [3] m at mid-exposure
    displacement: Tensor  # [3] m per exposure at mid-exposure: velocity times exposure time
    path: Tensor  # [N, 3] m, at equal shares of the exposure from start to end
    path_displacement: Tensor  # [N, 3] m per exposure
    duration: Tensor  # share of the exposure the way between the ends took; 1 when all agrees

    def state(self) -> Tensor:
        """(position, displacement, speed per exposure, duration, path) in one vector [8 + 3 N]."""
        speed = torch.linalg.vector_norm(self.displacement)
        head = torch.stack([speed, self.duration])
        return torch.cat([self.position, self.displacement, head, self.path.flatten()])


def pace_samples(curve: AxisCurve, data: OpacityData, ball_radius: float) -> tuple[Tensor, Tensor]:
    """Give exposures per metre at each profile and the factor from opacity to it, both [P]."""
    tangent = curve.tangent(data.s)
    tangent = tangent / torch.linalg.vector_norm(tangent, dim=-1, keepdim=True)
    sine = torch.linalg.vector_norm(torch.linalg.cross(tangent, data.rays), dim=-1)
    factor = sine / (2 * ball_radius)
    return data.opacity * factor, factor


def fit_pace(
    curve: AxisCurve,
    data: OpacityData,
    ball_radius: float,
    sizes: tuple[int, ...] = RATE_SIZES,
) -> Pace:
    """Smooth the pace along the path, constant where the data ask for nothing more."""
    samples, factor = pace_samples(curve, data, ball_radius)
    variance = data.covariance[:, 2, 2] * factor**2
    weight = torch.where(data.weight > 0, data.weight / variance, 0)
    fit = fit_smooth(data.s, samples[:, None], weight, sizes)
    return Pace(
        basis=fit.basis,
        coefficients=fit.coefficients[:, 0],
        inverse=fit.inverse,
        weight=fit.weight,
    )


def make_clock(
    curve: AxisCurve, pace: Pace, low: float, high: float
) -> tuple[Callable[[Tensor], Tensor], Callable[[Tensor], Tensor]]:
    """Give the share of the exposure passed since s = low, up to high, and its derivative in s."""
    grid = torch.linspace(low, high, GRID, dtype=torch.float64)

    def rate(s: Tensor) -> Tensor:
        length: Tensor = torch.linalg.vector_norm(curve.tangent(s), dim=-1)
        # beyond the last contour point the pace goes on as it was: opacity there says nothing else
        exposures = pace.basis(s.clamp(pace.basis.start, pace.basis.stop)) @ pace.coefficients
        return length * exposures

    rates = rate(grid)
    step = grid[1] - grid[0]
    passed = torch.cat([rates.new_zeros(1), ((rates[1:] + rates[:-1]) / 2 * step).cumsum(0)])

    def clock(s: Tensor) -> Tensor:
        place = (s - grid[0]) / step
        index = place.floor().long().clamp(0, GRID - 2)
        share = place - index
        return passed[index] + share * (passed[index + 1] - passed[index])

    return clock, rate


def describe_motion(curve: AxisCurve, pace: Pace, ends: Tensor) -> Motion:
    """Derive the state at mid-exposure and the path from curve, pace and end parameters [2]."""
    first, last = ends.tolist()
    clock, _ = make_clock(curve, pace, first, last)
    s = torch.linspace(first, last, GRID, dtype=torch.float64)
    passed = clock(s)
    duration = passed[-1] - passed[0]
    wanted = torch.linspace(0, 1, PATH_POINTS, dtype=torch.float64) * duration + passed[0]
    index = torch.searchsorted(passed, wanted).clamp(1, GRID - 1)
    share = (wanted - passed[index - 1]) / (passed[index] - passed[index - 1])
    at = s[index - 1] + share * (s[index] - s[index - 1])
    path = curve(at)
    tangent = curve.tangent(at)
    tangent = tangent / torch.linalg.vector_norm(tangent, dim=-1, keepdim=True)
    exposures = pace.basis(at.clamp(pace.basis.start, pace.basis.stop)) @ pace.coefficients
    displacement = tangent / exposures[:, None]
    middle = PATH_POINTS // 2
    return Motion(
        position=path[middle],
        displacement=displacement[middle],
        path=path,
        path_displacement=displacement,
        duration=duration,
    )


def repace(curve: AxisCurve, data: OpacityData, pace: Pace, ball_radius: float) -> Pace:
    """Refit the pace of the same order with the same weights on another curve."""
    samples, _ = pace_samples(curve, data, ball_radius)
    coefficients, inverse = fit_spline(pace.basis, data.s, samples[:, None], pace.weight)
    return replace(pace, coefficients=coefficients[:, 0], inverse=inverse)


def noise_covariance(
    axis: AxisFit, data: OpacityData, pace: Pace, ends: Tensor, ends_std: Tensor, ball_radius: float
) -> Tensor:
    """Propagate the noise of all profiles, and of the ends, to `Motion.state`, [8 + 3 N, 8 + 3 N].

    Path and pace come from the same profiles, whose half width and opacity err together: the joint
    covariance is carried. Derivatives are central differences of the whole chain in its few
    parameters.
    """
    _, factor = pace_samples(axis.curve, data, ball_radius)
    design = pace.basis(data.s)
    pace_gain = (design @ pace.inverse) * (pace.weight * factor)[:, None]
    excess = max(axis.chi2_per_dof, 1.0)
    path_gain = axis.gain * excess**0.5
    mixed = torch.einsum("pka,pa,pl->kl", path_gain, data.covariance[:, :2, 2], pace_gain)
    n_path, n_pace = axis.covariance.shape[0], len(pace.coefficients)
    joint = torch.zeros(n_path + n_pace + 2, n_path + n_pace + 2, dtype=torch.float64)
    joint[:n_path, :n_path] = axis.covariance * excess
    joint[:n_path, n_path : n_path + n_pace] = mixed
    joint[n_path : n_path + n_pace, :n_path] = mixed.mT
    joint[n_path : n_path + n_pace, n_path : n_path + n_pace] = pace.inverse
    joint[-2:, -2:] = torch.diag(ends_std**2)

    def state(shift: Tensor) -> Tensor:
        curve = axis.curve.moved(axis.curve.parameters + shift[:n_path])
        moved = repace(curve, data, pace, ball_radius)
        coefficients = moved.coefficients + shift[n_path : n_path + n_pace]
        return describe_motion(
            curve, replace(moved, coefficients=coefficients), ends + shift[-2:]
        ).state()

    return propagate(state, joint)


def propagate(function: Callable[[Tensor], Tensor], covariance: Tensor) -> Tensor:
    """Carry a covariance [K, K] of small shifts through a function.

    Central differences along its own axes.
    """
    variances, axes = torch.linalg.eigh(covariance)
    spread = variances.clamp_min(0).sqrt()
    columns = []
    for index in range(len(spread)):
        shift = axes[:, index] * spread[index]
        columns.append((function(shift) - function(-shift)) / 2)
    J = torch.stack(columns, dim=-1)
    return J @ J.mT
