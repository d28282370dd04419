"""Marks that the ball carries and nobody told of, and what they do to the answer.

Holes, ribs, print and dirt change the ball's light from place to place, as no smooth shade does.
Before the camera they pass as lanes along the streak, or as spots where the ball turns. What the
fit leaves over tells how large and how strong they are: each cell, so wide across the streak and so
long along it, is given a light of its own at random, and size and strength are those that make the
rest of the picture most likely (restricted maximum likelihood). What such cells would change in the
answer is its uncertainty: more than the rest of the picture shows, since the fit has followed them
as far as it could. [derived]
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.sweep.cells import Cells, CellSums
from toolkit.sweep.fit import SETTLED, SweepFit, fit_sweep, outline, search
from toolkit.sweep.likelihood import compare
from toolkit.sweep.misfit import Misfit, look_for_misfit, small_patches, with_coarse_misfit
from toolkit.sweep.paths import PARABOLA, STRAIGHT
from toolkit.sweep.pixels import Frame, StreakPixels

WIDTH, LENGTH = 0.0625, 0.25
"""Radii across and along the path, of the smallest marks looked for; but for `NARROWEST`."""
NARROWEST = 2.0
"""px, of a mark across."""
MERGED = (1, 2, 4, 8)
"""Smallest cells side by side in those of larger marks, either way."""
SHORTEST = 0.05
"""Diameters of a part of a chord: of a shorter one marks look as if it were as long."""
FEWEST = 4
"""Cells of which a variance can be told."""
STRONGEST, WEAKEST, STEPS = 0.5, 0.002, 16
"""Of marks, rms change of light over that of the ball, and steps of the search for it: holes that
are black and cover half of the ball are as strong."""
EVIDENCE = 4.0
"""Chi-square that each number of a bend must gain."""
CERTAIN = 12.0
"""Chi-square that marks must save to be there: chance saves as much once in a thousand shots."""
NOTHING = 1e-12
"""Variance of lights that are all the same."""
SAMPLES = 65
"""Instants at which a straight path follows a bent one."""
MOST_ROUNDS, STEPS_A_ROUND, STILL = 4, 8, 0.1
"""In which the motion is fitted, and the marks found, in turn; steps of the motion in each; and the
squared step, in standard deviations for each number, after which no further round is made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """The size and strength of the marks that explain best what a fit left over."""

    width: float  # across the path, ball radii
    length: float  # along it, ball radii; infinite for lanes of the whole streak
    strength: float  # rms change of light over that of the ball
    cost: float  # -2 log likelihood
    wide: int  # smallest cells across
    long: int  # and along
    cells: Cells


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkedFit:
    """The most likely motion of a ball with marks on it."""

    fit: SweepFit
    marks: Marks
    others: tuple[SweepFit, ...]  # that are as good: what they differ by nobody knows better
    before: Misfit  # what a ball without any leaves, of the camera's noise
    left: Misfit  # what is left with them
    residuals: tuple[Tensor, Tensor]  # places and standard deviations of small patches before


def fit_with_marks(fit: SweepFit, frame: Frame) -> MarkedFit | None:
    """Fit the motion again with marks on the ball; None where there are none.

    A parabola may have followed marks, so that a straight path is tried again.

    Args:
        fit: without any.
        frame: the window about the streak.
    """
    frame = frame.noisier(fit.pixels.excess)
    plain = fit_sweep(fit.model, fit.parameters, frame, doubt=1.0)  # of single pixels
    before = look_for_misfit(plain)
    noisy = replace(plain, pixels=_noisier(plain.pixels, before.pixels))
    found = _marked(noisy)
    if fit.model.path == PARABOLA:
        found = _simpler(_marked(_straightened(noisy)), found)
    if found is None:
        return None
    fit, marks = found
    left = with_coarse_misfit(look_for_misfit(fit), fit)
    # how much of the misfit is marks nobody knows: the motion without any is as far off, or this
    others = [plain, _of_other_width(fit, marks)]
    return MarkedFit(
        fit=fit,
        marks=marks,
        others=tuple(other for other in others if other is not None and other.converged),
        before=before,
        left=left,
        residuals=small_patches(plain),
    )


Found = tuple[SweepFit, Marks] | None


def _simpler(straight: Found, bent: Found) -> Found:
    """Give the straight path unless the bent one is worth its numbers."""
    if straight is None or bent is None or not straight[0].converged:
        return bent
    gain = straight[1].cost - bent[1].cost
    is_worth = gain > EVIDENCE * (PARABOLA.size - STRAIGHT.size)
    return bent if is_worth and bent[0].converged else straight


def _marked(fit: SweepFit) -> Found:
    """Find the motion and the marks in turn, until neither moves the other."""
    pixels, model, found, marks = fit.pixels, fit.model, None, None
    for _ in range(MOST_ROUNDS):
        plain = compare(model, fit.parameters, pixels)
        marks = find_marks(replace(fit, model=model, seen=plain), like=marks)
        if marks is None:
            return found
        marked, before = replace(model, cells=marks.cells), fit.parameters
        seen = compare(marked, before, pixels)
        fit = search(marked, before, pixels, seen, tolerance=SETTLED, most_steps=STEPS_A_ROUND)
        found = fit, marks
        step = fit.parameters - before
        if fit.converged and float(step @ fit.seen.information @ step) < STILL * len(step):
            break
    return found


def _of_other_width(fit: SweepFit, marks: Marks) -> SweepFit | None:
    """Fit marks of the next likeliest width."""
    model = replace(fit.model, cells=None)
    plain = replace(fit, model=model, seen=compare(model, fit.parameters, fit.pixels))
    others = find_marks(plain, other_than=marks)
    if others is None:
        return None
    model = replace(model, cells=others.cells)
    seen = compare(model, fit.parameters, fit.pixels)
    return search(model, fit.parameters, fit.pixels, seen, tolerance=SETTLED)


def _straightened(fit: SweepFit) -> SweepFit:
    """Fit a straight path to the same pixels."""
    time = torch.linspace(-0.5, 0.5, SAMPLES, dtype=torch.float64)
    size = fit.model.path.size
    points = fit.model.path.arcs(fit.parameters[:size]).at(time)[0]
    x = torch.cat([STRAIGHT.through(time, points), fit.parameters[size:]])
    model = replace(fit.model, path=STRAIGHT)
    seen = compare(model, x, fit.pixels)
    return search(model, x, fit.pixels, seen, tolerance=SETTLED)


def find_marks(
    fit: SweepFit, *, like: Marks | None = None, other_than: Marks | None = None
) -> Marks | None:
    """Find the marks that explain best what a fit without any leaves over, if anything does.

    Args:
        fit: its pixels as noisy as single ones miss.
        like: marks whose size is kept, so that their strength alone is found.
        other_than: marks whose width is passed over.
    """
    grid = _grid(fit)
    number, share = grid.lane * grid.stretches + grid.stretch, _shares(fit)
    cells = Cells(number=number, count=grid.count, share=share)
    sums = cells.sums(fit.seen)
    least, best = sums.cost(fit.seen, NOTHING) - CERTAIN, None
    for wide, long in grid.sizes() if like is None else [(like.wide, like.long)]:
        larger, count = grid.merged(wide, long)
        if count < FEWEST or (other_than is not None and wide == other_than.wide):
            continue
        cost, strength = _likeliest(sums.merged(larger, count), fit)
        if cost < least:
            least = cost
            best = Marks(
                width=2 * wide / grid.lanes,
                length=math.inf if long >= grid.stretches else long * grid.step,
                strength=strength,
                cost=cost,
                wide=wide,
                long=long,
                cells=Cells(number=larger[number], count=count, share=share, variance=strength**2),
            )
    return best


@dataclass(frozen=True, slots=True, kw_only=True)
class _Grid:
    """The smallest cells: lanes across the streak, each in stretches along it."""

    lane: Tensor  # [N] of each pixel
    stretch: Tensor  # [N]
    lanes: int
    stretches: int
    step: float  # along the path, ball radii

    @property
    def count(self) -> int:
        return self.lanes * self.stretches

    def sizes(self) -> Iterator[tuple[int, int]]:
        """Give how many of them larger cells may hold across and along, at most all."""
        wide, long = (
            sorted({min(n, most) for n in (*MERGED, most)}) for most in (self.lanes, self.stretches)
        )
        return itertools.product(wide, long)

    def merged(self, wide: int, long: int) -> tuple[Tensor, int]:
        """Give the number of the larger cell that each cell falls to, and how many there are."""
        number = torch.arange(self.count)
        lane, stretch = number // self.stretches // wide, number % self.stretches // long
        stretches = -(-self.stretches // long)
        return lane * stretches + stretch, -(-self.lanes // wide) * stretches


def _grid(fit: SweepFit) -> _Grid:
    passage, travel = fit.seen.coverage.passage, _travel(fit)
    half_width = float(outline(fit.model, fit.parameters)[1].mean())
    width = max(WIDTH, NARROWEST / half_width)
    gap = (1 - passage.room / fit.model.ball_radius**2).clamp(0, 1).sqrt() * passage.side
    lanes = max(1, round(2 / width))
    # the first and the last image of the ball reach a radius beyond the path's ends
    length = travel + 2
    stretches = max(1, round(length / max(LENGTH, NARROWEST / half_width)))
    along = (passage.instant * travel + length / 2) / length
    return _Grid(
        lane=((gap + 1) / 2 * lanes).long().clamp(0, lanes - 1),
        stretch=(along * stretches).long().clamp(0, stretches - 1),
        lanes=lanes,
        stretches=stretches,
        step=length / stretches,
    )


def _noisier(pixels: StreakPixels, factor: float) -> StreakPixels:
    beside = pixels.beside
    return replace(
        pixels,
        shot_variance=pixels.shot_variance * factor,
        ground_variance=pixels.ground_variance * factor,
        excess=pixels.excess * factor,
        beside=replace(
            beside,
            cost=beside.cost / factor,
            gradient=beside.gradient / factor,
            information=beside.information / factor,
        ),
    )


def _shares(fit: SweepFit) -> Tensor:
    """Give how much stronger marks are before each pixel than on a whole chord [N].

    A pixel shows the mean of all that passes it: the shorter the part of a chord that it sees, near
    the rims and at the streak's ends, the less the marks on it average out.
    """
    passage = fit.seen.coverage.passage
    height = passage.room.clamp_min(0).sqrt() / fit.model.ball_radius
    half = (passage.room.clamp_min(0) / passage.stiffness).sqrt().clamp_min(1e-9)
    first, last = fit.model.exposure_of(fit.pixels)
    start = ((passage.instant - last) / half).clamp(-1, 1)
    stop = ((passage.instant - first) / half).clamp(-1, 1)
    return (height * (stop - start) / 2).clamp_min(SHORTEST).rsqrt()


def _travel(fit: SweepFit) -> float:
    """Give how far the ball goes across the view, radii."""
    position, displacement = fit.state()
    view = torch.nn.functional.normalize(position, dim=0)
    across = displacement - (displacement @ view) * view
    return float(torch.linalg.vector_norm(across)) / fit.model.ball_radius


def _likeliest(sums: CellSums, fit: SweepFit) -> tuple[float, float]:
    """Give the least cost of cells of random light, and their strength."""
    steps = torch.linspace(math.log(WEAKEST), math.log(STRONGEST), STEPS).exp().tolist()
    return min((sums.cost(fit.seen, strength**2), strength) for strength in steps)
