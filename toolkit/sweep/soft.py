"""A square root and a ramp behind a lens: their means over normally spread arguments."""

import math
from functools import cache

import torch
from torch import Tensor

LOW, HIGH, STEP = -6.0, 14.0, 0.02
"""Where the smoothed root is tabulated: below it is 0, above two terms of its series suffice."""
NODES = 256
"""Of the integral that fills the table."""


def soft_root(x: Tensor) -> tuple[Tensor, Tensor]:
    """Give the mean of sqrt(max(x + z, 0)) over z ~ N(0, 1), and its derivative in x."""
    table = _table().to(x)
    place = (x.clamp(LOW, HIGH) - LOW) / STEP
    cell = place.detach().long().clamp_max(table.shape[-1] - 2)
    share = place - cell
    near = table[:, cell]
    root, slope = near + share * (table[:, cell + 1] - near)
    is_high = x > HIGH
    if bool(is_high.any()):
        far = x.clamp_min(HIGH)
        plain = far.sqrt()
        root = torch.where(is_high, plain - 1 / (8 * far * plain), root)
        slope = torch.where(is_high, 1 / (2 * plain) + 3 / (16 * far * far * plain), slope)
    return root, slope


def soft_ramp(x: Tensor) -> tuple[Tensor, Tensor]:
    """Give the mean of max(x + z, 0) over z ~ N(0, 1), and its derivative in x."""
    share = torch.special.ndtr(x)
    return x * share + density(x), share


def density(x: Tensor) -> Tensor:
    """Give the normal density."""
    return torch.exp(-0.5 * x * x) * (1 / math.sqrt(2 * math.pi))


@cache
def _table() -> Tensor:
    """Values and slopes of the smoothed root at even steps [2, N].

    With y = t^2 the integrand of sqrt(y) density(y - x) is smooth from the start.
    """
    x = torch.arange(LOW, HIGH + STEP / 2, STEP, dtype=torch.float64)
    longest = math.sqrt(HIGH + 7)
    t = (torch.arange(NODES, dtype=torch.float64) + 0.5) * (longest / NODES)
    gap = t * t - x[:, None]
    weight = 2 * t * t * density(gap) * (longest / NODES)
    return torch.stack([weight.sum(-1), (weight * gap).sum(-1)])
