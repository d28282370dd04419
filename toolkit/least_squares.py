"""Vectorised Gauss-Newton for many small least-squares problems at once.

Damping, step rejection, convergence and factorisation failure are kept per element, so that an
element's answer never depends on its neighbours in the batch.
"""

from collections.abc import Callable
from dataclasses import dataclass

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
    x = start.clone()
    active = torch.arange(len(x), device=x.device)
    lower = _expanded(lower, -torch.inf, x)
    upper = _expanded(upper, torch.inf, x)
    cost, gradient, information = equations(x, active)
    damping = torch.full_like(cost, FIRST_DAMPING)
    iteration = 0
    while iteration < max_iterations and len(active):
        iteration += 1
        old, old_information = x[active], information[active]
        diagonal = old_information.diagonal(dim1=-2, dim2=-1).clamp_min(TINY)
        system = old_information + torch.diag_embed(damping[active, None] * diagonal)
        candidate = old + _solve(system, -gradient[active])
        candidate = torch.minimum(torch.maximum(candidate, lower[active]), upper[active])
        trial_cost, trial_gradient, trial_information = equations(candidate, active)
        is_better = trial_cost <= cost[active]  # False for NaN
        improved = active[is_better]
        x[improved] = candidate[is_better]
        cost[improved] = trial_cost[is_better]
        gradient[improved] = trial_gradient[is_better]
        information[improved] = trial_information[is_better]
        damping[active] = torch.where(
            is_better, damping[active] * 0.1, (damping[active] * 10).clamp_min(1.0)
        ).clamp(1e-9, 1e9)
        # a tiny step ends the search even when rejected: then only rounding stands in the way
        is_small = ((candidate - old).abs() <= tolerance * diagonal.rsqrt()).all(-1)
        active = active[~is_small]
    converged = torch.ones_like(cost, dtype=torch.bool)
    converged[active] = False
    return Solution(
        parameters=x,
        cost=cost,
        gradient=gradient,
        information=information,
        converged=converged,
        iterations=iteration,
    )


def solve_information(information: Tensor, right: Tensor, damping: float = 0.0) -> Tensor:
    """Solve information @ x = right, damped as much as it takes where that is singular.

    The damping is one of the matrix scaled to a unit diagonal; what is not finite gives 0.

    Args:
        information: symmetric, positive [K, K].
        right: [K].
        damping: the least.

    Returns:
        x [K].
    """
    scale = information.diagonal().clamp_min(TINY).rsqrt()
    system = information * torch.outer(scale, scale)
    if not bool(torch.isfinite(system).all() & torch.isfinite(right).all()):
        return torch.zeros_like(right)
    for more in (damping, max(damping, 1e-10), max(damping, 1e-7), max(damping, 1e-4), 1.0):
        factor, failed = torch.linalg.cholesky_ex(
            system + more * torch.eye(len(right), dtype=system.dtype)
        )
        if not int(failed):
            break
    return torch.cholesky_solve((right * scale)[:, None], factor)[:, 0] * scale


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
    usable = (failed == 0) & torch.isfinite(system).all(-1).all(-1)
    identity = torch.eye(system.shape[-1], dtype=system.dtype, device=system.device)
    factor = torch.where(usable[:, None, None], factor, identity)
    solution = torch.cholesky_solve(torch.where(usable[:, None], right, 0)[..., None], factor)
    return solution[..., 0]
