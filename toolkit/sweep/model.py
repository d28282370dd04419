"""What every pixel shows while the ball passes: how opaque the streak is there, and in what colour.

The parameters of a motion, of the lens's blur, of the ball's looks and of the light stand in one
vector, so that they can be found together (`likelihood`).
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.sweep.cells import Cells
from toolkit.sweep.chord_table import STEEPEST
from toolkit.sweep.colours import (
    NARROW,
    BallColours,
    Sight,
    ahead_colours,
    count_channels,
    is_plain,
    lane_colours,
    plain_colours,
    seen_colours,
)
from toolkit.sweep.opacity import ArcOpacity
from toolkit.sweep.passage import Passage
from toolkit.sweep.paths import SweepPath
from toolkit.sweep.pixels import StreakPixels
from toolkit.sweep.shade import Shaded
from toolkit.sweep.sharp_turns import opacity_parts


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
    cells: Cells | None = None  # of the pixels compared, where marks on the ball are allowed for
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
        arcs = self.path.arcs(self.split(x)[0])
        start, stop = self.exposure_of(pixels)
        spread = float(x[self.path.size])
        parts: list[tuple[ArcOpacity, Tensor, int]] = []
        for number, (low, high) in enumerate(arcs.limits(start, stop)):
            arc, J_arc = arcs.coefficients[number], arcs.J[number]
            for part, J in opacity_parts(arc, pixels.rays, low, high, spread, self.ball_radius):
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
        ball, passage = self.estimator, covered.passage
        if self.is_laned and isinstance(ball, Shaded) and ball.looks_ahead:
            ahead, exposure = ball.ahead(appearance), self.exposure_of(pixels)
            return ahead_colours(ball, appearance, ahead, passage, self.ball_radius, exposure)
        if self.is_laned:
            return lane_colours(ball, appearance, passage, self.ball_radius)
        sight = Sight(
            passage=covered.passage,
            arcs=self.path.arcs(shape),
            exposure=self.exposure_of(pixels),
            spread=float(x[self.path.size]) + pixels.rays.blur,
            blur=self._rim_blur(x, pixels, covered),
            camera=self.camera,
            ball_radius=self.ball_radius,
        )
        return seen_colours(self.estimator, appearance, sight)

    def _rim_blur(self, x: Tensor, pixels: StreakPixels, covered: "Coverage") -> Tensor:
        """Give the standard deviation of the passage's room over lens and pixel [N], m^2."""
        shape = self.split(x)[0]
        c0, c1, c2 = self.path.arcs(shape).coefficients[covered.piece].permute(1, 2, 0)
        t, rays = covered.passage.instant, pixels.rays
        centre = c0 + t * (c1 + t * c2)
        near = 2 * (centre * rays.unit).sum(0)
        right, down = (near * (centre * side).sum(0) for side in (rays.right, rays.down))
        variance = float(x[self.path.size]) + rays.blur
        size = (rays.right**2 + rays.down**2).sum(0).mean() / 2
        bend = variance * (centre * centre).sum(0) * size
        room: Tensor = (variance * (right**2 + down**2) + 2 * bend**2).sqrt()
        return room

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

    def J_chord(self, x: Tensor, pixels: StreakPixels, covered: "Coverage", count: int) -> Tensor:
        """Give the derivatives in the path of what tells each covered pixel's chord [count, K, M].

        In this order: its offset, the instant when the ball is nearest, the logarithm of half the
        time that the ball takes to cross it.
        """
        arcs, passage, piece = self.path.arcs(self.split(x)[0]), covered.passage, covered.piece
        u, t, A = pixels.rays.unit, passage.instant, passage.stiffness
        c0, c1, c2 = arcs.coefficients[piece].permute(1, 2, 0)
        centre, velocity = c0 + t * (c1 + t * c2), c1 + 2 * t * c2
        away, across, bend = (v - (v * u).sum(0) * u for v in (centre, velocity, 2 * c2))
        distance = (away * away).sum(0).sqrt().clamp_min(NARROW * self.ball_radius)
        pull = away * (passage.side / (distance * self.ball_radius))
        rows = [torch.cat([pull, t * pull, t * t * pull])]
        if count > 1:
            # of C' and C, and for the stiffness of C'' too, as they enter there
            by_C, by_C1 = -across / A, -away / A
            rows.append(torch.cat([by_C, t * by_C + by_C1, t * t * by_C + 2 * t * by_C1]))
            room = passage.room.clamp_min(STEEPEST**2 * self.ball_radius**2)
            by_C, by_C1, by_C2 = -away / room - bend / (2 * A), -across / A, -away / (2 * A)
            once = t * by_C + by_C1
            rows.append(torch.cat([by_C, once, t * (once + by_C1) + 2 * by_C2]))
        J_arc = torch.stack(rows[:count])
        if len(arcs.J) == 1:
            return arcs.J[0].mT @ J_arc
        return torch.einsum("mak,dam->dkm", arcs.J[piece], J_arc)


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
