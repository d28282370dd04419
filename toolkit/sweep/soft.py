"""A square root and a ramp behind a lens: their means over normally spread arguments."""

import math
from functools import cache

import torch
from torch import Tensor

LOW, HIGH, STEP = -6.0, 6.0, 0.01
"""Where the smoothed root is tabulated: below it is 0, above three terms of its series suffice."""
NODES = 256
"""Of the integral that fills the table."""


def soft_root(x: Tensor) -> tuple[Tensor, Tensor]:
    """Give the mean of sqrt(max(x + z, 0)) over z ~ N(0, 1), and its derivative in x."""
    far = x.clamp_min(HIGH)
    plain, inverse = far.sqrt(), 1 / (far * far)
    root = plain * (1 - inverse * (1 / 8 + inverse * (15 / 128)))
    slope = (0.5 + inverse * (3 / 16 + inverse * (105 / 256))) / plain
    near = (x < HIGH).nonzero()[:, 0]
    if len(near):
        root[near], slope[near] = _looked_up(x[near])
    return root, slope


def _looked_up(x: Tensor) -> Tensor:
    table = _table().to(x)
    place = ((x - LOW) / STEP).clamp(0, table.shape[-1] - 1.001)
    cell = place.long()
    near = table[:, cell]
    return near + (place - cell) * (table[:, cell + 1] - near)


def soft_ramp(x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give the mean of max(x + z, 0) over z ~ N(0, 1), and its two derivatives in x."""
    ramp, share, dense = x.clone(), torch.ones_like(x), torch.zeros_like(x)
    near = (x < HIGH).nonzero()[:, 0]
    if len(near):
        there = x[near]
        share_near, dense_near = torch.special.ndtr(there), density(there)
        share[near], dense[near] = share_near, dense_near
        ramp[near] = there * share_near + dense_near
    return ramp, share, dense


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
