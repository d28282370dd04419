"""Arcs along which the velocity changes much while the ball crosses a ray.

The opacity's closed form follows a ray's distance from the ball only near its minimum. At the apex
of a throw, at the start of a fall or in a tight bend that is not enough: there an arc is cut into
straight pieces, each the nearest to its part of the arc. [derived]
"""

import itertools
import math
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.sweep.opacity import ArcOpacity, arc_opacity
from toolkit.sweep.passage import REACH
from toolkit.sweep.rays import Rays

SHARP, SMOOTH = 0.35, 0.2
"""Share of its velocity that a ball may gain while it moves by its width: from where on an arc is
cut, and down to where pieces go on."""
INSTANTS = 129
"""At which an arc is asked whether it turns sharply."""
RESIDUE, RESIDUE_PX = 0.005, 0.1
"""Ball radii, and px, by which a piece may leave the arc on either side: the less of the two."""
MOST_PIECES = 120


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
    turn = sharp_turn(arc, low, high, ball_radius)
    if turn is None:
        return [(arc_opacity(arc, rays, start, stop, spread, ball_radius), None)]
    parts: list[tuple[ArcOpacity, Tensor | None]] = []
    for early, late in ((low, turn[0]), (turn[1], high)):
        if early < late:
            begin, end = (time.clamp(early, late) for time in (start, stop))
            parts.append((arc_opacity(arc, rays, begin, end, spread, ball_radius), None))
    bounds = _bounds(arc, *turn, rays, ball_radius)
    for early, late in itertools.pairwise(bounds):
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


def _bounds(arc: Tensor, early: float, late: float, rays: Rays, ball_radius: float) -> list[float]:
    """Cut a part of an arc into straight pieces: the instants between them, and both ends."""
    middle = (early + late) / 2
    distance = torch.linalg.vector_norm(arc[0] + middle * (arc[1] + middle * arc[2]))
    px = float(distance * torch.linalg.vector_norm(rays.right[:, 0]))
    residue = min(RESIDUE * ball_radius, RESIDUE_PX * px)
    # over a time w the nearest straight motion leaves an arc by w^2 c2 / 6 at the ends
    longest = math.sqrt(6 * residue / float(torch.linalg.vector_norm(arc[2])))
    count = min(MOST_PIECES, math.ceil((late - early) / longest))
    bounds: list[float] = torch.linspace(early, late, 1 + count, dtype=torch.float64).tolist()
    return bounds


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


def sharp_turn(
    arc: Tensor, low: float, high: float, ball_radius: float
) -> tuple[float, float] | None:
    """Find from when to when an arc turns, where it does so sharply anywhere; else None."""
    c0, c1, c2 = arc
    if high <= low or not bool((c2 != 0).any()):
        return None
    time = torch.linspace(low, high, INSTANTS, dtype=torch.float64)
    t = time[:, None]
    ahead = torch.nn.functional.normalize(c0 + t * (c1 + t * c2), dim=1)
    across, bend = (
        (v - (v * ahead).sum(1, keepdim=True) * ahead).square().sum(1)
        for v in (c1 + 2 * t * c2, c2.expand_as(ahead))
    )
    gained = 4 * ball_radius * bend.sqrt()
    if not bool((gained > SHARP * across).any()):
        return None
    index = (gained > SMOOTH * across).nonzero()[:, 0]
    first, last = max(int(index[0]) - 1, 0), min(int(index[-1]) + 1, INSTANTS - 1)
    return float(time[first]), float(time[last])
