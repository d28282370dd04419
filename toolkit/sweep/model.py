"""What every pixel shows while the ball passes, and the equations of the most likely motion.

A pixel shows g B + o + alpha (F - g B - o): the background B in a light that may have changed by a
gain g and an offset o in each channel, behind the ball F for the share alpha of the exposure. Only
a noisy picture G of the background is known. Of all backgrounds the likeliest given both pictures
is taken for each pixel, which makes the cost the squared residual over v_shot + (1 - alpha)^2 g^2
v_background; its exact gradient is that of B held there. [derived]
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.least_squares import solve_information
from toolkit.sweep.colours import (
    NARROW,
    BallColours,
    count_channels,
    is_plain,
    lane_colours,
    plain_colours,
    seen_colours,
)
from toolkit.sweep.opacity import PIXEL_VARIANCE, ArcOpacity
from toolkit.sweep.passage import Passage
from toolkit.sweep.paths import SweepPath
from toolkit.sweep.pixels import Beside, StreakPixels
from toolkit.sweep.shade import Shaded
from toolkit.sweep.sharp_turns import opacity_parts

HUBER = 3.5
"""Standard deviations beyond which a pixel's misfit counts linearly."""
GAIN_STD = 0.02
"""Prior standard deviation of the background's gain, about 1."""
OFFSET_STD = 0.005
"""The same of its offset, about 0, shares of white: both are known from beside the streak."""


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
    shade_std: float = 0.0  # prior of each number of a shade, light; 0 where there is none
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

    @cached_property
    def is_laned(self) -> bool:
        """Whether all that differs on the ball is a shade over one colour."""
        return isinstance(self.estimator, Shaded) and is_plain(self.estimator.innermost)

    @cached_property
    def channels(self) -> int:
        """Number of signal channels, Q."""
        return count_channels(self.estimator)

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
        wide = float(spread) + pixels.area_variance - PIXEL_VARIANCE
        parts: list[tuple[ArcOpacity, Tensor, int]] = []
        for number, (low, high) in enumerate(arcs.limits(start, stop)):
            arc, J_arc = arcs.coefficients[number], arcs.J[number]
            for part, J in opacity_parts(arc, pixels.rays, low, high, wide, self.ball_radius):
                parts.append((part, J_arc if J is None else J @ J_arc, number))
        if len(parts) == 1 and len(parts[0][0].alpha) == len(pixels):
            part, J_arc, _ = parts[0]
            return Coverage(
                alpha=part.alpha,
                J=torch.cat([J_arc.mT @ part.J_arc, part.J_spread[None]]),
                passage=part.passage,
                piece=torch.zeros_like(part.passage.index),
            )
        return _joined(parts, self.path.size, len(pixels))

    def colours(self, x: Tensor, pixels: StreakPixels, covered: "Coverage") -> BallColours:
        """Give the ball's colour before each covered pixel."""
        shape, _, appearance, _, _ = self.split(x)
        if self.is_plain:
            return plain_colours(self.estimator, appearance)
        if self.is_laned:
            return lane_colours(self.estimator, appearance, covered.passage, self.ball_radius)
        return seen_colours(
            self.estimator,
            appearance,
            covered.passage,
            self.path.arcs(shape),
            self.exposure_of(pixels),
            self.camera,
            self.ball_radius,
        )

    def opacity_slope(self, x: Tensor, pixels: StreakPixels, covered: "Coverage") -> Tensor:
        """Give the change of the opacity from pixel to pixel, to the right and downwards [2, N].

        To see another ray is to see a path turned the other way: the derivative in the path tells.
        """
        vectors = self.path.vectors
        points = x[:vectors].reshape(-1, 3)
        J = covered.J[:vectors].reshape(len(points), 3, -1)
        turn = -torch.linalg.cross(points[..., None].expand_as(J), J, dim=1).sum(0)
        rays = pixels.rays
        sides = (rays.right, rays.down)
        return torch.stack(
            [(torch.linalg.cross(rays.unit, side, dim=0) * turn).sum(0) for side in sides]
        )

    def J_offset(self, x: Tensor, pixels: StreakPixels, covered: "Coverage") -> Tensor:
        """Give the derivative of each covered pixel's chord offset in the path [K, M]."""
        arcs, passage, piece = self.path.arcs(self.split(x)[0]), covered.passage, covered.piece
        u, t = pixels.rays.unit, passage.instant
        c0, c1, c2 = arcs.coefficients[piece].permute(1, 2, 0)
        centre = c0 + t * (c1 + t * c2)
        away = centre - (centre * u).sum(0) * u
        distance = (away * away).sum(0).sqrt().clamp_min(NARROW * self.ball_radius)
        pull = away * (passage.side / (distance * self.ball_radius))
        J_arc = torch.cat([pull, t * pull, t * t * pull])
        if len(arcs.J) == 1:
            return arcs.J[0].mT @ J_arc
        return torch.einsum("mak,am->km", arcs.J[piece], J_arc)


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """The opacity of N pixels."""

    alpha: Tensor  # [N]
    J: Tensor  # [K + 1, N] in the path's parameters and the spread
    passage: Passage  # on the arc that covers the pixel most
    piece: Tensor  # [N] that arc's number


def _joined(parts: list[tuple[ArcOpacity, Tensor, int]], size: int, count: int) -> Coverage:
    """Add up what arcs, or pieces of them, cover, each with J [9, K] and its arc's number."""
    alpha, most = torch.zeros(2, count, dtype=torch.float64).unbind()
    J = torch.zeros(size + 1, count, dtype=torch.float64)
    # far from all: nothing of the ball is seen, an instant and a stiffness there mean nothing
    rows = torch.tensor([[0.0], [-1.0], [1.0], [1.0]], dtype=torch.float64).repeat(1, count)
    piece = torch.zeros(count, dtype=torch.long)
    for part, J_arc, number in parts:
        p = part.passage
        alpha.index_add_(0, p.index, part.alpha)
        J.index_add_(1, p.index, torch.cat([J_arc.mT @ part.J_arc, part.J_spread[None]]))
        is_most = part.alpha > most[p.index]
        at = p.index[is_most]
        most[at], piece[at] = part.alpha[is_most], number
        rows[:, at] = torch.stack([p.instant, p.room, p.stiffness, p.side])[:, is_most]
    instant, room, stiffness, side = rows
    index = torch.arange(count)
    passage = Passage(index=index, instant=instant, room=room, stiffness=stiffness, side=side)
    return Coverage(alpha=alpha, J=J, passage=passage, piece=piece)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Model against picture for all N pixels."""

    cost: float
    gradient: Tensor  # [P] half of the cost's
    information: Tensor  # [P, P]
    residual: Tensor  # [Q, N] in standard deviations; 0 where nothing was measured
    coverage: Coverage
    contrast: Tensor  # [Q, N] of ball and background, over the standard deviation
    J: tuple[Tensor, ...]  # for each channel [P_q, N], whitened
    columns: tuple[Tensor, ...]  # for each channel the parameters [P_q] these belong to

    @property
    def pull(self) -> Tensor:
        """How much each pixel wants the opacity to rise [N], times `hold`."""
        return (self.residual * self.contrast).sum(0)

    @property
    def hold(self) -> Tensor:
        """Information of each pixel about its opacity [N]."""
        return (self.contrast * self.contrast).sum(0)

    def answer(self, change: Tensor) -> Tensor:
        """Give the change of the parameters [P] that a change of the whitened picture causes.

        Args:
            change: of the pixels, in standard deviations [Q, N].
        """
        pull = torch.zeros_like(self.gradient)
        for q, (J, at) in enumerate(zip(self.J, self.columns, strict=True)):
            pull[at] += J @ change[q]
        return solve_information(self.information, pull)

    def step(
        self, damping: float = 0.0, held: tuple[int, float] | None = None
    ) -> tuple[Tensor, float]:
        """Give the Gauss-Newton step [P] and the chi-square that it promises.

        Args:
            damping: of the information scaled to a unit diagonal.
            held: a parameter and the step that it must take.
        """
        if held is None:
            step = solve_information(self.information, -self.gradient, damping)
            return step, float(-step @ self.gradient)
        index, size = held
        free = torch.arange(len(self.gradient)) != index
        pull = -self.gradient - self.information[:, index] * size
        step = torch.full_like(self.gradient, size)
        step[free] = solve_information(self.information[free][:, free], pull[free], damping)
        return step, float(step @ (-2 * self.gradient - self.information @ step))


def compare(
    model: SweepModel,
    x: Tensor,
    pixels: StreakPixels,
    *,
    covered: Coverage | None = None,
    huber: float = HUBER,
) -> Comparison:
    """Compare the model of parameters [P] with the pixels, whose opacity may be known already."""
    _, _, _, gain, offset = model.split(x)
    gains = torch.cat([gain - 1, offset])
    covered = covered or model.opacity(x, pixels)
    alpha, rest = covered.alpha, 1 - covered.alpha
    gain, offset = gain[:, None], offset[:, None]
    lit = pixels.ground * gain + offset
    empty = pixels.ground_variance * gain
    ball = model.colours(x, pixels, covered)
    residual = pixels.signal - lit - alpha * (ball.colour - lit) - pixels.mixed
    precision = 1 / (pixels.shot_variance + rest**2 * gain * empty)  # 0 where nothing was measured
    root = precision.sqrt()
    z = residual * root
    size = z.abs()
    cost = float((size * size).sum())
    is_far = size > huber
    if bool(is_far.any()):
        far = size[is_far]
        cost += float((huber * (2 * far - huber) - far * far).sum())
        root[is_far] *= (huber / far).sqrt()

    # derivatives hold the likeliest background
    likeliest = pixels.ground + empty * rest * residual * precision
    contrast = ball.colour - likeliest * gain - offset
    J_offset = None if ball.slope is None else model.J_offset(x, pixels, covered)
    channels, shared = len(pixels.signal), model.path.size + 1 + model.unknowns
    gradient = torch.zeros(len(x), dtype=torch.float64)
    information = torch.zeros(len(x), len(x), dtype=torch.float64)
    whitened, columns = [], []
    for q in range(channels):
        at = torch.tensor([*range(shared), shared + q, shared + channels + q])
        J = _channel_J(covered, ball, J_offset, contrast[q], likeliest[q], root[q], q)
        information[at[:, None], at] += J @ J.mT
        gradient[at] -= J @ (residual[q] * root[q])
        whitened.append(J)
        columns.append(at)
    cost += _add_beside(gradient, information, pixels.beside, gains)
    cost += _add_priors(gradient, information, gains)
    if isinstance(model.estimator, Shaded):
        last = slice(shared - model.estimator.shades, shared)
        cost += _add_shade_prior(gradient, information, x[last], last, model.shade_std)
    return Comparison(
        cost=cost,
        gradient=gradient,
        information=information,
        residual=z,
        coverage=covered,
        contrast=contrast * precision.sqrt(),
        J=tuple(whitened),
        columns=tuple(columns),
    )


def _channel_J(
    covered: Coverage,
    ball: BallColours,
    J_offset: Tensor | None,
    contrast: Tensor,
    ground: Tensor,
    root: Tensor,
    q: int,
) -> Tensor:
    """Give the whitened derivatives of one channel [K + 1 + A + 2, N].

    They are those in path and spread, in the appearance, in gain and in offset; `root` whitens.
    """
    alpha, size = covered.alpha, len(covered.J)
    unknowns = 0 if ball.design is None else ball.design.shape[1]
    J = torch.empty(size + unknowns + 2, len(alpha), dtype=torch.float64)
    torch.mul(covered.J, contrast * root, out=J[:size])
    if J_offset is not None and ball.slope is not None:
        J[: size - 1] += (alpha * ball.slope[q] * root) * J_offset
    if ball.design is not None:
        torch.mul(ball.design[q], alpha * root, out=J[size:-2])
    torch.mul(1 - alpha, root, out=J[-1])
    torch.mul(J[-1], ground, out=J[-2])
    return J


def _add_beside(gradient: Tensor, information: Tensor, beside: Beside, gains: Tensor) -> float:
    """Add what the pixels beside the streak say of gain and offset; return what they cost."""
    last = len(gains)
    gradient[-last:] += beside.gradient + beside.information @ gains
    information[-last:, -last:] += beside.information
    return beside.cost + float(gains @ (2 * beside.gradient + beside.information @ gains))


def _add_priors(gradient: Tensor, information: Tensor, gains: Tensor) -> float:
    """Hold gains about 1 and offsets about 0, weakly; return what this costs."""
    half = len(gains) // 2
    precision = torch.tensor([GAIN_STD**-2] * half + [OFFSET_STD**-2] * half, dtype=torch.float64)
    gradient[-2 * half :] += gains * precision
    information.diagonal()[-2 * half :] += precision
    return float(gains @ (gains * precision))


def _add_shade_prior(
    gradient: Tensor, information: Tensor, shade: Tensor, place: slice, std: float
) -> float:
    """Hold a shade about none; return what this costs."""
    gradient[place] += shade / std**2
    information.diagonal()[place] += std**-2
    return float(shade @ shade) / std**2
