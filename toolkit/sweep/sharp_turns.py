"""Arcs along which the velocity changes much while the ball crosses a ray.

The opacity's closed form follows a ray's distance from the ball only near its minimum. At the apex
of a throw, at the start of a fall or in a tight bend that is not enough: there an arc is cut into
straight pieces, each the nearest to its part of the arc. [derived]
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.sweep.opacity import ArcOpacity, arc_opacity
from toolkit.sweep.passage import REACH
from toolkit.sweep.rays import Rays

SHARP = 0.7
"""Share of its velocity that a ball may gain while it moves by its width."""
RESIDUE = 0.005
"""Ball radii by which a piece may leave the arc on either side."""
MOST_PIECES = 40


def opacity_parts(
    arc: Tensor, rays: Rays, start: Tensor, stop: Tensor, spread: float, ball_radius: float
) -> list[tuple[ArcOpacity, Tensor | None]]:
    """Give what an arc adds to the opacity, in pieces where it turns sharply.

    Args:
        arc: c0, c1, c2 [3, 3]: m, m per exposure, m per exposure^2.
        rays: N of them.
        start: when each ray's part of the arc begins, exposures [N].
        stop: when it ends [N].
        spread: variance of lens and single pixel together, px^2.
        ball_radius: m.

    Returns:
        Each piece's share, and the derivative of its coefficients in the arc's [9, 9]; None where
        the piece is the arc itself.
    """
    low, high = float(start.min()), float(stop.max())
    if not _turns_sharply(arc, low, high, ball_radius):
        return [(arc_opacity(arc, rays, start, stop, spread, ball_radius), None)]
    # over a time w the nearest straight motion leaves an arc by w^2 c2 / 6 at the ends
    longest = math.sqrt(6 * RESIDUE * ball_radius / float(torch.linalg.vector_norm(arc[2])))
    bounds = torch.linspace(low, high, 1 + min(MOST_PIECES, math.ceil((high - low) / longest)))
    parts: list[tuple[ArcOpacity, Tensor | None]] = []
    for early, late in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        share = _nearest_straight(early, late)
        piece = share @ arc
        index = _about(piece, early, late, rays, spread, ball_radius)
        if not len(index):
            continue
        begin, end = (time[index].clamp(early, late) for time in (start, stop))
        part = arc_opacity(piece, rays[index], begin, end, spread, ball_radius)
        passage = replace(part.passage, index=index[part.passage.index])
        J = torch.kron(share, torch.eye(3, dtype=arc.dtype))
        parts.append((replace(part, passage=passage), J))
    return parts


def _nearest_straight(early: float, late: float) -> Tensor:
    """Give what turns an arc into the straight motion nearest to a part of it [3, 3]."""
    middle, length = (early + late) / 2, late - early
    share = torch.eye(3, dtype=torch.float64)
    # t^2 is nearly 2 m t + w^2 / 12 - m^2
    share[:, 2] = torch.tensor([length**2 / 12 - middle**2, 2 * middle, 0.0])
    return share


def _about(
    arc: Tensor, early: float, late: float, rays: Rays, spread: float, ball_radius: float
) -> Tensor:
    """Find the rays near a short straight piece: indices."""
    middle = arc[0] + (early + late) / 2 * arc[1]
    distance2 = middle @ middle
    reach = float(torch.linalg.vector_norm(arc[1])) * (late - early) / 2 + ball_radius
    px = float((distance2 * (rays.right * rays.right).sum(0).max()).sqrt())
    reach += (REACH * (spread + float(rays.blur.max())) ** 0.5 + 1) * px
    is_near: Tensor = distance2 - (middle @ rays.unit) ** 2 < reach**2
    return is_near.nonzero()[:, 0]


def _turns_sharply(arc: Tensor, low: float, high: float, ball_radius: float) -> bool:
    c0, c1, c2 = arc
    if high <= low or not bool((c2 != 0).any()):
        return False
    slowest = min(max(-float(c1 @ c2) / (2 * float(c2 @ c2)), low), high)
    ahead = torch.nn.functional.normalize(c0 + slowest * (c1 + slowest * c2), dim=0)
    across, bend = (v - (v @ ahead) * ahead for v in (c1 + 2 * slowest * c2, c2))
    gained = 4 * ball_radius * float(torch.linalg.vector_norm(bend))
    return gained > SHARP * float(across @ across)
