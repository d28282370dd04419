"""Where a streak is even: far from every rim that the ball shows while it passes.

Seen along a ray, the distance of the ball's centre runs through minima and maxima, and from where
it is as the exposure begins to where it is as it ends. The opacity is smooth in the picture but
where one of these, or a bounce, finds the ray on the ball's rim, and where the ball turns sharply.
[derived]
"""

import itertools

import torch
from torch import Tensor

from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import Arcs
from toolkit.sweep.rays import Rays
from toolkit.sweep.sharp_turns import sharp_turn

INSTANTS = 33
"""At which the distance is taken, on each arc of the path."""
BLOCK = 4_000_000
"""Distances taken together, for the memory's sake: a spline has many instants."""
BLOCK = 2_000_000
"""Distances taken together, for the memory's sake: a spline has many instants."""


def far_from_rims(model: SweepModel, x: Tensor, rays: Rays, margin: float) -> Tensor:
    """Say which rays pass the ball, and no rim by less than a margin [N].

    Args:
        model: of the streak; all rows are exposed at once.
        x: its parameters [P].
        rays: N of them.
        margin: px.
    """
    arcs = model.path.arcs(x[: model.path.size])
    count = 1 + (INSTANTS - 1) * len(arcs.coefficients)
    even = torch.linspace(-0.5, 0.5, count, dtype=torch.float64)
    time, order = torch.cat([even, arcs.joints]).sort()
    centre, turning = arcs.at(time)[0], _turning(arcs, time, model.ball_radius)
    number, size = torch.arange(len(rays.blur)), max(1, BLOCK // len(time))
    is_far = torch.zeros(len(number), dtype=torch.bool)
    for first in range(0, len(number), size):
        block = number[first : first + size]
        gap = _gaps(centre, rays[block], model.ball_radius)
        rise = gap.diff(dim=0)
        is_still = torch.ones_like(gap, dtype=torch.bool)
        is_still[1:-1] = rise[1:] * rise[:-1] <= 0
        is_still[order >= count] = True
        at_rim = (is_still & (gap.abs() < margin)).any(0)
        turned = (gap[turning] < margin).any(0)
        is_far[block] = (gap.amin(0) < -margin) & ~at_rim & ~turned
    return is_far


def _gaps(centre: Tensor, rays: Rays, ball_radius: float) -> Tensor:
    """Give how far rays pass beyond the rim of the ball at each of T places [T, N], px."""
    distance = torch.linalg.vector_norm(centre, dim=-1, keepdim=True)
    view = centre / distance
    # about a ray between them single precision is enough, however far away the ball is
    middle = view.mean(0)
    u, v = (rays.unit - middle[:, None]).float(), (view - middle).float()
    chord2 = (v * v).sum(-1, keepdim=True) + (u * u).sum(0) - 2 * (v @ u)
    apart = (chord2 * (1 - chord2 / 4)).clamp_min(0).sqrt() - (ball_radius / distance).float()
    gaps: Tensor = apart / (rays.right * rays.right).sum(0).sqrt().float()
    return gaps


def _turning(arcs: Arcs, time: Tensor, ball_radius: float) -> Tensor:
    """Say at which times [T] the path turns sharply."""
    is_turning = torch.zeros(len(time), dtype=torch.bool)
    bounds = [-0.5, *arcs.joints.tolist(), 0.5]
    for arc, limits in zip(arcs.coefficients, itertools.pairwise(bounds), strict=True):
        turn = sharp_turn(arc, *limits, ball_radius)
        if turn is not None:
            is_turning |= (time >= turn[0]) & (time <= turn[1])
    return is_turning
