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

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from toolkit.sweep.soft import density, soft_ramp, soft_root

PIXEL_VARIANCE = 1 / 12
"""px^2, of a place within a pixel, along each side."""
REACH = 6.0
"""Standard deviations of the spread beyond the contour up to which a pixel sees the ball."""
RIM = 8.0
"""The same inside the contour, up to which h is spread so unevenly that corners need quadrature."""
NODES = 14
"""Of that quadrature."""
GUESSES = 9
"""Instants from which the one of closest approach is searched on a bent arc."""
NEWTON_STEPS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """Where N pixels look."""

    unit: Tensor  # [N, 3]
    right: Tensor  # [N, 3] change of the ray for one px to the right
    down: Tensor  # [N, 3] the same downwards

    def __getitem__(self, index: Tensor) -> "Rays":
        """Give those with some indices."""
        return Rays(unit=self.unit[index], right=self.right[index], down=self.down[index])


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
    J_arc: Tensor  # [M, 9] in c0, c1, c2
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
        spread: variance of lens and pixel together, px^2.
        ball_radius: m.
    """
    near = _near(arc, rays, start, stop, spread, ball_radius)
    seen, start, stop = rays[near.index], start[near.index], stop[near.index]
    t, u = near.instant, seen.unit
    slope = arc[1] + 2 * t[:, None] * arc[2]
    centre = arc[0] + t[:, None] * (arc[1] + t[:, None] * arc[2])
    g, g1 = _cross(centre, u), _cross(slope, u)
    g2 = _cross(2 * arc[2].expand_as(u), u)
    skewness = _dot(g1, g2)
    A, q = near.stiffness, near.room

    # how q and t_m change from pixel to pixel
    turn_q = 2 * _cross(centre, g)
    turn_t = (_cross(centre, g1) + _cross(slope, g)) / A[:, None]
    q_right, q_down = _dot(turn_q, seen.right), _dot(turn_q, seen.down)
    t_right, t_down = _dot(turn_t, seen.right), _dot(turn_t, seen.down)
    bend = _dot(centre, centre) * (_dot(seen.right, seen.right) + _dot(seen.down, seen.down)) / 2
    over = _Spread(
        q=(spread * (q_right**2 + q_down**2) + 2 * (spread * bend) ** 2).sqrt(),
        t=spread * (t_right**2 + t_down**2),
        joint=spread * (q_right * t_right + q_down * t_down),
    )
    form = _Form(
        instant=t,
        room=q - spread * bend,
        A=A,
        lean=-skewness / (2 * A),
        swell=5 * skewness**2 / (8 * A**2) - _dot(g2, g2) / (8 * A),
        start=start,
        stop=stop,
    )
    alpha, by = _smooth_opacity(form, over)
    corner = _corners(form, over)
    if len(corner):
        alpha[corner], by_corner = _corner_opacity(form[corner], over[corner])
        by = by.with_part(corner, by_corner)
    by_q_spread = by.q_spread * spread / over.q
    J_spread = (
        by_q_spread * (over.q**2 / (2 * spread**2))
        + (by.t_spread * over.t + by.joint * over.joint) / spread
        - by.q * bend
    )

    # the spreads change with the arc as the slopes of q and t_m do
    along_q = _mix(by_q_spread * q_right + spread * by.joint * t_right, seen.right) + _mix(
        by_q_spread * q_down + spread * by.joint * t_down, seen.down
    )
    along_t = spread * (
        _mix(2 * by.t_spread * t_right + by.joint * q_right, seen.right)
        + _mix(2 * by.t_spread * t_down + by.joint * q_down, seen.down)
    )
    by_A = by.A - _dot(along_t, turn_t) / A
    along_t = along_t / A[:, None]
    by_t = by.t + by_A * 3 * skewness + 2 * _dot(along_q, _cross(slope, g) + _cross(centre, g1))
    by_t = (by_t + 2 * _dot(along_t, _cross(slope, g1))) / A
    X0, X1, X2 = _cross(u, g), _cross(u, g1), _cross(u, g2)
    by_C = _mix(-2 * by.q, X0) - _mix(by_t, X1) + _mix(by_A, X2)
    by_C = by_C + 2 * (_cross(g, along_q) + _cross(u, _cross(along_q, centre)))
    by_C = by_C + _cross(g1, along_t) + _cross(u, _cross(along_t, slope))
    by_C1 = -_mix(by_t, X0) + _mix(2 * by_A, X1)
    by_C1 = by_C1 + _cross(g, along_t) + _cross(u, _cross(along_t, centre))
    by_C2 = _mix(by_A, X0)
    t = t[:, None]
    J_arc = torch.cat([by_C, t * by_C + by_C1, t * (t * by_C + 2 * by_C1) + 2 * by_C2], dim=-1)
    return ArcOpacity(passage=near, alpha=alpha, J_arc=J_arc, J_spread=J_spread)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spread:
    """How lens and pixel spread q and t_m over each ray."""

    q: Tensor  # standard deviation [M]
    t: Tensor  # variance [M]
    joint: Tensor  # covariance of the two [M]

    def __getitem__(self, index: Tensor) -> "_Spread":
        return _Spread(q=self.q[index], t=self.t[index], joint=self.joint[index])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Form:
    """The crossing of each ray: covered from instant + lean h^2 -+ h (1 + swell h^2)."""

    instant: Tensor
    room: Tensor  # mean of q over the spread
    A: Tensor
    lean: Tensor
    swell: Tensor
    start: Tensor
    stop: Tensor

    def __getitem__(self, index: Tensor) -> "_Form":
        return _Form(
            instant=self.instant[index],
            room=self.room[index],
            A=self.A[index],
            lean=self.lean[index],
            swell=self.swell[index],
            start=self.start[index],
            stop=self.stop[index],
        )


def _near(
    arc: Tensor, rays: Rays, start: Tensor, stop: Tensor, spread: float, ball_radius: float
) -> Passage:
    """Find when the ball's centre is nearest to each ray, and keep the rays that it may cover."""
    u = rays.unit
    across = torch.cat([_skew(c) for c in arc])  # c x u for the three at once
    m, w, b = (u @ across.mT).unflatten(-1, (3, 3)).unbind(-2)
    mw, ww = _dot(m, w), _dot(w, w)
    if bool((arc[2] == 0).all()):
        t, A = -mw / ww, ww
        f = _dot(m, m) - mw * mw / ww
    else:
        mm, mb, wb, bb = _dot(m, m), _dot(m, b), _dot(w, b), _dot(b, b)
        t = _nearest_instant((mm, 2 * mw, ww + 2 * mb, 2 * wb, bb), start, stop)
        f = mm + t * (2 * mw + t * (ww + 2 * mb + t * (2 * wb + t * bb)))
        A = ww + 2 * mb + t * (6 * wb + t * 6 * bb)
    # a px more or less of room, roughly: |dq / dpx| <= 2 R |C| |du|
    distance = torch.linalg.vector_norm(arc[0])
    step = distance * torch.linalg.vector_norm(rays.right, dim=-1)
    slack = REACH * spread**0.5 * step
    half = ((ball_radius + slack) ** 2 - f).clamp_min(0) / A
    # ends are ramps as wide as the spread; in time a px lasts step / |w|
    reach = half.sqrt() + slack / A.sqrt()
    is_near = (half > 0) & (t + reach > start) & (t - reach < stop) & (A > 0)
    index = is_near.nonzero()[:, 0]
    t = t[index]
    slope, centre = arc[1] + 2 * t[:, None] * arc[2], arc[0] + t[:, None] * arc[1]
    centre = centre + t[:, None] ** 2 * arc[2]
    side = _dot(u[index], _cross(centre, slope)).sign()
    return Passage(
        index=index, instant=t, room=ball_radius**2 - f[index], stiffness=A[index], side=side
    )


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

    def with_part(self, index: Tensor, part: "_Slopes") -> "_Slopes":
        """Put others in some places."""
        whole, new = (
            torch.stack([s.t, s.q, s.A, s.q_spread, s.t_spread, s.joint]) for s in (self, part)
        )
        t, q, A, q_spread, t_spread, joint = whole.index_copy(1, index, new).unbind()
        return _Slopes(t=t, q=q, A=A, q_spread=q_spread, t_spread=t_spread, joint=joint)


def _smooth_opacity(form: _Form, over: _Spread) -> tuple[Tensor, _Slopes]:
    """Give the opacity with h replaced by its mean, its variance widening the ramps."""
    A, root_A = form.A, form.A.sqrt()
    x = form.room / over.q
    root, slope = soft_root(x)
    ramp, share = soft_ramp(x)
    root_q = over.q.sqrt()
    mean = root_q * root / root_A
    mean_by_q = slope / (root_q * root_A)
    mean_by_spread = (root / 2 - x * slope) / (root_q * root_A)
    square = over.q * ramp / A
    h = mean * (1 + form.swell * square)
    middle = form.instant + form.lean * square

    alpha, by_h, zero = 2 * h, torch.full_like(h, 2.0), torch.zeros_like(h)
    by_t, by_variance, by_pull = zero.clone(), zero.clone(), zero.clone()
    reach = h + 6 * (over.t + square).sqrt()
    cut = ((middle - reach < form.start) | (middle + reach > form.stop)).nonzero()[:, 0]
    scatter, pull = square - mean**2, over.joint * mean_by_q
    if len(cut):
        both = over.t[cut] + scatter[cut].clamp_min(0)
        total, rise, fall, widening, leaning = 0.0, 0.0, 0.0, 0.0, 0.0
        for sign in (1.0, -1.0):
            width = (both + 2 * sign * pull[cut]).clamp_min(1e-24).sqrt()
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
    return alpha, _Slopes(
        t=by_t,
        q=by_h * mean_by_q + by_variance * (share / A - 2 * mean * mean_by_q),
        A=-(by_h * mean / 2 + by_variance * scatter + by_pull * pull / 2) / A,
        q_spread=by_h * mean_by_spread + by_variance * (density(x) / A - 2 * mean * mean_by_spread),
        t_spread=by_variance,
        joint=by_pull * mean_by_q,
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
    longest = ((form.room + REACH * over.q).clamp_min(0) / form.A).sqrt() + 5 * over.t.sqrt()
    low, high = form.instant - longest, form.instant + longest
    is_cut = (low < form.start) & (high > form.start) | (low < form.stop) & (high > form.stop)
    return (is_cut & (x < RIM) & (x > -REACH)).nonzero()[:, 0]


def _corner_opacity(form: _Form, over: _Spread) -> tuple[Tensor, _Slopes]:
    """Do the same by quadrature over h, exact for linear q and t_m."""
    nodes, weights = _gauss_legendre()
    root_A = form.A.sqrt()
    shortest = (form.room - 5 * over.q).clamp_min(0).sqrt() / root_A
    longest = (form.room + 5 * over.q).clamp_min(0).sqrt() / root_A
    h = shortest[:, None] + (longest - shortest)[:, None] * nodes
    z = (form.A[:, None] * h * h - form.room[:, None]) / over.q[:, None]
    weight = density(z) * 2 * h * ((longest - shortest) * form.A / over.q)[:, None] * weights
    pull = over.joint / over.q
    width = (over.t - pull**2).clamp_min(1e-24).sqrt()
    middle = form.instant[:, None] + pull[:, None] * z + form.lean[:, None] * h * h
    half = h * (1 + form.swell[:, None] * h * h)
    start, stop = form.start[:, None], form.stop[:, None]
    late, late_share, late_widening = _ramps(middle + half, width[:, None], start, stop)
    early, early_share, early_widening = _ramps(middle - half, width[:, None], start, stop)
    length, risen = weight * (late - early), weight * (late_share - early_share)
    by_pull = (risen * z).sum(-1)
    by_variance = (weight * (late_widening - early_widening)).sum(-1) / (2 * width)
    return length.sum(-1), _Slopes(
        t=risen.sum(-1),
        q=(length * z).sum(-1) / over.q,
        A=-(weight * (late_share + early_share) * h).sum(-1) / (2 * form.A),
        q_spread=((length * (z * z - 1)).sum(-1) - (by_pull - 2 * by_variance * pull) * pull)
        / over.q,
        t_spread=by_variance,
        joint=(by_pull - 2 * by_variance * pull) / over.q,
    )


@cache
def _gauss_legendre() -> tuple[Tensor, Tensor]:
    """Nodes and weights on 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return torch.from_numpy((nodes + 1) / 2), torch.from_numpy(weights / 2)


def _skew(c: Tensor) -> Tensor:
    """Give the matrix of c x [3, 3]."""
    x, y, z = c.unbind()
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return torch.linalg.cross(a, b)


def _mix(share: Tensor, vector: Tensor) -> Tensor:
    """Scale each vector [M, 3] by its share [M]."""
    return share[:, None] * vector


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)
