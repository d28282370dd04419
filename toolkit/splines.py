"""Smooth curves as linear combinations of a few basis functions.

One family serves every order the data may ask for: a line has 2 coefficients, a parabola 3, a cubic 4, and more
coefficients make a cubic spline with evenly spread knots.
"""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class SplineBasis:
    """Clamped B-spline basis on [start, stop]; outside, the end pieces are continued as polynomials."""

    start: float
    stop: float
    size: int  # K, number of coefficients

    @property
    def degree(self) -> int:
        """Polynomial degree of each piece, at most 3."""
        return min(self.size - 1, 3)

    def __call__(self, x: Tensor, derivative: int = 0) -> Tensor:
        """Evaluate the basis functions, or a derivative of them, at x [...]: [..., K]."""
        pieces = self.size - self.degree
        length = (self.stop - self.start) / pieces
        local = (x - self.start) / length
        piece = local.floor().clamp(0, pieces - 1)
        return _de_boor(local, piece.long(), self.degree, pieces, derivative) / length**derivative


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
