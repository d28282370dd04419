"""Vectorised Gauss-Newton for many small least-squares problems at once.

Damping, step rejection, convergence and factorisation failure are kept per element, so that an
element's answer never depends on its neighbours in the batch.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

Problem = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""From parameters [A, K] of the elements with indices [A] to whitened residuals [A, M] and their
Jacobian [A, M, K]."""

Equations = Callable[[Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]
"""From parameters [A, K] of the elements with indices [A] to their cost [A], gradient J'r [A, K]
and information J'J [A, K, K]."""

FIRST_DAMPING = 1e-3
TINY = 1e-300


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Where each element's minimum lies, E elements of K parameters."""

    parameters: Tensor  # [E, K]
    cost: Tensor  # [E] sum of the (robust) squared residuals
    gradient: Tensor  # [E, K] J'r at the solution
    information: Tensor  # [E, K, K] J'J at the solution
    converged: Tensor  # [E] bool
    iterations: int

    @property
    def covariance(self) -> Tensor:
        """Inverse of the information [E, K, K]; infinite where it is singular."""
        return invert_information(self.information)


def minimise(
    problem: Problem,
    start: Tensor,
    *,
    lower: Tensor | None = None,
    upper: Tensor | None = None,
    huber: float = float("inf"),
    max_iterations: int = 30,
    tolerance: float = 1e-6,
) -> Solution:
    """Minimise the sum of squared residuals of every element by damped Gauss-Newton.

    Args:
        problem: whitened residuals and Jacobian of all elements.
        start: first guess [E, K], float64.
        lower: smallest allowed values, broadcast to [E, K].
        upper: largest allowed values.
        huber: residuals beyond this many standard deviations count linearly.
        max_iterations: evaluations after the first.
        tolerance: an element has converged when its step is below this share of every parameter's
            standard deviation (the other parameters held).

    Returns:
        Solution; `converged` is False for elements that ran out of iterations.
    """

    def equations(x: Tensor, elements: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return _normal_equations(problem, x, elements, huber)

    return minimise_equations(
        equations,
        start,
        lower=lower,
        upper=upper,
        max_iterations=max_iterations,
        tolerance=tolerance,
    )


def minimise_equations(
    equations: Equations,
    start: Tensor,
    *,
    lower: Tensor | None = None,
    upper: Tensor | None = None,
    max_iterations: int = 30,
    tolerance: float = 1e-6,
) -> Solution:
    """Do the same for a problem that gives its normal equations itself, without its Jacobian."""
    active = torch.arange(len(start), device=start.device)
    lower = _expanded(lower, -torch.inf, start)
    upper = _expanded(upper, torch.inf, start)
    here = _Point(start, *equations(start, active))
    found = _Point(*(value.clone() for value in here))
    damping = torch.full_like(here.cost, FIRST_DAMPING)
    iteration = 0
    while iteration < max_iterations and len(active):
        iteration += 1
        diagonal = here.information.diagonal(dim1=-2, dim2=-1).clamp_min(TINY)
        system = here.information + torch.diag_embed(damping[:, None] * diagonal)
        x = (here.x + _solve(system, -here.gradient)).clamp(lower, upper)
        there = _Point(x, *equations(x, active))
        is_better = there.cost <= here.cost  # False for NaN
        # a tiny step ends the search even when rejected: then only rounding stands in the way
        is_small = ((x - here.x).abs() <= tolerance * diagonal.rsqrt()).all(-1)
        here = here.replaced(there, is_better)
        damping = torch.where(is_better, 0.1 * damping, (10 * damping).clamp_min(1.0))
        damping = damping.clamp(1e-9, 1e9)
        if bool(is_small.any()) or iteration == max_iterations:
            found.write(here, active)
            left = (~is_small).nonzero()[:, 0]
            here = here.chosen(left)
            active, damping, lower, upper = (v[left] for v in (active, damping, lower, upper))
    converged = torch.ones_like(found.cost, dtype=torch.bool)
    converged[active] = False
    return Solution(
        parameters=found.x,
        cost=found.cost,
        gradient=found.gradient,
        information=found.information,
        converged=converged,
        iterations=iteration,
    )


class _Point(NamedTuple):
    """Where the search of A elements stands."""

    x: Tensor  # [A, K]
    cost: Tensor  # [A]
    gradient: Tensor  # [A, K]
    information: Tensor  # [A, K, K]

    def replaced(self, other: "_Point", where: Tensor) -> "_Point":
        """Take another point for the elements marked [A]."""
        if bool(where.all()):
            return other
        return _Point(
            torch.where(where[:, None], other.x, self.x),
            torch.where(where, other.cost, self.cost),
            torch.where(where[:, None], other.gradient, self.gradient),
            torch.where(where[:, None, None], other.information, self.information),
        )

    def chosen(self, rows: Tensor) -> "_Point":
        """Keep the elements with these indices."""
        return _Point(*(value[rows] for value in self))

    def write(self, other: "_Point", rows: Tensor) -> None:
        """Set the elements with these indices."""
        for mine, value in zip(self, other, strict=True):
            mine[rows] = value


def solve_information(information: Tensor, right: Tensor, damping: float = 0.0) -> Tensor:
    """Solve information @ x = right, damped as much as it takes where that is singular.

    The damping is one of the matrix scaled to a unit diagonal; what is not finite gives 0.

    Args:
        information: symmetric, positive [K, K].
        right: [..., K].
        damping: the least.

    Returns:
        x [..., K].
    """
    scale = information.diagonal().clamp_min(TINY).rsqrt()
    system = information * torch.outer(scale, scale)
    if not bool(torch.isfinite(system).all() & torch.isfinite(right).all()):
        return torch.zeros_like(right)
    for more in (damping, max(damping, 1e-10), max(damping, 1e-7), max(damping, 1e-4), 1.0):
        factor, failed = torch.linalg.cholesky_ex(
            system + more * torch.eye(len(system), dtype=system.dtype)
        )
        if not int(failed):
            break
    columns = (right * scale).reshape(-1, len(scale)).mT
    return torch.cholesky_solve(columns, factor).mT.reshape(right.shape) * scale


def invert_information(information: Tensor) -> Tensor:
    """Invert symmetric positive matrices [..., K, K]; infinite diagonal where they are singular."""
    scale = information.diagonal(dim1=-2, dim2=-1).clamp_min(1e-300).rsqrt()
    factor, failed = torch.linalg.cholesky_ex(
        information * scale[..., :, None] * scale[..., None, :]
    )
    identity = torch.eye(information.shape[-1], dtype=information.dtype, device=information.device)
    factor = torch.where((failed > 0)[..., None, None], identity, factor)
    inverse = torch.cholesky_inverse(factor) * scale[..., :, None] * scale[..., None, :]
    return torch.where((failed > 0)[..., None, None], identity * torch.inf, inverse).nan_to_num(
        nan=0.0, posinf=torch.inf
    )


def _expanded(bound: Tensor | None, default: float, x: Tensor) -> Tensor:
    values = torch.tensor(default, dtype=x.dtype, device=x.device) if bound is None else bound
    return values.expand_as(x)


def _normal_equations(
    problem: Problem, x: Tensor, elements: Tensor, huber: float
) -> tuple[Tensor, Tensor, Tensor]:
    residual, J = problem(x, elements)
    size = residual.abs()
    if huber == float("inf"):
        cost = (residual * residual).sum(-1)
        weighted = J
    else:
        weight = (huber / size.clamp_min(huber)).sqrt()
        cost = torch.where(size <= huber, size * size, 2 * huber * size - huber * huber).sum(-1)
        residual = residual * weight
        weighted = J * weight[..., None]
    gradient = (weighted.mT @ residual[..., None])[..., 0]
    return cost, gradient, weighted.mT @ weighted


def _solve(system: Tensor, right: Tensor) -> Tensor:
    """Solve symmetric positive systems; no step for those that cannot be factorised."""
    factor, failed = torch.linalg.cholesky_ex(system)
    usable = (failed == 0) & torch.isfinite(system.sum((-1, -2)))
    if bool(usable.all()):
        return torch.cholesky_solve(right[..., None], factor)[..., 0]
    identity = torch.eye(system.shape[-1], dtype=system.dtype, device=system.device)
    factor = torch.where(usable[:, None, None], factor, identity)
    solution = torch.cholesky_solve(torch.where(usable[:, None], right, 0)[..., None], factor)
    return solution[..., 0]
