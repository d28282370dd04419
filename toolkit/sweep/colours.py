"""The ball's own colour before each pixel: the mean along the part of the chord that it saw."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.camera import Camera
from toolkit.sweep.passage import Passage
from toolkit.sweep.paths import Arcs

STRETCH = 0.25
"""Ball's widths of travel within which its direction in the picture and its place count as one."""
MOST_STRETCHES = 24
NARROW = 0.05
"""Share of the radius: nearer to the middle of its chord a ray's side is not told apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallColours:
    """Colours before M pixels."""

    colour: Tensor  # [Q, M], or [Q, 1] where all are the same
    slope: Tensor | None  # [Q, M] in the chord's offset, None where there is none
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
        slope=None,
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
        slope=None if slope is None else slope.mT.double(),
        design=_design(estimator, chord, len(appearance)),
    )


def seen_colours(
    estimator: AlphaEstimator,
    appearance: Tensor,
    passage: Passage,
    arcs: Arcs,
    exposure: tuple[Tensor, Tensor],
    camera: Camera,
    ball_radius: float,
) -> BallColours:
    """Give the colours of a ball that is not the same everywhere.

    Args:
        estimator: knows the colours.
        appearance: what it leaves open [A].
        passage: of the ball before M pixels.
        arcs: of its path.
        exposure: of these pixels, from and to [M].
        camera: tells place and direction in the picture.
        ball_radius: m.
    """
    known = appearance if len(appearance) else None
    t = passage.instant.clamp(-0.5, 0.5)
    half = (passage.room.clamp_min(0) / passage.stiffness).sqrt().clamp_min(1e-9)
    # the leading rim, 1, passes first
    stop = ((passage.instant - exposure[0]) / half).clamp(-1, 1)
    start = ((passage.instant - exposure[1]) / half).clamp(-1, 1)
    gap = _gap(passage, ball_radius)
    is_whole = (start <= -1) & (stop >= 1)
    stretch, count = _stretches(t, arcs, ball_radius)
    rows: list[tuple[Tensor, BallColours]] = []
    for number in range(count):
        is_here = stretch == number
        for index, is_cut in ((is_here & is_whole, False), (is_here & ~is_whole, True)):
            at = index.nonzero()[:, 0]
            if len(at):
                chord = _chord(gap[at], t[at].mean(), arcs, camera)
                if is_cut:
                    chord = Chord(
                        offset=chord.offset,
                        direction=chord.direction,
                        place=chord.place,
                        start=start[at],
                        stop=stop[at],
                    )
                colour, slope = estimator.foreground_and_slope(chord, known)
                design = _design(estimator, chord, len(appearance))
                across = None if slope is None else slope.mT.double()
                rows.append(
                    (at, BallColours(colour=colour.mT.double(), slope=across, design=design))
                )
    return _gathered(rows)


def _gathered(rows: list[tuple[Tensor, BallColours]]) -> BallColours:
    """Put what was found stretch by stretch back into the pixels' order."""
    order = torch.cat([at for at, _ in rows]).argsort()
    slopes = [part.slope for _, part in rows if part.slope is not None]
    designs = [part.design for _, part in rows if part.design is not None]
    return BallColours(
        colour=torch.cat([part.colour for _, part in rows], dim=-1)[:, order],
        slope=torch.cat(slopes, dim=-1)[:, order] if len(slopes) == len(rows) else None,
        design=torch.cat(designs, dim=-1)[..., order] if len(designs) == len(rows) else None,
    )


def _stretches(time: Tensor, arcs: Arcs, ball_radius: float) -> tuple[Tensor, int]:
    """Number the stretches of the path, each so short that all on it look alike."""
    _, velocity = arcs.at(torch.linspace(-0.5, 0.5, 9, dtype=torch.float64))
    travel = float(torch.linalg.vector_norm(velocity, dim=-1).mean()) / (2 * ball_radius)
    count = max(1, min(MOST_STRETCHES, math.ceil(travel / STRETCH)))
    return ((time + 0.5) * count).long().clamp(0, count - 1), count


def _chord(gap: Tensor, time: Tensor, arcs: Arcs, camera: Camera) -> Chord:
    centre, velocity = arcs.at(time[None])
    x, y = (camera.J_project(centre) @ velocity[..., None])[0, :, 0]
    return Chord(offset=gap, direction=torch.atan2(y, x)[None], place=camera.project(centre))


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
    zero = torch.zeros(unknowns, dtype=torch.float64)
    base = estimator.foreground(chord, zero)
    columns = [estimator.foreground(chord, unit) - base for unit in torch.eye(unknowns).double()]
    return torch.stack(columns, dim=-1).movedim(0, -1).double()
