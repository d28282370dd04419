"""The exact opacity of a sphere that moves along an arc, seen through lens and pixels.

A ray u is covered while f(t) = |C(t) x u|^2 < R^2. On an arc C(t) = c0 + c1 t + c2 t^2 this is a
quartic; about its minimum t_m it is covered for t_m -+ h, h = sqrt(q / A), with q = R^2 - f(t_m)
and A = f''/2, and the opacity is the part of that within the exposure (MATHS, "The exact streak of
a moving ball"; for an unaccelerated arc the closed form there).

Lens and pixel spread a point by a variance s^2 (the pixel's area counts for 1/12 px^2). Across the
contour q is then normally spread about its mean, along the motion t_m is; so the mean of the
opacity is that of a difference of two ramps. Away from corners it has a closed form: h is replaced
by its mean, and its variance widens the ramps. Where a contour meets the ball's first or last image
a short quadrature takes its place. [derived]
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from toolkit.sweep.slow import count_instants, slow_opacity
from toolkit.sweep.soft import density, soft_ramp, soft_root

PIXEL_VARIANCE = 1 / 12
"""px^2, of a place within a pixel, along each side."""
REACH = 6.0
"""Standard deviations of the spread beyond the contour up to which a pixel sees the ball."""
RIM = 8.0
"""The same inside the contour, up to which h is spread so unevenly that corners need quadrature."""
NODES, STILL_NODES = 14, 40
"""Of that quadrature; more for a ball that moves little, whose image has steps instead of ramps."""
STILL = 0.04
"""Spread over travel from which it moves little."""
GUESSES = 9
"""Instants from which the one of closest approach is searched on a bent arc."""
NEWTON_STEPS = 4
SLACKEST = 1e-6
"""Share of the squared speed below which the motion does not go across a ray at all."""
MOSTLY = 0.6
"""Share of the rays from which an arc is followed for all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """Where N pixels look."""

    unit: Tensor  # [3, N]
    right: Tensor  # [3, N] change of the ray for one px to the right
    down: Tensor  # [3, N] the same downwards

    def __getitem__(self, index: Tensor) -> "Rays":
        """Give those with some indices."""
        return Rays(unit=self.unit[:, index], right=self.right[:, index], down=self.down[:, index])


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """How the ball passes M of N rays, without any spread."""

    index: Tensor  # [M] of the rays that it covers or nearly does
    instant: Tensor  # [M] of closest approach, exposures
    room: Tensor  # [M] q: R^2 less the squared distance of the centre from the ray, m^2
    stiffness: Tensor  # [M] A, m^2 per squared exposure
    side: Tensor  # [M] 1 where the ray passes to the right of the ball's motion, else -1


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

    With s = C.u the squared distance of the centre from a ray is f = |C|^2 - s^2, so that all that
    changes from ray to ray is told by the products of u, and of its change from pixel to pixel,
    with the arc's coefficients.

    Args:
        arc: c0, c1, c2 [3, 3]: m, m per exposure, m per exposure^2.
        rays: N of them.
        start: when each ray's part of the arc begins, exposures [N].
        stop: when it ends [N].
        spread: variance of lens and pixel together, px^2.
        ball_radius: m.
    """
    angle = float(torch.linalg.vector_norm(rays.right[:, 0]))
    first, last = float(start.min()), float(stop.max())
    instants = count_instants(arc, first, last, spread**0.5 * angle, ball_radius)
    if instants:
        passage = _near(arc, rays, start, stop, spread, ball_radius, is_all=True)[0]
        axes = (rays.unit, rays.right, rays.down)
        alpha, J_arc, J_spread = slow_opacity(arc, axes, start, stop, spread, ball_radius, instants)
        return ArcOpacity(passage=passage, alpha=alpha, J_arc=J_arc, J_spread=J_spread)
    near, seen, start, stop = _near(arc, rays, start, stop, spread, ball_radius)
    t, A = near.instant, near.stiffness
    s, s1, s2 = _along(arc @ seen.unit, t)
    right, right1, _ = _along(arc @ seen.right, t)
    down, down1, _ = _along(arc @ seen.down, t)
    skewness = _poly(arc[1] @ arc[2] * 2, 4 * arc[2] @ arc[2], t) - s1 * s2
    curl = 4 * float(arc[2] @ arc[2]) - s2 * s2

    # how q and t_m change from pixel to pixel
    q_right, q_down = 2 * s * right, 2 * s * down
    t_right, t_down = (right * s1 + s * right1) / A, (down * s1 + s * down1) / A
    # ... and, for a ball that comes or goes, how the length of the crossing does: h ~ 1 / sqrt(A)
    fan_right, fan_down = -s1 * right1 / A, -s1 * down1 / A
    distance = ball_radius**2 - near.room + s * s  # |C|^2
    bend = distance * float((seen.right**2 + seen.down**2).sum(0).mean()) / 2
    over = _Spread(
        q=(spread * (q_right**2 + q_down**2) + 2 * (spread * bend) ** 2).sqrt(),
        t=spread * (t_right**2 + t_down**2),
        joint=spread * (q_right * t_right + q_down * t_down),
        fan=spread * (fan_right**2 + fan_down**2),
        t_fan=spread * (t_right * fan_right + t_down * fan_down),
        q_fan=spread * (q_right * fan_right + q_down * fan_down),
    )
    form = _Form(
        instant=t,
        room=near.room,
        bend=spread * bend / over.q,
        A=A,
        lean=-skewness / (2 * A),
        swell=5 * skewness**2 / (8 * A**2) - curl / (8 * A),
        start=start,
        stop=stop,
    )
    alpha, by = _smooth_opacity(form, over)
    corner = _corners(form, over)
    if len(corner):
        alpha[corner], by_corner = _corner_opacity(form[corner], over[corner])
        by.put(corner, by_corner)
    by_q_spread = by.q_spread * spread / over.q
    J_spread = (
        by_q_spread * (over.q**2 / (2 * spread**2))
        + (by.t_spread * over.t + by.joint * over.joint) / spread
        + by.bend * bend
    )

    # the slopes of q and t_m, and with them the spreads, change with the arc too
    by_q_right = by_q_spread * q_right + spread * by.joint * t_right
    by_q_down = by_q_spread * q_down + spread * by.joint * t_down
    by_t_right = spread * (2 * by.t_spread * t_right + by.joint * q_right) / A
    by_t_down = spread * (2 * by.t_spread * t_down + by.joint * q_down) / A
    # ... and so does how the crossing leans and swells, for an arc that is bent or might be
    by_skewness = (1.25 * by.swell * skewness / A - by.lean / 2) / A
    by_curl = -by.swell / (8 * A)
    by_A = by.A - by_t_right * t_right - by_t_down * t_down
    by_A = by_A - (by.lean * form.lean + by.swell * (2 * form.swell + curl / (8 * A))) / A
    by_t = by.t + 3 * by_A * skewness + by_skewness * curl
    by_t = by_t + 2 * (by_q_right * (s1 * right + s * right1) + by_q_down * (s1 * down + s * down1))
    by_t = (by_t + 2 * s1 * (by_t_right * right1 + by_t_down * down1)) / A
    # ... each derivative in C, C' and C'' is a sum of these vectors, of u, and of its changes
    sideways = by_t_right * right + by_t_down * down
    u_share = (
        2 * by.q * s
        + by_t * s1
        - by_A * s2
        + 2 * (by_q_right * right + by_q_down * down)
        + by_t_right * right1
        + by_t_down * down1
    )
    by_C = u_share * seen.unit
    by_C += (2 * s * by_q_right + s1 * by_t_right) * seen.right
    by_C += (2 * s * by_q_down + s1 * by_t_down) * seen.down
    by_C += arc.mT @ _powers(-2 * by.q, -by_t, by_A, t)
    by_C1 = (by_t * s - 2 * by_A * s1 + sideways) * seen.unit
    by_C1 += s * (by_t_right * seen.right + by_t_down * seen.down)
    by_C1 += arc.mT @ _powers(-by_t, 2 * by_A, None, t)
    J0 = by_C
    J1 = t * by_C + by_C1
    if bool((arc[2] == 0).all()):
        by_C2 = by_A * (arc[0][:, None] + t * arc[1][:, None] - s * seen.unit)
    else:
        by_C2 = arc.mT @ _powers(by_A, None, None, t) - (by_A * s) * seen.unit
        by_C2 += 2 * by_skewness * t * arc[2][:, None]
        bend_across = 2 * arc[2][:, None] - s2 * seen.unit
        by_C1 += by_skewness * bend_across
        by_C2 += 2 * by_curl * bend_across
        J1 = J1 + by_skewness * bend_across
    by_C2 += by_skewness * (arc[1][:, None] - s1 * seen.unit)
    J2 = t * (J1 + by_C1) + 2 * by_C2
    return ArcOpacity(passage=near, alpha=alpha, J_arc=torch.cat([J0, J1, J2]), J_spread=J_spread)


def _along(products: Tensor, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give C.x, C'.x and C''.x at time t from c0.x, c1.x and c2.x [3, M]."""
    p0, p1, p2 = products
    return p0 + t * (p1 + t * p2), p1 + 2 * t * p2, 2 * p2


def _poly(first: Tensor, second: Tensor, t: Tensor) -> Tensor:
    return first + second * t


def _powers(C: Tensor, C1: Tensor | None, C2: Tensor | None, t: Tensor) -> Tensor:
    """Turn shares of the vectors C, C', C'' [M] into shares of c0, c1, c2 [3, M]."""
    second, third = t * C, t * t * C
    if C1 is not None:
        second, third = second + C1, third + 2 * t * C1
    if C2 is not None:
        third = third + 2 * C2
    return torch.stack([C, second, third])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spread:
    """How lens and pixel spread q and t_m over each ray."""

    q: Tensor  # standard deviation [M]
    t: Tensor  # variance [M]
    joint: Tensor  # covariance of the two [M]
    fan: Tensor  # variance of half the logarithm of A [M]
    t_fan: Tensor  # covariance of that with t_m [M]
    q_fan: Tensor  # and with q [M]

    def __getitem__(self, index: Tensor | tuple[slice, None]) -> "_Spread":
        names = ("q", "t", "joint", "fan", "t_fan", "q_fan")
        return _Spread(**{name: getattr(self, name)[index] for name in names})

    def of_end(self, h: Tensor, sign: float) -> tuple[Tensor, Tensor]:
        """Give the variance of t_m +- h at one q, and its covariance with q, where A spreads."""
        return (
            self.t - 2 * sign * h * self.t_fan + h * h * self.fan,
            self.joint - sign * h * self.q_fan,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Form:
    """The crossing of each ray: covered from instant + lean h^2 -+ h (1 + swell h^2)."""

    instant: Tensor
    room: Tensor  # q itself
    bend: Tensor  # share of the spread's square by which q falls on both sides
    A: Tensor
    lean: Tensor
    swell: Tensor
    start: Tensor
    stop: Tensor

    def __getitem__(self, index: Tensor) -> "_Form":
        return _Form(
            instant=self.instant[index],
            room=self.room[index],
            bend=self.bend[index],
            A=self.A[index],
            lean=self.lean[index],
            swell=self.swell[index],
            start=self.start[index],
            stop=self.stop[index],
        )


def _near(
    arc: Tensor,
    rays: Rays,
    start: Tensor,
    stop: Tensor,
    spread: float,
    ball_radius: float,
    *,
    is_all: bool = False,
) -> tuple[Passage, Rays, Tensor, Tensor]:
    """Find when the ball's centre is nearest to each ray, and keep the rays that it may cover."""
    a0, a1, a2 = arc @ rays.unit
    c = arc @ arc.mT
    if bool((arc[2] == 0).all()):
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
    blur = REACH * spread**0.5 * float(torch.linalg.vector_norm(rays.right[:, 0]))
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
    if bool((arc[2] != 0).any()):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slopes:
    """How the opacity of each ray changes with what it is made of, [M] each."""

    t: Tensor  # t_m
    q: Tensor  # mean of q
    A: Tensor
    q_spread: Tensor  # standard deviation of q
    t_spread: Tensor  # variance of t_m
    joint: Tensor  # covariance of the two
    bend: Tensor  # what q falls by on both sides, m^2
    lean: Tensor
    swell: Tensor

    def put(self, index: Tensor, part: "_Slopes") -> None:
        """Put others in some places."""
        for name in ("t", "q", "A", "q_spread", "t_spread", "joint", "bend", "lean", "swell"):
            getattr(self, name)[index] = getattr(part, name)


def _smooth_opacity(form: _Form, over: _Spread) -> tuple[Tensor, _Slopes]:
    """Give the opacity with h replaced by its mean, its variance widening the ramps."""
    A, root_A = form.A, form.A.sqrt()
    x = form.room / over.q
    root, slope, bend, turn = soft_root(x)
    ramp, share, dense = soft_ramp(x - form.bend)
    root_q = over.q.sqrt()
    mean = root_q * (root - form.bend * bend) / root_A
    mean_by_q = (slope - form.bend * turn) / (root_q * root_A)
    mean_by_spread = root / 2 - x * slope + form.bend * (bend / 2 + x * turn)
    mean_by_spread = mean_by_spread / (root_q * root_A)
    square = over.q * ramp / A
    h = mean * (1 + form.swell * square)
    middle = form.instant + form.lean * square

    alpha, by_h, zero = 2 * h, torch.full_like(h, 2.0), torch.zeros_like(h)
    by_t, by_variance, by_pull = zero.clone(), zero.clone(), zero.clone()
    reach = h + 6 * (over.t.sqrt() + h * over.fan.sqrt() + square.sqrt())
    cut = ((middle - reach < form.start) | (middle + reach > form.stop)).nonzero()[:, 0]
    scatter, pull = square - mean**2, over.joint * mean_by_q
    if len(cut):
        ends, noise = over[cut], scatter[cut].clamp_min(0)
        total, rise, fall, widening, leaning = torch.zeros(5, len(cut)).to(h).unbind()
        for sign in (1.0, -1.0):
            variance, joint = ends.of_end(mean[cut], sign)
            variance = variance + noise + 2 * sign * joint * mean_by_q[cut]
            width = variance.clamp_min(1e-24).sqrt()
            length, passed, by_width = _ramps(
                middle[cut] + sign * h[cut], width, form.start[cut], form.stop[cut]
            )
            total = total + sign * length
            rise = rise + sign * passed
            fall = fall + passed
            widening = widening + sign * by_width / (2 * width)
            leaning = leaning + by_width / width
        alpha[cut], by_t[cut], by_h[cut] = total, rise, fall
        by_variance[cut], by_pull[cut] = widening, leaning
    swollen, leant = by_h * mean * form.swell, by_t * form.lean
    by_mean = by_h * (1 + form.swell * square)
    return alpha, _Slopes(
        t=by_t,
        q=by_mean * mean_by_q
        + by_variance * (share / A - 2 * mean * mean_by_q)
        + (swollen + leant) * (share / A),
        A=-(by_mean * mean / 2 + by_variance * scatter + by_pull * pull / 2) / A
        - (swollen + leant) * (square / A),
        q_spread=by_h * mean_by_spread + by_variance * (dense / A - 2 * mean * mean_by_spread),
        t_spread=by_variance,
        joint=by_pull * mean_by_q,
        bend=-by_h * bend / (root_q * root_A),
        lean=by_t * square,
        swell=by_h * mean * square,
    )


def _ramps(at: Tensor, width: Tensor, start: Tensor, stop: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Clip instants spread by `width` to the exposure: mean, and derivative in instant and width.

    The difference of two ramps is written such that it stays exact where the exposure is much
    shorter than the width, as for a ball that nearly stands still.
    """
    a, b = (at - start) / width, (at - stop) / width
    share_a, share_b = torch.special.ndtr(a), torch.special.ndtr(b)
    dense_a, dense_b = density(a), density(b)
    value = width * (a * share_a - b * share_b + dense_a - dense_b)
    return value, share_a - share_b, dense_a - dense_b


def _corners(form: _Form, over: _Spread) -> Tensor:
    """Find the rays near a contour and near an end of the exposure: indices [K]."""
    x = form.room / over.q
    longest = ((form.room + REACH * over.q).clamp_min(0) / form.A).sqrt()
    longest = longest + 5 * (over.t.sqrt() + longest * over.fan.sqrt())
    low, high = form.instant - longest, form.instant + longest
    is_cut = (low < form.start) & (high > form.start) | (low < form.stop) & (high > form.stop)
    return (is_cut & (x < RIM) & (x > -REACH)).nonzero()[:, 0]


def _corner_opacity(form: _Form, over: _Spread) -> tuple[Tensor, _Slopes]:
    """Do the same by quadrature over h, exact for linear q and t_m."""
    across = float((over.t.mean() / ((form.stop - form.start) ** 2).mean()).sqrt())
    nodes, weights = _gauss_legendre(NODES if across < STILL else STILL_NODES)
    root_A = form.A.sqrt()
    shortest = (form.room - 5 * over.q).clamp_min(0).sqrt() / root_A
    longest = (form.room + 5 * over.q).clamp_min(0).sqrt() / root_A
    h = shortest[:, None] + (longest - shortest)[:, None] * nodes
    # q + q_spread (z - bend z^2) = A h^2, solved for z
    z = (form.A[:, None] * h * h - form.room[:, None]) / over.q[:, None]
    bent = form.bend[:, None] * z
    stretch = 1 + bent * (2 + 6 * bent)
    z = z * (1 + bent * (1 + 2 * bent))
    weight = density(z) * stretch * 2 * h
    weight = weight * ((longest - shortest) * form.A / over.q)[:, None] * weights
    start, stop = form.start[:, None], form.stop[:, None]
    spread, half = over[:, None], h * (1 + form.swell[:, None] * h * h)
    ends = []
    for sign in (1.0, -1.0):
        variance, joint = spread.of_end(h, sign)
        pull = joint / spread.q
        width = (variance - pull**2).clamp_min(1e-24).sqrt()
        middle = form.instant[:, None] + pull * z + form.lean[:, None] * h * h
        ends.append((*_ramps(middle + sign * half, width, start, stop), width))
    (late, late_share, late_widening, late_width), (early, early_share, early_widening, width) = (
        ends
    )
    pull = over.joint / over.q
    risen, both = weight * (late_share - early_share), weight * (late_share + early_share)
    by_h = both * (1 + 3 * form.swell[:, None] * h * h) + risen * 2 * form.lean[:, None] * h
    by_room = by_h / (2 * form.A[:, None] * h.clamp_min(1e-300))
    by_variance = (weight * (late_widening / late_width - early_widening / width)).sum(-1) / 2
    by_pull = (risen * z).sum(-1) - 2 * by_variance * pull
    return (weight * (late - early)).sum(-1), _Slopes(
        t=risen.sum(-1),
        q=by_room.sum(-1),
        A=-(by_h * h).sum(-1) / (2 * form.A),
        q_spread=(by_room * z).sum(-1) - by_pull * pull / over.q,
        t_spread=by_variance,
        joint=by_pull / over.q,
        bend=-(by_room * z * z).sum(-1),
        lean=(risen * h * h).sum(-1),
        swell=(both * h * h * h).sum(-1),
    )


@cache
def _gauss_legendre(count: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights on 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return torch.from_numpy((nodes + 1) / 2), torch.from_numpy(weights / 2)
