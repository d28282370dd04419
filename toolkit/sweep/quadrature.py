"""Gauss-Legendre quadrature."""

from functools import cache

import numpy as np
import torch
from torch import Tensor


@cache
def gauss_legendre(count: int) -> tuple[Tensor, Tensor]:
    """Give nodes and weights on 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return torch.from_numpy((nodes + 1) / 2), torch.from_numpy(weights / 2)
