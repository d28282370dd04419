"""A square root and a ramp behind a lens: their means over normally spread arguments."""

import math
from functools import cache

import torch
from torch import Tensor

LOW, HIGH, STEP = -6.0, 6.0, 0.01
"""Where the smoothed root is tabulated: below it is 0, above three terms of its series suffice."""
SMALLEST = -300.0
"""Logarithm below which a density counts as this small."""
NODES = 256
"""Of the integral that fills the table."""


def soft_root(x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Give the mean of sqrt(max(x + z, 0)) over z ~ N(0, 1), and how it bends, each with its slope.

    The bend is the mean of z^2 times the slope of the root at x + z: by so much the mean falls for
    each z^2 taken from x + z.

    Returns:
        Mean, its derivative in x, bend, its derivative in x.
    """
    far = x.clamp_min(HIGH)
    plain, inverse = far.sqrt(), 1 / (far * far)
    root = plain * (1 - inverse * (1 / 8 + inverse * (15 / 128)))
    slope = (0.5 + inverse * (3 / 16 + inverse * (105 / 256))) / plain
    bend = (0.5 + inverse * (9 / 16 + inverse * (525 / 256))) / plain
    turn = -(0.25 + inverse * (45 / 32)) / (plain * far)
    near = (x < HIGH).nonzero()[:, 0]
    if len(near):
        root[near], slope[near], bend[near], turn[near] = _looked_up(x[near])
    return root, slope, bend, turn


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
    # numbers too small to be written down in full take tens of times longer
    return torch.exp((-0.5 * x * x).clamp_min(SMALLEST)) * (1 / math.sqrt(2 * math.pi))


@cache
def _table() -> Tensor:
    """Values of the smoothed root, its slope, its bend and the bend's slope, at even steps [4, N].

    With y = t^2 the integrand of sqrt(y) density(y - x) is smooth from the start.
    """
    x = torch.arange(LOW, HIGH + STEP / 2, STEP, dtype=torch.float64)
    longest = math.sqrt(HIGH + 7)
    t = (torch.arange(NODES, dtype=torch.float64) + 0.5) * (longest / NODES)
    gap = t * t - x[:, None]
    share = density(gap) * (longest / NODES)
    root = 2 * t * t * share
    bend = share * gap * gap
    rows = (root, root * gap, bend, bend * gap - 2 * share * gap)
    return torch.stack([row.sum(-1) for row in rows])
