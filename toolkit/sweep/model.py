"""What every pixel shows while the ball passes, and the equations of the most likely motion.

A pixel shows g B + o + alpha (F - g B - o): the background B in a light that may have changed by a
gain g and an offset o in each channel, behind the ball F for the share alpha of the exposure. Only a
noisy picture G of the background is known. Of all backgrounds the likeliest given both pictures is
taken for each pixel, which makes the cost the squared residual over v_shot + (1 - alpha)^2 g^2
v_background; its exact gradient is that of B held there. [derived]
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.sweep.colours import (
    NARROW,
    BallColours,
    is_plain,
    plain_colours,
    seen_colours,
)
from toolkit.sweep.opacity import ArcOpacity, Passage, arc_opacity
from toolkit.sweep.paths import SweepPath
from toolkit.sweep.pixels import StreakPixels

HUBER = 3.5
"""Standard deviations beyond which a pixel's misfit counts linearly."""
GAIN_STD = 0.02
"""Prior standard deviation of the background's gain, about 1."""
OFFSET_STD = 0.005
"""The same of its offset, about 0, shares of white: both are known from beside the streak."""
THINNEST = 1e-6
"""Opacity below which a pixel does not see the ball."""


@dataclass(frozen=True, kw_only=True)
class SweepModel:
    """The streak of a ball on one kind of path.

    Parameters, in this order: the path's K, the spread's variance (px^2, of lens and pixel), the A
    unknowns of the appearance, a gain for each of Q channels, an offset for each.
    """

    path: SweepPath
    estimator: AlphaEstimator
    camera: Camera
    ball_radius: float
    row_delay: float = 0.0  # exposures from one row to the next
    middle_row: float = 0.0  # whose exposure runs from -1/2 to 1/2

    @property
    def unknowns(self) -> int:
        """Numbers of the appearance that are fitted, A."""
        return self.estimator.unknowns()

    @cached_property
    def is_plain(self) -> bool:
        """Whether the ball shows the same on every chord."""
        return is_plain(self.estimator)

    def split(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Give path, spread, appearance, gain and offset."""
        k, a = self.path.size, self.unknowns
        gain, offset = x[k + 1 + a :].chunk(2)
        return x[:k], x[k], x[k + 1 : k + 1 + a], gain, offset

    def exposure_of(self, pixels: StreakPixels) -> tuple[Tensor, Tensor]:
        """Say when each pixel was exposed, from and to [N], exposures."""
        delay = self.row_delay * (pixels.place[:, 1] - self.middle_row)
        return delay - 0.5, delay + 0.5

    def opacity(self, x: Tensor, pixels: StreakPixels) -> "Coverage":
        """Give the opacity of all pixels and its derivatives in the path and the spread."""
        shape, spread, _, _, _ = self.split(x)
        arcs = self.path.arcs(shape)
        start, stop = self.exposure_of(pixels)
        # the spread is that of single pixels; squares of them blur by their own area
        wide = float(spread) + pixels.area_variance - 1 / 12
        parts = [
            arc_opacity(arc, pixels.rays, low, high, wide, self.ball_radius)
            for arc, (low, high) in zip(arcs.coefficients, arcs.limits(start, stop), strict=True)
        ]
        if len(parts) == 1:
            part = parts[0]
            J = torch.cat([part.J_arc @ arcs.J[0], part.J_spread[:, None]], dim=-1)
            return Coverage(
                index=part.passage.index,
                alpha=part.alpha,
                J=J,
                passage=part.passage,
                piece=torch.zeros_like(part.passage.index),
            )
        return _joined(parts, arcs.J, len(pixels))

    def colours(self, x: Tensor, pixels: StreakPixels, covered: "Coverage") -> BallColours:
        """Give the ball's colour before each covered pixel."""
        shape, _, appearance, _, _ = self.split(x)
        if self.is_plain:
            return plain_colours(self.estimator, appearance)
        start, stop = self.exposure_of(pixels)
        return seen_colours(
            self.estimator,
            appearance,
            covered.passage,
            self.path.arcs(shape),
            (start[covered.index], stop[covered.index]),
            self.camera,
            self.ball_radius,
        )

    def J_offset(self, x: Tensor, pixels: StreakPixels, covered: "Coverage") -> Tensor:
        """Give the derivative of each covered pixel's chord offset in the path [M, K]."""
        arcs, passage = self.path.arcs(self.split(x)[0]), covered.passage
        u, t = pixels.rays.unit[covered.index], passage.instant[:, None]
        piece = covered.piece
        c0, c1, c2 = arcs.coefficients[piece].unbind(1)
        gap = torch.linalg.cross(c0 + t * (c1 + t * c2), u)
        length = torch.linalg.vector_norm(gap, dim=-1, keepdim=True).clamp_min(
            NARROW * self.ball_radius
        )
        pull = torch.linalg.cross(u, gap) * passage.side[:, None] / (length * self.ball_radius)
        J_arc = torch.cat([pull, t * pull, t * t * pull], dim=-1)
        if len(arcs.J) == 1:
            return J_arc @ arcs.J[0]
        return (J_arc[:, None] @ arcs.J[piece])[:, 0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """The opacity of the M pixels that the ball covers."""

    index: Tensor  # [M] of the pixels
    alpha: Tensor  # [M]
    J: Tensor  # [M, K + 1] in the path's parameters and the spread
    passage: Passage  # on the arc that covers the pixel most
    piece: Tensor  # [M] that arc's number


def _joined(parts: list[ArcOpacity], J_arcs: Tensor, count: int) -> Coverage:
    """Add up what several arcs cover."""
    size = J_arcs.shape[-1] + 1
    alpha, most = torch.zeros(2, count, dtype=torch.float64).unbind()
    J = torch.zeros(count, size, dtype=torch.float64)
    rows = torch.zeros(count, 4, dtype=torch.float64)
    piece = torch.zeros(count, dtype=torch.long)
    for number, (part, J_arc) in enumerate(zip(parts, J_arcs, strict=True)):
        p = part.passage
        alpha.index_add_(0, p.index, part.alpha)
        J.index_add_(0, p.index, torch.cat([part.J_arc @ J_arc, part.J_spread[:, None]], dim=-1))
        is_most = part.alpha > most[p.index]
        at = p.index[is_most]
        most[at], piece[at] = part.alpha[is_most], number
        rows[at] = torch.stack([p.instant, p.room, p.stiffness, p.side], dim=-1)[is_most]
    index = (most > 0).nonzero()[:, 0]
    instant, room, stiffness, side = rows[index].unbind(-1)
    passage = Passage(index=index, instant=instant, room=room, stiffness=stiffness, side=side)
    return Coverage(
        index=index, alpha=alpha[index], J=J[index], passage=passage, piece=piece[index]
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Model against picture for all N pixels."""

    cost: float
    gradient: Tensor  # [P] half of the cost's
    information: Tensor  # [P, P]
    residual: Tensor  # [N, Q] in standard deviations; 0 where nothing was measured
    coverage: Coverage
    J: tuple[Tensor, ...]  # for each channel [M, P_q] of the covered pixels, whitened


def compare(
    model: SweepModel, x: Tensor, pixels: StreakPixels, *, huber: float = HUBER
) -> Comparison:
    """Compare the model of parameters [P] with the pixels."""
    _, _, _, gain, offset = model.split(x)
    covered = model.opacity(x, pixels)
    index, alpha = covered.index, covered.alpha
    lit = pixels.ground * gain + offset
    own, empty = pixels.shot_variance, pixels.ground_variance * gain**2
    residual = pixels.signal - lit
    variance = own + empty
    a, rest = alpha[:, None], 1 - alpha[:, None]
    ball = model.colours(x, pixels, covered)
    variance[index] = own[index] + rest**2 * empty[index]
    residual[index] -= a * (ball.colour - lit[index])
    precision = variance.reciprocal()  # 0 where nothing was measured
    z = residual * precision.sqrt()
    size = z.abs()
    weight = precision if huber == float("inf") else precision * (huber / size.clamp_min(huber))
    linear = huber * (2 * size - huber) if huber < float("inf") else size
    cost = float(torch.where(size > huber, linear, z * z).sum())

    # derivatives hold the likeliest background
    likeliest = pixels.ground_variance * gain * residual * precision
    likeliest[index] *= rest
    likeliest += pixels.ground
    miss = residual[index]
    contrast = ball.colour - likeliest[index] * gain - offset
    J_offset = None if ball.slope is None else model.J_offset(x, pixels, covered)
    outside = weight.index_fill(0, index, 0)
    k, channels = model.path.size, pixels.signal.shape[-1]
    shared = k + 1 + model.unknowns
    gradient = torch.zeros(len(x), dtype=torch.float64)
    information = torch.zeros(len(x), len(x), dtype=torch.float64)
    whitened = []
    for q in range(channels):
        at = torch.tensor([*range(shared), shared + q, shared + channels + q])
        empty_q, ground = outside[:, q], likeliest[:, q]
        flat = torch.stack([ground, torch.ones_like(ground)], dim=-1)
        weighed = empty_q[:, None] * flat
        information[at[-2:, None], at[-2:]] += weighed.mT @ flat
        gradient[at[-2:]] -= weighed.mT @ residual[:, q]

        columns = covered.J * contrast[:, q, None]
        if J_offset is not None and ball.slope is not None:
            columns[:, :k] += (alpha * ball.slope[:, q])[:, None] * J_offset
        parts = [columns] if ball.design is None else [columns, a * ball.design[:, q]]
        J = torch.cat([*parts, rest * flat[index]], dim=-1) * weight[index, q, None].sqrt()
        information[at[:, None], at] += J.mT @ J
        gradient[at] -= J.mT @ (miss[:, q] * weight[index, q].sqrt())
        whitened.append(J)
    cost += _add_priors(gradient, information, gain, offset, shared)
    return Comparison(
        cost=cost,
        gradient=gradient,
        information=information,
        residual=z,
        coverage=covered,
        J=tuple(whitened),
    )


def _add_priors(
    gradient: Tensor, information: Tensor, gain: Tensor, offset: Tensor, first: int
) -> float:
    """Hold gains about 1 and offsets about 0, weakly; return what this costs."""
    std = torch.tensor([GAIN_STD] * len(gain) + [OFFSET_STD] * len(offset), dtype=torch.float64)
    away = torch.cat([gain - 1, offset]) / std
    gradient[first:] += away / std
    information.diagonal()[first:] += 1 / std**2
    return float(away @ away)
