"""The mean opacity of a crossing whose instant and depth lens and pixel spread.

A ray is covered from t_m - h to t_m + h, h = sqrt(q / A), as far as that lies in the exposure.
Lens and pixel spread q about its mean, across the contour, and t_m, along the motion; so the mean
of the opacity is that of a difference of two ramps. Away from corners it has a closed form: h is
replaced by its mean, and its variance widens the ramps. Where a contour meets the ball's first or
last image a short quadrature takes its place. [derived]
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from toolkit.sweep.passage import REACH
from toolkit.sweep.quadrature import gauss_legendre
from toolkit.sweep.soft import density, soft_ramp, soft_root

RIM = 8.0
"""Spreads inside the contour up to which h is spread so unevenly that corners need quadrature."""
NODES, STILL_NODES = 14, 40
"""Of that quadrature; more for a ball that moves little, whose image has steps instead of ramps."""
STILL = 0.04
"""Spread over travel from which it moves little."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """How lens and pixel spread q and t_m over each ray."""

    q: Tensor  # standard deviation [M]
    t: Tensor  # variance [M]
    joint: Tensor  # covariance of the two [M]
    fan: Tensor  # variance of half the logarithm of A [M]
    t_fan: Tensor  # covariance of that with t_m [M]
    q_fan: Tensor  # and with q [M]

    def __getitem__(self, index: Tensor | tuple[slice, None]) -> "Spread":
        return Spread(**{field.name: getattr(self, field.name)[index] for field in fields(self)})

    def of_end(self, h: Tensor, sign: float) -> tuple[Tensor, Tensor]:
        """Give the variance of t_m +- h at one q, and its covariance with q, where A spreads."""
        return (
            self.t - 2 * sign * h * self.t_fan + h * h * self.fan,
            self.joint - sign * h * self.q_fan,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """The crossing of each ray: covered from instant + lean h^2 -+ h (1 + swell h^2)."""

    instant: Tensor
    room: Tensor  # q itself
    bend: Tensor  # share of the spread's square by which q falls on both sides
    A: Tensor
    lean: Tensor
    swell: Tensor
    start: Tensor
    stop: Tensor

    def __getitem__(self, index: Tensor) -> "Crossing":
        return Crossing(**{field.name: getattr(self, field.name)[index] for field in fields(self)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Slopes:
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

    def put(self, index: Tensor, part: "Slopes") -> None:
        """Put others in some places."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(part, field.name)


def mean_opacity(crossing: Crossing, over: Spread) -> tuple[Tensor, Slopes]:
    """Give the opacity of each ray [M], and how it changes with what it is made of."""
    alpha, by = _smooth_opacity(crossing, over)
    corner = _corners(crossing, over)
    if len(corner):
        alpha[corner], by_corner = _corner_opacity(crossing[corner], over[corner])
        by.put(corner, by_corner)
    return alpha, by


def _smooth_opacity(crossing: Crossing, over: Spread) -> tuple[Tensor, Slopes]:
    """Give the opacity with h replaced by its mean, its variance widening the ramps."""
    A, root_A = crossing.A, crossing.A.sqrt()
    x = crossing.room / over.q
    root, slope, bend, turn = soft_root(x)
    ramp, share, dense = soft_ramp(x - crossing.bend)
    root_q = over.q.sqrt()
    mean = root_q * (root - crossing.bend * bend) / root_A
    mean_by_q = (slope - crossing.bend * turn) / (root_q * root_A)
    mean_by_spread = root / 2 - x * slope + crossing.bend * (bend / 2 + x * turn)
    mean_by_spread = mean_by_spread / (root_q * root_A)
    square = over.q * ramp / A
    h = mean * (1 + crossing.swell * square)
    middle = crossing.instant + crossing.lean * square

    alpha, by_h, zero = 2 * h, torch.full_like(h, 2.0), torch.zeros_like(h)
    by_t, by_variance, by_pull = zero.clone(), zero.clone(), zero.clone()
    reach = h + 6 * (over.t.sqrt() + h * over.fan.sqrt() + square.sqrt())
    cut = ((middle - reach < crossing.start) | (middle + reach > crossing.stop)).nonzero()[:, 0]
    scatter, pull = square - mean**2, over.joint * mean_by_q
    if len(cut):
        ends, noise = over[cut], scatter[cut].clamp_min(0)
        total, rise, fall, widening, leaning = torch.zeros(5, len(cut)).to(h).unbind()
        for sign in (1.0, -1.0):
            variance, joint = ends.of_end(mean[cut], sign)
            variance = variance + noise + 2 * sign * joint * mean_by_q[cut]
            width = variance.clamp_min(1e-24).sqrt()
            length, passed, by_width = _ramps(
                middle[cut] + sign * h[cut], width, crossing.start[cut], crossing.stop[cut]
            )
            total = total + sign * length
            rise = rise + sign * passed
            fall = fall + passed
            widening = widening + sign * by_width / (2 * width)
            leaning = leaning + by_width / width
        alpha[cut], by_t[cut], by_h[cut] = total, rise, fall
        by_variance[cut], by_pull[cut] = widening, leaning
    swollen, leant = by_h * mean * crossing.swell, by_t * crossing.lean
    by_mean = by_h * (1 + crossing.swell * square)
    return alpha, Slopes(
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


def _corners(crossing: Crossing, over: Spread) -> Tensor:
    """Find the rays near a contour and near an end of the exposure: indices [K]."""
    x = crossing.room / over.q
    longest = ((crossing.room + REACH * over.q).clamp_min(0) / crossing.A).sqrt()
    longest = longest + 5 * (over.t.sqrt() + longest * over.fan.sqrt())
    low, high = crossing.instant - longest, crossing.instant + longest
    is_cut = (low < crossing.start) & (high > crossing.start) | (low < crossing.stop) & (
        high > crossing.stop
    )
    return (is_cut & (x < RIM) & (x > -REACH)).nonzero()[:, 0]


def _corner_opacity(crossing: Crossing, over: Spread) -> tuple[Tensor, Slopes]:
    """Do the same by quadrature over h, exact for linear q and t_m."""
    across = float((over.t.mean() / ((crossing.stop - crossing.start) ** 2).mean()).sqrt())
    nodes, weights = gauss_legendre(NODES if across < STILL else STILL_NODES)
    root_A = crossing.A.sqrt()
    shortest = (crossing.room - 5 * over.q).clamp_min(0).sqrt() / root_A
    longest = (crossing.room + 5 * over.q).clamp_min(0).sqrt() / root_A
    h = shortest[:, None] + (longest - shortest)[:, None] * nodes
    # q + q_spread (z - bend z^2) = A h^2, solved for z
    z = (crossing.A[:, None] * h * h - crossing.room[:, None]) / over.q[:, None]
    bent = crossing.bend[:, None] * z
    stretch = 1 + bent * (2 + 6 * bent)
    z = z * (1 + bent * (1 + 2 * bent))
    weight = density(z) * stretch * 2 * h
    weight = weight * ((longest - shortest) * crossing.A / over.q)[:, None] * weights
    start, stop = crossing.start[:, None], crossing.stop[:, None]
    spread, half = over[:, None], h * (1 + crossing.swell[:, None] * h * h)
    ends = []
    for sign in (1.0, -1.0):
        variance, joint = spread.of_end(h, sign)
        pull = joint / spread.q
        width = (variance - pull**2).clamp_min(1e-24).sqrt()
        middle = crossing.instant[:, None] + pull * z + crossing.lean[:, None] * h * h
        ends.append((*_ramps(middle + sign * half, width, start, stop), width))
    (late, late_share, late_widening, late_width), (early, early_share, early_widening, width) = (
        ends
    )
    pull = over.joint / over.q
    risen, both = weight * (late_share - early_share), weight * (late_share + early_share)
    by_h = both * (1 + 3 * crossing.swell[:, None] * h * h) + risen * 2 * crossing.lean[:, None] * h
    by_room = by_h / (2 * crossing.A[:, None] * h.clamp_min(1e-300))
    by_variance = (weight * (late_widening / late_width - early_widening / width)).sum(-1) / 2
    by_pull = (risen * z).sum(-1) - 2 * by_variance * pull
    return (weight * (late - early)).sum(-1), Slopes(
        t=risen.sum(-1),
        q=by_room.sum(-1),
        A=-(by_h * h).sum(-1) / (2 * crossing.A),
        q_spread=(by_room * z).sum(-1) - by_pull * pull / over.q,
        t_spread=by_variance,
        joint=by_pull / over.q,
        bend=-(by_room * z * z).sum(-1),
        lean=(risen * h * h).sum(-1),
        swell=(both * h * h * h).sum(-1),
    )
