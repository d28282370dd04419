"""A ball that may have stood still: how fast it can have been at most.

The image of a ball is even in its velocity, so that at rest nothing is known of it to first order:
no standard deviation tells the truth there. Speeds are tried one by one instead.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.least_squares import minimise_equations
from toolkit.sweep.fit import SweepFit
from toolkit.sweep.likelihood import compare
from toolkit.sweep.misfit import Misfit
from toolkit.sweep.paths import STRAIGHT

SHORT = 0.6
"""Ball's widths of travel from which no ball stands still."""
SLOWEST = 0.02
"""Ball radii of travel that pass for none."""
TOLD_FROM_REST = 14.2
"""Chi-square by which a motion must beat rest: by chance three numbers do once in 370."""
LIMIT = 2.71
"""Chi-square of the one-sided 95 % limit."""
HOPELESS = 100.0
"""Chi-square beyond the limit from which no higher speed is tried."""
DIRECTIONS = 4
"""Tried across the line of sight; one more is that itself."""
DOUBLINGS = 12
BISECTIONS = 5


def looks_still(fit: SweepFit, misfit: Misfit) -> bool:
    """Say whether a ball at rest explains the picture about as well."""
    if fit.model.path != STRAIGHT or _travel(fit) > SHORT * 2 * fit.model.ball_radius:
        return False
    at_rest = _cost_with(fit, _toward(fit) * SLOWEST * fit.model.ball_radius)
    return at_rest - fit.cost < TOLD_FROM_REST * misfit.factor


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedLimit:
    """What the ball hardly exceeded, m per exposure: 95 % by profile likelihood."""

    any_way: float
    across: float  # the line of sight


def speed_limit(fit: SweepFit, misfit: Misfit) -> SpeedLimit:
    """Find how fast the ball can have been at most, whichever way it went."""
    at_rest = _cost_with(fit, _toward(fit) * SLOWEST * fit.model.ball_radius)
    allowed = max(fit.cost, at_rest) + LIMIT * misfit.factor
    flat, ahead = _directions(fit)
    across = max(_limit_along(fit, direction, allowed) for direction in flat)
    return SpeedLimit(any_way=max(across, _limit_along(fit, ahead, allowed)), across=across)


def _limit_along(fit: SweepFit, direction: Tensor, allowed: float) -> float:
    """Find the highest speed in one direction whose cost passes; slower ones need not all."""
    low = high = SLOWEST * fit.model.ball_radius
    speed = low
    for _ in range(DOUBLINGS):
        cost = _cost_with(fit, direction * speed)
        if cost <= allowed:
            low, high = speed, 2 * speed
        elif cost > allowed + HOPELESS:
            break
        speed *= 2
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        is_over = _cost_with(fit, direction * middle) > allowed
        low, high = (low, middle) if is_over else (middle, high)
    return high


def _cost_with(fit: SweepFit, displacement: Tensor) -> float:
    """Give the least cost among motions of one displacement; all else is fitted."""
    half = displacement / 2
    x = fit.parameters.clone()
    middle = (x[:3] + x[3:6]) / 2
    # the middle takes the place of both control points, whose difference is held
    free = torch.cat([middle, x[6:]])

    def whole(values: Tensor) -> Tensor:
        return torch.cat([values[:3] - half, values[:3] + half, values[3:]])

    def equations(values: Tensor, _: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        seen = compare(fit.model, whole(values[0]), fit.pixels)
        map_ = torch.zeros(len(x), len(free), dtype=torch.float64)
        eye = torch.eye(3, dtype=torch.float64)
        map_[:3, :3], map_[3:6, :3] = eye, eye
        map_[6:, 3:] = torch.eye(len(x) - 6, dtype=torch.float64)
        cost = torch.tensor([seen.cost], dtype=torch.float64)
        return cost, (map_.mT @ seen.gradient)[None], (map_.mT @ seen.information @ map_)[None]

    lower = torch.full_like(free, -torch.inf)
    lower[3] = 0.02
    solution = minimise_equations(
        equations, free[None], lower=lower, max_iterations=12, tolerance=0.1
    )
    return float(solution.cost[0])


def _directions(fit: SweepFit) -> tuple[list[Tensor], Tensor]:
    """Give unit vectors across the line of sight, and the one along it."""
    position, _ = fit.state()
    ahead = torch.nn.functional.normalize(position, dim=0)
    upright = torch.tensor([0.0, 1, 0], dtype=torch.float64)
    right = torch.nn.functional.normalize(torch.linalg.cross(upright, ahead), dim=0)
    down = torch.linalg.cross(ahead, right)
    angles = [math.pi * k / DIRECTIONS for k in range(DIRECTIONS)]
    flat = [right * math.cos(angle) + down * math.sin(angle) for angle in angles]
    return flat, ahead


def _toward(fit: SweepFit) -> Tensor:
    _, displacement = fit.state()
    return torch.nn.functional.normalize(displacement, dim=0)


def _travel(fit: SweepFit) -> float:
    """Give by how much the rim moves at most, as if all motion were across the line of sight, m."""
    position, displacement = fit.state()
    distance = float(torch.linalg.vector_norm(position))
    coming = abs(float(displacement @ position)) / distance
    across = float(torch.linalg.vector_norm(displacement)) ** 2 - coming**2
    return math.sqrt(max(across, 0.0)) + coming * fit.model.ball_radius / distance
