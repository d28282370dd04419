"""When a ball on an arc comes nearest to each ray, and which rays it covers.

On an arc C(t) = c0 + c1 t + c2 t^2 the squared distance f(t) = |C|^2 - (C.u)^2 of the centre from a
unit ray u is a quartic in time, for an unaccelerated arc a parabola.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.sweep.rays import Rays

REACH = 6.0
"""Standard deviations of the spread beyond the contour up to which a pixel sees the ball."""
STRAIGHT = 1e-12
"""Bend of an arc over its way from which it counts: less comes from rounding alone."""
GUESSES = 9
"""Instants from which the one of closest approach is searched on a bent arc."""
NEWTON_STEPS = 4
SLACKEST = 1e-6
"""Share of the squared speed below which the motion does not go across a ray at all."""
MOSTLY = 0.6
"""Share of the rays from which an arc is followed for all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """How the ball passes M of N rays, without any spread."""

    index: Tensor  # [M] of the rays that it covers or nearly does
    instant: Tensor  # [M] of closest approach, exposures
    room: Tensor  # [M] q: R^2 less the squared distance of the centre from the ray, m^2
    stiffness: Tensor  # [M] A, m^2 per squared exposure
    side: Tensor  # [M] 1 where the ray passes to the right of the ball's motion, else -1


def find_passage(
    arc: Tensor,
    rays: Rays,
    start: Tensor,
    stop: Tensor,
    spread: float,
    ball_radius: float,
    *,
    is_all: bool = False,
) -> tuple[Passage, Rays, Tensor, Tensor]:
    """Find when the ball's centre is nearest to each ray, and keep the rays that it may cover.

    Args:
        arc: c0, c1, c2 [3, 3]: m, m per exposure, m per exposure^2.
        rays: N of them.
        start: when each ray's part of the arc begins, exposures [N].
        stop: when it ends [N].
        spread: variance of lens and single pixel together, px^2.
        ball_radius: m.
        is_all: keep all of them.

    Returns:
        The passage of those kept, they themselves, and their start and stop.
    """
    a0, a1, a2 = arc @ rays.unit
    c = arc @ arc.mT
    is_straight = float(arc[2].abs().max()) <= STRAIGHT * float(arc[1].abs().max())
    if is_straight:
        A = (c[1, 1] - a1 * a1).clamp_min(SLACKEST * float(c[1, 1]))
        t = (a0 * a1 - c[0, 1]) / A
        f = c[0, 0] - a0 * a0 - A * t * t
    else:
        quartic = (
            c[0, 0] - a0 * a0,
            2 * (c[0, 1] - a0 * a1),
            c[1, 1] + 2 * c[0, 2] - a1 * a1 - 2 * a0 * a2,
            2 * (c[1, 2] - a1 * a2),
            c[2, 2] - a2 * a2,
        )
        t = _nearest_instant(quartic, start, stop)
        f0, f1, f2, f3, f4 = quartic
        f = f0 + t * (f1 + t * (f2 + t * (f3 + t * f4)))
        A = (f2 + t * (3 * f3 + t * 6 * f4)).clamp_min(SLACKEST * float(c[1, 1]))
    # room for the spread: a px is about this long at the ball
    blur = (
        REACH
        * (spread + float(rays.blur.max())) ** 0.5
        * float(torch.linalg.vector_norm(rays.right[:, 0]))
    )
    middle = float(start.min() + stop.max()) / 2
    slack = blur * float(torch.linalg.vector_norm(arc[0] + middle * (arc[1] + middle * arc[2])))
    half = (((ball_radius + slack) ** 2 - f).clamp_min(0) / A).sqrt()
    reach = half + (slack + blur * half * a1.abs()) * A.rsqrt()
    is_near = (half > 0) & (t + reach > start) & (t - reach < stop)
    index = is_near.nonzero()[:, 0]
    room = ball_radius**2 - f
    if not is_all and len(index) < MOSTLY * len(t):
        t, A, room, start, stop = t[index], A[index], room[index], start[index], stop[index]
        rays = rays[index]
    else:  # to leave out the few that it does not cover costs more than to follow them
        index = torch.arange(len(t))
    unit = rays.unit
    # u . (C x C'), which is the same for C and C' at any time of a straight arc
    c01 = torch.linalg.cross(arc[0], arc[1])
    side = c01 @ unit
    if not is_straight:
        c02 = torch.linalg.cross(arc[0], arc[2])
        c12 = torch.linalg.cross(arc[1], arc[2])
        side = side + t * (2 * (c02 @ unit) + t * (c12 @ unit))
    passage = Passage(index=index, instant=t, room=room, stiffness=A, side=side.sign())
    return passage, rays, start, stop


def _nearest_instant(quartic: tuple[Tensor, ...], start: Tensor, stop: Tensor) -> Tensor:
    """Minimise quartics over the time about each ray's part of the arc, by Newton's method."""
    f0, f1, f2, f3, f4 = quartic
    low, high = float(start.min()), float(stop.max())
    guesses = torch.linspace(low, high, GUESSES, dtype=f0.dtype)
    best, t = torch.full_like(f0, torch.inf), torch.zeros_like(f0)
    for guess in guesses.tolist():
        value = f0 + guess * (f1 + guess * (f2 + guess * (f3 + guess * f4)))
        is_better = value < best
        best, t = torch.where(is_better, value, best), torch.where(is_better, guess, t)
    longest = high - low
    for _ in range(NEWTON_STEPS):
        fall = f1 + t * (2 * f2 + t * (3 * f3 + t * 4 * f4))
        bend = 2 * f2 + t * (6 * f3 + t * 12 * f4)
        t = t - (fall / bend.clamp_min(1e-3 * f2.abs() + 1e-300)).clamp(-longest, longest)
    return t
