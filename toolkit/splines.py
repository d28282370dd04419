"""Smooth curves as linear combinations of a few basis functions.

One family serves every order the data may ask for: a line has 2 coefficients, a parabola 3, a cubic
4, and more coefficients make a cubic spline with evenly spread knots.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

# NumPy inside: on arrays as small as these each of its steps takes a fifth of torch's
Array = NDArray[np.float64]


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
        return torch.from_numpy(self.design(x.double().numpy(), derivative)).to(x)

    def design(self, x: Array, derivative: int = 0) -> Array:
        """Do the same for arrays."""
        pieces = self.size - self.degree
        length = (self.stop - self.start) / pieces
        local = (x - self.start) / length
        table = _taylor_table(self.degree, pieces, min(self.continuation, self.degree))
        if pieces == 1 and self.continuation >= self.degree:
            # one polynomial everywhere
            basis = _powers(local, self.degree, derivative) @ table[1]
        else:
            # row 0 continues the start, rows 1 to `pieces` are the pieces, the last continues the
            # end
            row = np.where(local > pieces, pieces, np.floor(local)).clip(-1, pieces) + 1
            powers = _powers(local - (row - 1).clip(0), self.degree, derivative)
            basis = (powers[..., None] * table[row.astype(np.intp)]).sum(-2)
        return np.asarray(basis / length**derivative)

    def value_and_slope(self, x: Array, coefficients: Array) -> tuple[Array, Array]:
        """Give the curve with coefficients [K, D] at x [...] and its derivative, [D, ...] each."""
        pieces = self.size - self.degree
        length = (self.stop - self.start) / pieces
        u = (x - self.start) / length
        table = _taylor_table(self.degree, pieces, min(self.continuation, self.degree))
        polynomials = (table @ coefficients).transpose(1, 2, 0)  # [degree + 1, D, pieces + 2]
        if pieces == 1 and self.continuation >= self.degree:
            parts = list(polynomials[:, :, 1].reshape(self.degree + 1, -1, *[1] * x.ndim))
        else:
            row = np.where(u > pieces, pieces, np.floor(u)).clip(-1, pieces).astype(np.intp) + 1
            u = u - (row - 1).clip(0)
            parts = [part[:, row] for part in polynomials]
        value, slope = parts[-1], np.zeros_like(parts[-1])
        for part in reversed(parts[:-1]):
            slope = slope * u + value
            value = value * u + part
        shape = (coefficients.shape[1], *x.shape)
        return np.broadcast_to(value, shape), np.broadcast_to(slope / length, shape)


def _powers(u: Array, degree: int, derivative: int) -> Array:
    """Derivatives of 1, u, u^2, ... up to u^degree, [..., degree + 1]."""
    powers = np.zeros((*u.shape, degree + 1))
    power = np.ones_like(u)
    for exponent in range(derivative, degree + 1):
        powers[..., exponent] = math.perm(exponent, derivative) * power
        power = power * u
    return powers


@lru_cache(maxsize=64)
def _taylor_table(degree: int, pieces: int, continuation: int) -> Array:
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
    return np.asarray(table.numpy())


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
    design = basis.design(x.numpy())
    coefficients, inverse = _least_squares(design, values.numpy()[:, None], weight.numpy()[:, None])
    return torch.from_numpy(coefficients[0]), torch.from_numpy(inverse[0])


def _least_squares(design: Array, values: Array, weight: Array) -> tuple[Array, Array]:
    """Fit C curves at once, design [N, K], values [N, C, D], weight [N, C].

    Returns:
        Coefficients [C, K, D] and the inverses of the weighted normal matrices [C, K, K].
    """
    points, curves, dimensions = values.shape
    size = design.shape[1]
    squares = (design[:, :, None] * design[:, None, :]).reshape(points, -1)
    normal = (weight.T @ squares).reshape(curves, size, size)
    ridge = 1e-12 * normal.diagonal(axis1=1, axis2=2).mean(-1)
    inverse = np.linalg.inv(normal + ridge[:, None, None] * np.eye(size))
    weighted = (weight[..., None] * values).reshape(points, -1)
    right = (design.T @ weighted).reshape(size, curves, dimensions)
    return inverse @ right.transpose(1, 0, 2), inverse


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
ROBUST_ROUNDS = 4


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
    return fit_smooth_columns(x, values[:, None], weight[:, None], sizes)[0]


def fit_smooth_columns(
    x: Tensor, values: Tensor, weight: Tensor, sizes: tuple[int, ...] = SIZES
) -> list[SplineFit]:
    """Do the same for C curves at once, each of an order of its own.

    Args:
        x: [N].
        values: [N, C, D].
        weight: 1 / variance [N, C]; 0 at the same places for all curves.
        sizes: numbers of coefficients to choose from.
    """
    at, data, given = x.numpy(), values.numpy(), weight.numpy()
    used = given[:, 0] > 0
    count = int(np.count_nonzero(used))
    start, stop = float(at[used].min()), float(at[used].max())
    possible = [size for size in sizes if size <= max(2, count // 6)] or [min(sizes)]
    bases = [SplineBasis(start=start, stop=stop, size=size) for size in possible]
    designs = [basis.design(at) for basis in bases]
    robust, scale = _without_outliers(designs[-1], data, given, used)
    fits = [_least_squares(design, data, robust) for design in designs]
    criteria = [
        (_squares(design, fit[0], data) * robust).sum(0) / scale**2
        + data.shape[2] * basis.size * math.log(count)
        for basis, design, fit in zip(bases, designs, fits, strict=True)
    ]
    return [
        SplineFit(
            basis=bases[best],
            coefficients=torch.from_numpy(fits[best][0][curve]),
            inverse=torch.from_numpy(fits[best][1][curve]),
            weight=torch.from_numpy(np.ascontiguousarray(robust[:, curve])),
        )
        for curve, best in enumerate(np.argmin(criteria, axis=0).tolist())
    ]


def _without_outliers(
    design: Array, values: Array, weight: Array, used: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Give robust weights [N, C] about the curves of a design, and how far noise exceeds them."""
    robust, middle = weight, (np.count_nonzero(used) - 1) // 2
    for _ in range(ROBUST_ROUNDS):
        coefficients, _ = _least_squares(design, values, robust)
        size = np.sqrt(_squares(design, coefficients, values) * weight)
        median = np.partition(size[used], middle, axis=0)[middle]
        # below 1 it only shows that neighbours share samples; smooth errors gain nothing by that
        scale = (median * _median_factor(values.shape[2])).clip(1.0)
        robust = weight * (1 - (size / (OUTLIER * scale)) ** 2).clip(0) ** 2
    return robust, scale


def _squares(design: Array, coefficients: Array, values: Array) -> Array:
    """Squared length of each residual [N, C]."""
    residual = np.moveaxis(design @ coefficients, 0, 1) - values
    return np.asarray((residual * residual).sum(-1))


def up_to(limit: float, sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Give the numbers of coefficients not above a limit, at least the smallest."""
    return tuple(size for size in sizes if size <= limit) or sizes[:1]


def _median_factor(dimensions: int) -> float:
    """Standard deviation over the median length of a normal vector of 1 or 2 components."""
    return 1.4826 if dimensions == 1 else 0.8493
