"""The ball's own colour before each pixel: the mean along the part of the chord that it saw."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.camera import Camera
from toolkit.sweep.chord_table import (
    PARTS,
    STEEPEST,
    WHOLE,
    Nodes,
    Rows,
    between,
    between_parts,
)
from toolkit.sweep.passage import Passage
from toolkit.sweep.paths import Arcs
from toolkit.sweep.soft import soft_ramp, soft_root

STRETCH = 0.25
"""Ball's widths of travel between the instants at which an estimator is asked."""
MOST_STRETCHES = 64
LONGEST_REACH = 1.0
"""Exposures before and after which a ball that hardly moves is looked at."""
FAR, DEEP = 20.0, 5.0
"""Spreads inside the contour from which chords count as unblurred, and outside to which they do."""
NARROW = 0.05
"""Share of the radius: nearer to the middle of its chord a ray's side is not told apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallColours:
    """Colours before M pixels."""

    colour: Tensor  # [Q, M], or [Q, 1] where all are the same
    slopes: Tensor | None  # [D, Q, M] in the first D numbers of `SweepModel.J_chord`, if in any
    by_spread: Tensor | None  # [Q, M] its slope in the variance of the spread, where it has one
    design: Tensor | None  # [Q, A, M or 1] in the unknowns of the appearance


def is_plain(estimator: AlphaEstimator) -> bool:
    """Say whether the ball shows the same on every chord."""
    return estimator.foreground_and_slope(_middle(), _any_looks(estimator))[1] is None


def count_channels(estimator: AlphaEstimator) -> int:
    """Give the number of signal channels."""
    return estimator.foreground(_middle(), _any_looks(estimator)).shape[-1]


def _any_looks(estimator: AlphaEstimator) -> Tensor | None:
    unknowns = estimator.unknowns()
    return torch.full((unknowns,), 0.5, dtype=torch.float64) if unknowns else None


def plain_colours(estimator: AlphaEstimator, appearance: Tensor) -> BallColours:
    """Give the one colour of a ball that shows it on every chord."""
    known = appearance if len(appearance) else None
    return BallColours(
        colour=estimator.foreground(_middle(), known).mT.double(),
        slopes=None,
        by_spread=None,
        design=_design(estimator, _middle(), len(appearance)),
    )


def lane_colours(
    estimator: AlphaEstimator, appearance: Tensor, passage: Passage, ball_radius: float
) -> BallColours:
    """Give the colours of a ball that shows the same all along a chord, wherever it is."""
    chord = Chord(offset=_gap(passage, ball_radius), direction=torch.zeros(1, dtype=torch.float64))
    colour, slope = estimator.foreground_and_slope(chord, appearance)
    return BallColours(
        colour=colour.mT.double(),
        slopes=None if slope is None else slope.mT.double()[None],
        by_spread=None,
        design=_design(estimator, chord, len(appearance)),
    )


def ahead_colours(
    estimator: AlphaEstimator,
    appearance: Tensor,
    ahead: Tensor,
    passage: Passage,
    ball_radius: float,
    exposure: tuple[Tensor, Tensor],
) -> BallColours:
    """Give those of a ball whose light is linear along a chord, of which the ends show parts.

    Args:
        estimator: knows the colours.
        appearance: what it leaves open [A].
        ahead: by how much the leading rim is brighter than the middle, [Q].
        passage: of M pixels.
        ball_radius: m.
        exposure: of each pixel, from and to [M].
    """
    gap = _gap(passage, ball_radius)
    half = (passage.room.clamp_min(0) / passage.stiffness).sqrt().clamp_min(1e-9)
    # the leading rim, 1, passes first
    ends = [(passage.instant - exposure[end]) / half for end in (1, 0)]
    start, stop = (end.clamp(-1, 1) for end in ends)
    direction = torch.zeros(1, dtype=torch.float64)
    chord = Chord(offset=gap, direction=direction, start=start, stop=stop)
    colour, slope = estimator.foreground_and_slope(chord, appearance)
    height = (1 - gap * gap).clamp_min(0).sqrt()
    by_end = ahead[:, None] * height / 2
    is_cut = [(end.abs() < 1).to(half) for end in ends]
    by_instant = by_end * (is_cut[0] + is_cut[1]) / half
    by_half = -by_end * (is_cut[0] * start + is_cut[1] * stop)
    across = torch.zeros_like(by_instant) if slope is None else slope.mT.double()
    return BallColours(
        colour=colour.mT.double(),
        slopes=torch.stack([across, by_instant, by_half]),
        by_spread=None,
        design=_design(estimator, chord, len(appearance)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """How M pixels see the ball pass."""

    passage: Passage
    arcs: Arcs
    exposure: tuple[Tensor, Tensor]  # of each, from and to [M]
    spread: Tensor  # [M] variance of lens and pixel, px^2
    blur: Tensor  # [M] standard deviation of the passage's room by that, m^2
    camera: Camera
    ball_radius: float

    def rows(self) -> Rows:
        """Give instants along the path between which the ball's look hardly changes.

        A ray may see the ball from before it is nearest to it, and until after that.
        """
        first, last = float(self.exposure[0].min()), float(self.exposure[1].max())
        middle = torch.tensor([(first + last) / 2], dtype=torch.float64)
        centre, velocity = (vector[0] for vector in self.arcs.at(middle))
        view = torch.nn.functional.normalize(centre, dim=0)
        across = float(torch.linalg.vector_norm(velocity - (velocity @ view) * view))
        reach = min(1.5 * self.ball_radius / max(across, 1e-12), LONGEST_REACH)
        widths = across * (last - first + 2 * reach) / (2 * self.ball_radius)
        count = max(1, min(MOST_STRETCHES, math.ceil(widths / STRETCH)))
        return Rows.about(self.passage.instant, first - reach, last + reach, count)

    def angle(self) -> tuple[Tensor, Tensor, Tensor]:
        """Give the angle whose sine is the offset of each pixel's chord.

        Where lens and pixel blur the rim, chords of many heights h mix, each for its share h of
        the exposure; the chord seen instead has the height mean(h^2) / mean(h). Near the rim the
        mean colour is linear in the height, so that it is exact for a straight rim. [derived]

        Returns:
            Angles, their slopes in the offset and in the variance of the spread, [M] each.
        """
        room, radius, side = self.passage.room, self.ball_radius, self.passage.side
        height = room.clamp_min(0).sqrt() / radius
        by_offset, by_spread = 1 / height.clamp_min(STEEPEST), torch.zeros_like(height)
        x = room / self.blur
        near = (x < FAR).nonzero()[:, 0]
        x, root_blur = x[near].clamp_min(-DEEP), self.blur[near].sqrt()
        root, root_slope, _, _ = soft_root(x)
        ramp, ramp_slope, _ = soft_ramp(x)
        rise = (ramp_slope - ramp * root_slope / root) / root
        height[near] = (root_blur * ramp / root) / radius
        height = height.clamp_max(1)
        distance = (1 - height * height).sqrt()
        steep = 1 / (root_blur * distance[near].clamp_min(STEEPEST))
        gap = (1 - room[near] / radius**2).clamp_min(0).sqrt()
        by_offset[near] = 2 * radius * gap * rise * steep
        widening = self.blur[near] * (ramp / root / 2 - x * rise) / radius
        by_spread[near] = -side[near] * widening * steep / (2 * self.spread[near])
        return side * torch.atan2(distance, height), by_offset, by_spread


def seen_colours(estimator: AlphaEstimator, appearance: Tensor, sight: Sight) -> BallColours:
    """Give the colours of a ball that is not the same everywhere.

    Args:
        estimator: knows the colours.
        appearance: what it leaves open [A].
        sight: of M pixels.
    """
    passage, rows = sight.passage, sight.rows()
    angle, per_offset, per_spread = sight.angle()
    half = (passage.room.clamp_min(0) / passage.stiffness).sqrt().clamp_min(1e-9)
    # the leading rim, 1, passes first
    start, stop = ((passage.instant - sight.exposure[end]) / half for end in (1, 0))
    looks = _looks(len(appearance))
    nodes = Nodes.of(rows.time, sight.arcs, sight.camera, sight.ball_radius, WHOLE)
    table = nodes.whole(estimator, looks)
    channels = table.shape[-2]
    value, by_angle, by_time = between(table.flatten(-2), rows, angle)
    by_half = torch.zeros_like(value)
    cut = ((start > -1) | (stop < 1)).nonzero()[:, 0]
    if len(cut):
        chosen = rows.chosen(cut)
        nodes = Nodes.of(chosen.time, sight.arcs, sight.camera, sight.ball_radius, PARTS)
        sums = nodes.integrals(estimator, looks).flatten(-2)
        begin, end = start[cut], stop[cut]
        value[cut], by_angle[cut], by_start, by_stop = between_parts(
            sums, chosen, angle[cut], begin, end
        )
        by_time[cut] += (by_start + by_stop) / half[cut, None]
        by_half[cut] = -(by_start * begin[:, None] + by_stop * end[:, None])
    across, by_spread = (by_angle * rate[:, None] for rate in (per_offset, per_spread))
    slopes = torch.stack([across, by_time, by_half, by_spread])
    # the first look is that of no unknowns, each other one adds one of them
    colour, *columns = value.reshape(-1, channels, len(looks)).permute(2, 1, 0)
    slopes = slopes.reshape(4, -1, channels, len(looks)).permute(3, 0, 2, 1)
    slope, design = slopes[0], None
    if columns:
        design = torch.stack(columns, dim=1) - colour[:, None]
        colour = colour + torch.einsum("qam,a->qm", design, appearance)
        slope = slope + torch.einsum("adqm,a->dqm", slopes[1:] - slope, appearance)
    return BallColours(colour=colour, slopes=slope[:3], by_spread=slope[3], design=design)


def _looks(unknowns: int) -> list[Tensor | None]:
    """Give appearances from which all others can be mixed: none, then each number by itself."""
    if not unknowns:
        return [None]
    return [torch.zeros(unknowns).double(), *torch.eye(unknowns).double()]


def _gap(passage: Passage, ball_radius: float) -> Tensor:
    """Distance of each ray from the path, ball radii, positive to the right of the motion."""
    gap: Tensor = (1 - passage.room / ball_radius**2).clamp(0, 1).sqrt() * passage.side
    return gap


def _middle() -> Chord:
    zero = torch.zeros(1, dtype=torch.float64)
    return Chord(offset=zero, direction=zero)


def _design(estimator: AlphaEstimator, chord: Chord, unknowns: int) -> Tensor | None:
    """Derivative of the colour in its unknowns, in which it is linear."""
    if not unknowns:
        return None
    base, *columns = [estimator.foreground(chord, look) for look in _looks(unknowns)]
    return torch.stack([column - base for column in columns], dim=-1).movedim(0, -1).double()
