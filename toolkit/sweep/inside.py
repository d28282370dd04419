"""Where a streak is even: far from every rim that the ball shows while it passes.

Seen along a ray, the distance of the ball's centre runs through minima and maxima, and from where
it is as the exposure begins to where it is as it ends. The opacity is smooth in the picture but
where one of these, or a bounce, finds the ray on the ball's rim. [derived]
"""

import torch
from torch import Tensor

from toolkit.sweep.model import SweepModel
from toolkit.sweep.rays import Rays

INSTANTS = 33
"""At which the distance is taken, on each arc of the path."""


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
    centre = arcs.at(time)[0].float()
    unit, right = rays.unit.float(), rays.right.float()
    distance2 = (centre * centre).sum(-1, keepdim=True)
    apart = (distance2 - (centre @ unit) ** 2).clamp_min(0).sqrt()
    px = distance2.sqrt() * (right * right).sum(0).sqrt()
    gap = (apart - model.ball_radius) / px
    rise = gap.diff(dim=0)
    is_still = torch.ones_like(gap, dtype=torch.bool)
    is_still[1:-1] = rise[1:] * rise[:-1] <= 0
    is_still[order >= count] = True
    at_rim = (is_still & (gap.abs() < margin)).any(0)
    return (gap.amin(0) < -margin) & ~at_rim
