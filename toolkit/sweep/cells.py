"""Cells of the streak in which the ball's light is its own: fitted with all else, then forgotten.

Marks on the ball darken or lighten what is seen before a cell by a share drawn at random, of known
variance. The likeliest light of each cell follows in closed form from all else, since cells share
no pixel; put in, it leaves the equations of all else. [derived]
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from toolkit.least_squares import solve_information

if TYPE_CHECKING:
    from toolkit.sweep.likelihood import Comparison


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """K cells of the N pixels of a fit."""

    number: Tensor  # [N] of each pixel's cell
    count: int
    share: Tensor  # [N] by which a pixel sees more or less of a cell's light than of the ball's
    variance: float = 0.0  # of each cell's light, over the square of the ball's

    def sums(self, seen: "Comparison") -> "CellSums":
        """Sum up what the pixels of each cell say of its light."""
        weight = seen.weight
        change, missed = weight * seen.light * self.share, weight * seen.residual
        pull, hold = torch.zeros(2, self.count, dtype=torch.float64).unbind()
        shared = torch.zeros(len(seen.gradient), self.count, dtype=torch.float64)
        for q, (J, at) in enumerate(zip(seen.J, seen.columns, strict=True)):
            pull.index_add_(0, self.number, change[q] * missed[q])
            hold.index_add_(0, self.number, change[q] ** 2)
            part = torch.zeros(len(at), self.count, dtype=torch.float64)
            shared[at] += part.index_add_(1, self.number, J * change[q])
        return CellSums(pull=pull, hold=hold, shared=shared)

    def freed(self, seen: "Comparison") -> "Comparison":
        """Give the comparison in which each cell has its likeliest light."""
        sums = self.sums(seen)
        scale = 1 / (sums.hold + 1 / self.variance)
        found, taken = scale * sums.pull, sums.shared * scale
        whitened = []
        light = seen.light * self.share
        for J, at, change in zip(seen.J, seen.columns, seen.weight * light, strict=True):
            # through the cells' light each channel tells of what only others hang on
            rows = -taken[:, self.number] * change
            rows[at] += J
            whitened.append(rows)
        return replace(
            seen,
            cost=seen.cost - float(found @ sums.pull),
            gradient=seen.gradient + sums.shared @ found,
            information=seen.information - taken @ sums.shared.mT,
            residual=seen.residual - light * found[self.number],
            J=tuple(whitened),
            columns=(torch.arange(len(seen.gradient)),) * len(whitened),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CellSums:
    """Sums over the pixels of each of K cells."""

    pull: Tensor  # [K] of the misfit
    hold: Tensor  # [K] of the information about the cell's light
    shared: Tensor  # [P, K] with the parameters

    def merged(self, number: Tensor, count: int) -> "CellSums":
        """Give the sums of larger cells, told the number of the one that each falls to [K]."""

        def add(values: Tensor) -> Tensor:
            return values.new_zeros(*values.shape[:-1], count).index_add_(-1, number, values)

        return CellSums(pull=add(self.pull), hold=add(self.hold), shared=add(self.shared))

    def cost(self, seen: "Comparison", variance: float) -> float:
        """Give -2 log of the restricted likelihood, which counts what is fitted, of such lights.

        The parameters are the most likely ones; what is the same for all variances is left out.
        """
        scale = 1 / (self.hold + 1 / variance)
        information = seen.information - (self.shared * scale) @ self.shared.mT
        gradient = seen.gradient + self.shared @ (scale * self.pull)
        explained = float(scale @ self.pull**2)
        explained += float(gradient @ solve_information(information, gradient))
        price = float((1 + variance * self.hold).log().sum() + information.logdet())
        return seen.cost - explained + price
