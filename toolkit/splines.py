"""Smooth curves as linear combinations of a few basis functions.

One family serves every order the data may ask for: a line has 2 coefficients, a parabola 3, a cubic
4, and more coefficients make a cubic spline with evenly spread knots.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class SplineBasis:
    """Clamped B-spline basis on [start, stop]; outside, the ends go on as polynomials.

    `continuation` bounds the degree of those: a cubic end piece, followed beyond its data, runs
    away.
    """

    start: float
    stop: float
    size: int  # K, number of coefficients
    continuation: int = 3

    @property
    def degree(self) -> int:
        """Polynomial degree of each piece, at most 3."""
        return min(self.size - 1, 3)

    def __call__(self, x: Tensor, derivative: int = 0) -> Tensor:
        """Evaluate the basis functions, or a derivative of them, at x [...]: [..., K]."""
        pieces = self.size - self.degree
        length = (self.stop - self.start) / pieces
        local = (x - self.start) / length
        table = _taylor_table(self.degree, pieces, min(self.continuation, self.degree)).to(x)
        if pieces == 1 and self.continuation >= self.degree:
            # one polynomial everywhere
            return _powers(local, self.degree, derivative) @ table[1] / length**derivative
        # row 0 continues the start, rows 1 to `pieces` are the pieces, the last continues the end
        row = torch.where(local > pieces, pieces, local.floor()).clamp(-1, pieces) + 1
        powers = _powers(local - (row - 1).clamp_min(0), self.degree, derivative)
        basis = (powers[..., None, :] @ table[row.long()])[..., 0, :]
        return basis / length**derivative


def _powers(u: Tensor, degree: int, derivative: int) -> Tensor:
    """Derivatives of 1, u, u^2, ... up to u^degree, [..., degree + 1]."""
    columns = [
        math.perm(power, derivative) * u ** (power - derivative)
        if power >= derivative
        else torch.zeros_like(u)
        for power in range(degree + 1)
    ]
    return torch.stack(columns, dim=-1)


@lru_cache(maxsize=64)
def _taylor_table(degree: int, pieces: int, continuation: int) -> Tensor:
    """Taylor coefficients of the basis about each piece's start, [pieces + 2, degree + 1, K]."""
    starts = torch.arange(pieces + 1, dtype=torch.float64)
    piece = starts.long().clamp(max=pieces - 1)
    rows = [
        _de_boor(starts, piece, degree, pieces, power) / math.factorial(power)
        for power in range(degree + 1)
    ]
    table = torch.stack(rows, dim=1)
    table = torch.cat([table[:1], table])
    for outer in (0, -1):
        table[outer, continuation + 1 :] = 0
    return table


def _de_boor(x: Tensor, piece: Tensor, degree: int, pieces: int, derivative: int) -> Tensor:
    """Cox-de Boor recursion with unit pieces; `piece` [...] says whose polynomial is evaluated."""
    knots = torch.arange(-degree, pieces + degree + 1, dtype=x.dtype, device=x.device)
    knots = knots.clamp(0, pieces)
    basis = torch.nn.functional.one_hot(piece + degree, pieces + 2 * degree).to(x.dtype)
    for order in range(1, degree + 1):
        count = basis.shape[-1] - 1
        left, right = knots[:count], knots[order + 1 : order + 1 + count]
        span_left = knots[order : order + count] - left
        span_right = right - knots[1 : 1 + count]
        inverse_left = torch.where(span_left > 0, 1 / span_left.clamp_min(1e-9), 0)
        inverse_right = torch.where(span_right > 0, 1 / span_right.clamp_min(1e-9), 0)
        if order > degree - derivative:
            rise = order * inverse_left
            fall = order * inverse_right
            basis = rise * basis[..., :-1] - fall * basis[..., 1:]
        else:
            rise = (x[..., None] - left) * inverse_left
            fall = (right - x[..., None]) * inverse_right
            basis = rise * basis[..., :-1] + fall * basis[..., 1:]
    return basis


def fit_spline(
    basis: SplineBasis, x: Tensor, values: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Fit values [N, D] at x [N] by weighted least squares, weight [N] being 1 / variance.

    Returns:
        Coefficients [K, D] and the inverse of the weighted normal matrix [K, K].
    """
    design = basis(x)
    normal = design.mT @ (weight[:, None] * design)
    ridge = 1e-12 * normal.diagonal().mean() * torch.eye(basis.size, dtype=x.dtype)
    inverse = torch.linalg.inv(normal + ridge)
    return inverse @ (design.mT @ (weight[:, None] * values)), inverse


@dataclass(frozen=True, slots=True, kw_only=True)
class SplineFit:
    """A smooth curve through data, as rough as the data ask for and no rougher."""

    basis: SplineBasis
    coefficients: Tensor  # [K, D]
    inverse: Tensor  # [K, K] of the weighted normal matrix
    weight: Tensor  # [N] 1 / variance after outliers lost theirs

    def __call__(self, x: Tensor, derivative: int = 0) -> Tensor:
        """Evaluate the curve, or a derivative, at x [...]: [..., D]."""
        return self.basis(x, derivative) @ self.coefficients

    def std(self, x: Tensor) -> Tensor:
        """Standard deviation of the curve at x [...], each component."""
        design = self.basis(x)
        return ((design @ self.inverse) * design).sum(-1).clamp_min(0).sqrt()


SIZES = (2, 3, 4, 5, 6, 8, 10, 13, 17)
"""Numbers of coefficients tried: line, parabola, cubic, then splines with more and more knots."""
OUTLIER = 4.5
"""Tukey's biweight reaches zero here, robust standard deviations: 95 % efficient on clean data."""


def fit_smooth(
    x: Tensor, values: Tensor, weight: Tensor, sizes: tuple[int, ...] = SIZES
) -> SplineFit:
    """Fit the curve whose order the data ask for, robustly against outliers.

    Outliers are found once, against the most flexible curve, so that all orders are compared on the
    same data; the order is the one with the smallest Bayesian information criterion.

    Args:
        x: [N].
        values: [N, D].
        weight: 1 / variance, 0 for what is to be ignored [N].
        sizes: numbers of coefficients to choose from.
    """
    used = weight > 0
    count = int(used.sum())
    start, stop = float(x[used].min()), float(x[used].max())
    possible = [size for size in sizes if size <= max(2, count // 6)] or [min(sizes)]
    flexible = SplineBasis(start=start, stop=stop, size=possible[-1])
    robust = weight
    for _ in range(4):
        coefficients, _ = fit_spline(flexible, x, values, robust)
        size = _standardised(flexible, coefficients, x, values, weight)
        # below 1 it only shows that neighbours share samples; smooth errors gain nothing by that
        scale = (size[used].median() * _median_factor(values.shape[1])).clamp_min(1.0)
        robust = weight * (1 - (size / (OUTLIER * scale)) ** 2).clamp_min(0) ** 2
    fits = []
    for order in possible:
        basis = SplineBasis(start=start, stop=stop, size=order)
        coefficients, inverse = fit_spline(basis, x, values, robust)
        misfit = ((basis(x) @ coefficients - values) ** 2 * robust[:, None]).sum() / scale**2
        penalty = values.shape[1] * order * math.log(count)
        fits.append((float(misfit + penalty), basis, coefficients, inverse))
    _, basis, coefficients, inverse = min(fits, key=lambda fit: fit[0])
    return SplineFit(basis=basis, coefficients=coefficients, inverse=inverse, weight=robust)


def up_to(limit: float, sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Give the numbers of coefficients not above a limit, at least the smallest."""
    return tuple(size for size in sizes if size <= limit) or sizes[:1]


def _standardised(
    basis: SplineBasis, coefficients: Tensor, x: Tensor, values: Tensor, weight: Tensor
) -> Tensor:
    """Length of each residual in standard deviations [N]."""
    squared = ((basis(x) @ coefficients - values) ** 2).sum(-1)
    return (squared * weight).sqrt()


def _median_factor(dimensions: int) -> float:
    """Standard deviation over the median length of a normal vector of 1 or 2 components."""
    return 1.4826 if dimensions == 1 else 0.8493
