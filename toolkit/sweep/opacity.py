"""The exact opacity of a sphere that moves along an arc, seen through lens and pixels.

A ray u is covered while f(t) = |C(t) x u|^2 < R^2. About its minimum t_m it is covered for
t_m -+ h, h = sqrt(q / A), with q = R^2 - f(t_m) and A = f''/2, and the opacity is the part of that
within the exposure (MATHS, "The exact streak of a moving ball"; for an unaccelerated arc the closed
form there). Lens and pixel spread a point; the pixel's area counts for 1/12 px^2 of variance.

With s = C.u the distance is f = |C|^2 - s^2, so that all that changes from ray to ray is told by
the products of u, and of its change from pixel to pixel, with the arc's coefficients. [derived]
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.sweep.crossing import Crossing, Slopes, Spread, mean_opacity
from toolkit.sweep.passage import Passage, find_passage
from toolkit.sweep.rays import Rays
from toolkit.sweep.slow import count_instants, slow_opacity

PIXEL_VARIANCE = 1 / 12
"""px^2, of a place within a pixel, along each side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcOpacity:
    """What an arc adds to the opacity of M rays, and how that changes."""

    passage: Passage
    alpha: Tensor  # [M]
    J_arc: Tensor  # [9, M] in c0, c1, c2
    J_spread: Tensor  # [M] in the variance of the spread, per px^2


def arc_opacity(
    arc: Tensor,
    rays: Rays,
    start: Tensor,
    stop: Tensor,
    spread: float,
    ball_radius: float,
) -> ArcOpacity:
    """Give the opacity by which one arc covers each ray, and its derivatives in closed form.

    Args:
        arc: c0, c1, c2 [3, 3]: m, m per exposure, m per exposure^2.
        rays: N of them.
        start: when each ray's part of the arc begins, exposures [N].
        stop: when it ends [N].
        spread: variance of lens and single pixel together, px^2.
        ball_radius: m.
    """
    angle = float(torch.linalg.vector_norm(rays.right[:, 0]))
    first, last = float(start.min()), float(stop.max())
    instants = count_instants(arc, first, last, spread**0.5 * angle, ball_radius)
    if instants:
        passage = find_passage(arc, rays, start, stop, spread, ball_radius, is_all=True)[0]
        alpha, J_arc, J_spread = slow_opacity(arc, rays, start, stop, spread, ball_radius, instants)
        return ArcOpacity(passage=passage, alpha=alpha, J_arc=J_arc, J_spread=J_spread)
    near, seen, start, stop = find_passage(arc, rays, start, stop, spread, ball_radius)
    view = _View.of(arc, seen, near, ball_radius)
    variance = spread + seen.blur
    over = view.spread(variance)
    crossing = Crossing(
        instant=view.t,
        room=near.room,
        bend=variance * view.bend / over.q,
        A=view.A,
        lean=view.lean,
        swell=view.swell,
        start=start,
        stop=stop,
    )
    alpha, by = mean_opacity(crossing, over)
    J_spread = (
        by.q_spread * over.q / (2 * variance)
        + (by.t_spread * over.t + by.joint * over.joint) / variance
        + by.bend * view.bend
    )
    J_arc = _J_arc(arc, seen, view, over, by, variance)
    return ArcOpacity(passage=near, alpha=alpha, J_arc=J_arc, J_spread=J_spread)


@dataclass(frozen=True, slots=True, kw_only=True)
class _View:
    """The arc as each ray sees it at the instant of closest approach, [M] each."""

    t: Tensor  # that instant
    A: Tensor
    s: Tensor  # C.u
    s1: Tensor  # C'.u
    s2: Tensor  # C''.u
    right: Tensor  # the same product of C with the change of u to the right
    right1: Tensor  # of C'
    down: Tensor  # and with that downwards
    down1: Tensor
    skewness: Tensor  # a sixth of f's third derivative
    curl: Tensor  # a sixth of its fourth
    bend: Tensor  # by which q falls on both sides, m^2 per px^2
    lean: Tensor  # by how much the middle of the crossing shifts with h^2
    swell: Tensor  # by how much its half length grows with h^2, relatively
    q_right: Tensor  # change of q from pixel to pixel, to the right
    q_down: Tensor  # and downwards
    t_right: Tensor  # the same of t_m
    t_down: Tensor

    @classmethod
    def of(cls, arc: Tensor, seen: Rays, near: Passage, ball_radius: float) -> "_View":
        """Multiply out the products."""
        t, A = near.instant, near.stiffness
        s, s1, s2 = _along(arc @ seen.unit, t)
        right, right1, _ = _along(arc @ seen.right, t)
        down, down1, _ = _along(arc @ seen.down, t)
        bent = 4 * float(arc[2] @ arc[2])
        skewness = 2 * float(arc[1] @ arc[2]) + bent * t - s1 * s2
        curl = bent - s2 * s2
        distance = ball_radius**2 - near.room + s * s  # |C|^2
        return cls(
            t=t,
            A=A,
            s=s,
            s1=s1,
            s2=s2,
            right=right,
            right1=right1,
            down=down,
            down1=down1,
            skewness=skewness,
            curl=curl,
            bend=distance * float((seen.right**2 + seen.down**2).sum(0).mean()) / 2,
            lean=-skewness / (2 * A),
            swell=5 * skewness**2 / (8 * A**2) - curl / (8 * A),
            q_right=2 * s * right,
            q_down=2 * s * down,
            t_right=(right * s1 + s * right1) / A,
            t_down=(down * s1 + s * down1) / A,
        )

    def spread(self, variance: Tensor) -> Spread:
        """Say how lens and pixel spread q and t_m, and, for a ball that comes or goes, A."""
        fan_right, fan_down = -self.s1 * self.right1 / self.A, -self.s1 * self.down1 / self.A
        q = variance * (self.q_right**2 + self.q_down**2) + 2 * (variance * self.bend) ** 2
        return Spread(
            q=q.sqrt(),
            t=variance * (self.t_right**2 + self.t_down**2),
            joint=variance * (self.q_right * self.t_right + self.q_down * self.t_down),
            fan=variance * (fan_right**2 + fan_down**2),
            t_fan=variance * (self.t_right * fan_right + self.t_down * fan_down),
            q_fan=variance * (self.q_right * fan_right + self.q_down * fan_down),
        )


def _J_arc(
    arc: Tensor, seen: Rays, view: _View, over: Spread, by: Slopes, spread: Tensor
) -> Tensor:
    """Carry the slopes to the arc's coefficients [9, M].

    The spreads change with the arc as the slopes of q and t_m do, and so does how the crossing
    leans and swells, for an arc that is bent or might be.
    """
    t, A, s, s1, s2 = view.t, view.A, view.s, view.s1, view.s2
    right, right1, down, down1 = view.right, view.right1, view.down, view.down1
    by_q_spread = by.q_spread * spread / over.q
    by_q_right = by_q_spread * view.q_right + spread * by.joint * view.t_right
    by_q_down = by_q_spread * view.q_down + spread * by.joint * view.t_down
    by_t_right = spread * (2 * by.t_spread * view.t_right + by.joint * view.q_right) / A
    by_t_down = spread * (2 * by.t_spread * view.t_down + by.joint * view.q_down) / A
    by_skewness = (1.25 * by.swell * view.skewness / A - by.lean / 2) / A
    by_curl = -by.swell / (8 * A)
    by_A = by.A - by_t_right * view.t_right - by_t_down * view.t_down
    by_A = by_A - (by.lean * view.lean + by.swell * (2 * view.swell + view.curl / (8 * A))) / A
    by_t = by.t + 3 * by_A * view.skewness + by_skewness * view.curl
    by_t = by_t + 2 * (by_q_right * (s1 * right + s * right1) + by_q_down * (s1 * down + s * down1))
    by_t = (by_t + 2 * s1 * (by_t_right * right1 + by_t_down * down1)) / A

    # each derivative in C, C' and C'' is a sum of these vectors, of u, and of its changes
    sideways = by_t_right * right + by_t_down * down
    u_share = (
        2 * by.q * s
        + by_t * s1
        - by_A * s2
        + 2 * (by_q_right * right + by_q_down * down)
        + by_t_right * right1
        + by_t_down * down1
    )
    bend_across = 2 * arc[2][:, None] - s2 * seen.unit
    by_C = u_share * seen.unit
    by_C += (2 * s * by_q_right + s1 * by_t_right) * seen.right
    by_C += (2 * s * by_q_down + s1 * by_t_down) * seen.down
    by_C += arc.mT @ _powers(-2 * by.q, -by_t, by_A, t)
    by_C1 = (by_t * s - 2 * by_A * s1 + sideways) * seen.unit
    by_C1 += s * (by_t_right * seen.right + by_t_down * seen.down)
    by_C1 += arc.mT @ _powers(-by_t, 2 * by_A, None, t)
    by_C1 += by_skewness * bend_across
    by_C2 = arc.mT @ _powers(by_A, by_skewness, None, t)
    by_C2 -= (by_A * s + by_skewness * s1) * seen.unit
    by_C2 += 2 * by_curl * bend_across
    once = t * by_C + by_C1
    return torch.cat([by_C, once, t * (once + by_C1) + 2 * by_C2])


def _along(products: Tensor, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give C.x, C'.x and C''.x at time t from c0.x, c1.x and c2.x [3, M]."""
    p0, p1, p2 = products
    return p0 + t * (p1 + t * p2), p1 + 2 * t * p2, 2 * p2


def _powers(C: Tensor, C1: Tensor | None, C2: Tensor | None, t: Tensor) -> Tensor:
    """Turn shares of the vectors C, C', C'' [M] into shares of c0, c1, c2 [3, M]."""
    second, third = t * C, t * t * C
    if C1 is not None:
        second, third = second + C1, third + 2 * t * C1
    if C2 is not None:
        third = third + 2 * C2
    return torch.stack([C, second, third])
