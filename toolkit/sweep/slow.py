"""The opacity of a ball that hardly moves in the picture, or comes straight on: a mean of discs.

Where the image moves less than a few widths of the spread, or along the line of sight, t_m and h no
longer tell well when a ray is covered: for a ball at rest both are infinite. A disc behind the lens
is told by how far its rim is; the mean over instants less than half a spread apart is even in the
velocity, as it must be. [derived]
"""

import math

import torch
from torch import Tensor

from toolkit.sweep.quadrature import gauss_legendre
from toolkit.sweep.rays import Rays
from toolkit.sweep.soft import density

SLOW = 5.0
"""Spreads that the image of a ball moves at most which hardly moves."""
HEAD_ON = 0.15
"""Sine of the angle between motion and line of sight below which the ball comes straight on."""
INSTANTS = 2.5
"""To each spread that the image moves."""
MOST = 160
SHARP = 8.0
"""Spreads from the rim beyond which a pixel is wholly covered, or not at all."""


def count_instants(
    arc: Tensor, start: float, stop: float, spread: float, ball_radius: float
) -> int:
    """Say how many instants tell the mean; 0 where the ball moves too far across for it.

    Args:
        arc: c0, c1, c2 [3, 3].
        start: of the exposure, exposures.
        stop: its end.
        spread: standard deviation of lens and pixel together, radians.
        ball_radius: m.
    """
    t = (start + stop) / 2
    centre, motion = arc[0] + t * (arc[1] + t * arc[2]), arc[1] + 2 * t * arc[2]
    distance = max(float(torch.linalg.vector_norm(centre)), ball_radius)
    velocity = float(torch.linalg.vector_norm(motion))
    coming = abs(float(motion @ centre)) / distance
    across = math.sqrt(max(velocity**2 - coming**2, 0.0))
    angle = (across + coming * ball_radius / distance) / distance
    travel = (stop - start) * angle / spread
    if travel > SLOW and across > HEAD_ON * velocity:
        return 0
    return min(8 + 4 * math.ceil(INSTANTS * travel / 4), MOST)


def slow_opacity(
    arc: Tensor,
    rays: Rays,
    start: Tensor,
    stop: Tensor,
    spread: float,
    ball_radius: float,
    instants: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Give the opacity and its derivatives in arc and spread.

    Args:
        arc: c0, c1, c2 [3, 3].
        rays: N of them.
        start: of each ray's part of the arc, exposures [N].
        stop: end of it [N].
        spread: variance of lens and single pixel together, px^2.
        ball_radius: m.
        instants: of the mean.

    Returns:
        Opacity [N], derivative in the arc [9, N], derivative in the spread [N].
    """
    u, variance = rays.unit, spread + rays.blur
    along, sideways, downwards = arc @ u, arc @ rays.right, arc @ rays.down
    nodes, weights = gauss_legendre(instants)
    alpha, J_spread = torch.zeros_like(start), torch.zeros_like(start)
    J = torch.zeros(3, 3, len(start), dtype=start.dtype)
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        t = start + node * (stop - start)
        share = weight * (stop - start)
        powers = torch.stack([torch.ones_like(t), t, t * t])
        s, r, d = ((products * powers).sum(0) for products in (along, sideways, downwards))
        centre = arc.mT @ powers
        away = centre - s * u
        # many times faster than torch's norm along a first dimension
        gap = (away * away).sum(0).sqrt().clamp_min(1e-3 * ball_radius)
        width = (s / gap).abs() * (variance * (r * r + d * d)).sqrt()
        # how the rim bends counts near the rim alone; in the middle of the disc it has no meaning
        bend = width / (2 * gap.clamp_min(ball_radius / 2))
        x = ((ball_radius - gap) / width - bend).clamp(-SHARP, SHARP)
        alpha += share * torch.special.ndtr(x)
        steep = share * density(x)
        J -= powers[:, None] * (steep / (width * gap) * away)
        J_spread -= steep * ((ball_radius - gap) / width + bend) / (2 * variance)
    return alpha, J.flatten(0, 1), J_spread
