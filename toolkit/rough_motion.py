"""The rough motion from which an exact fit starts where profiles say nothing.

A streak shorter than about two and a half widths has no profile that the ball's first and last
image leave alone, and one with a corner has none about it. The opacity is there all the same: it is
the mean of the discs that the ball covered. A path is fitted to it on blocks of pixels about a
sixth of the ball's radius wide.
[derived]
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.rough_fit import STEPS, RoughFit, fit_disc
from toolkit.rough_path import RoughPath
from toolkit.rough_pixels import Blocks, block_pixels
from toolkit.rough_starts import (
    arc_starts,
    corner_starts,
    extremes,
    flight_starts,
    straight_start,
)
from toolkit.types import Streak
from toolkit.view import StreakView

PATH_POINTS = 65
"""Instants at which the path is given."""
EVIDENCE = 30.0
"""By how much the squared residuals must fall for a path of more numbers."""
GAIN = 0.4
"""Share of what a simpler path leaves unexplained that a bent one must explain."""
WELL, MUCH = 0.5, 0.25
"""Unexplained per residual of a path that explains all, or share of it where nothing does."""
SHORTEST_ARM = 0.3
"""Ball radii."""
SMALLEST_TURN = math.radians(20)
FIRST_STEPS = 8
"""In which the most promising of several starts shows."""
LEAST_TRAVEL = 0.05
"""Ball radii: how far a still ball is said to travel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughMotion:
    """Where the ball went, to about a tenth of its radius."""

    path: Tensor  # [N, 3] m, at equal shares of the exposure from start to end
    corner: float | None  # share of the exposure, -0.5 to 0.5, at which the path turns a corner
    colour: Tensor | None  # [A] what the estimator leaves open of the ball's looks


def rough_motion(
    view: StreakView, estimator: AlphaEstimator, camera: Camera, ball_radius: float
) -> RoughMotion:
    """Find roughly how the ball moved, from the opacity of all pixels about its streak.

    Args:
        view: the streak and its surroundings.
        estimator: of the ball's opacity; what it leaves open is found too.
        camera: of the shot.
        ball_radius: m.

    Returns:
        RoughMotion of the branch that moves right in the picture, or down, or away.
    """
    blocks = block_pixels(view, camera)
    search = _Search(blocks=blocks, estimator=estimator, camera=camera, ball_radius=ball_radius)
    start = straight_start(view.streak, camera, ball_radius)
    found = search.simplest(start, view.streak)
    path = found.path.at(torch.linspace(-0.5, 0.5, PATH_POINTS).double())
    path, corner = _lengthened(path, ball_radius), found.path.corner
    if not _runs_forward(path, camera):
        path, corner = path.flip(0), None if corner is None else -corner
    return RoughMotion(path=path, corner=corner, colour=found.colour)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    """For the path that explains the opacity: straight, an arc, or one with a corner."""

    blocks: Blocks
    estimator: AlphaEstimator
    camera: Camera
    ball_radius: float

    def simplest(self, start: RoughPath, streak: Streak) -> RoughFit:
        """Give the simplest path beside which no other explains clearly more."""
        straight = self.fit(start)
        distance = float(torch.linalg.vector_norm(start.coefficients[0]))
        places = extremes(streak, self.camera, distance)
        flight, bounced = flight_starts(self.blocks, streak, distance, self.camera)
        arc = self.best([*arc_starts(straight.path, places), flight])
        simpler = arc if _explains_more(arc, straight) else straight
        corner = self.best(corner_starts(arc.path, places))
        if not _explains_more(corner, simpler) and simpler.excess < WELL * simpler.count:
            return simpler
        accelerated = self.best([corner.path.accelerated(), bounced])
        corner = accelerated if accelerated.cost < corner.cost - EVIDENCE / 2 else corner
        if not _explains_more(corner, simpler):
            return simpler
        return corner if _has_corner(corner.path, self.ball_radius) else simpler

    def best(self, starts: list[RoughPath]) -> RoughFit:
        """Search from where a few steps lead farthest down."""
        first = [self.fit(start, steps=FIRST_STEPS) for start in starts]
        return self.fit(min(first, key=lambda fit: fit.cost).path)

    def fit(self, start: RoughPath, steps: int = STEPS) -> RoughFit:
        """Fit one path."""
        return fit_disc(
            self.blocks, self.estimator, self.camera, start, self.ball_radius, steps=steps
        )


def _explains_more(bent: RoughFit, simpler: RoughFit) -> bool:
    """Whether a path explains so much more that it is not only a ball that looks otherwise."""
    if simpler.cost - bent.cost < max(EVIDENCE, GAIN * simpler.excess):
        return False
    return bent.excess < WELL * bent.count or bent.excess < MUCH * simpler.excess


def _has_corner(path: RoughPath, ball_radius: float) -> bool:
    """Whether both arms are long enough, and their directions different enough, to tell of one."""
    corner = path.corner or 0.0
    sight = torch.nn.functional.normalize(path.coefficients[0], dim=0)
    velocities = path.coefficients[1:3] - (path.coefficients[1:3] @ sight)[:, None] * sight
    arms = torch.linalg.vector_norm(velocities, dim=-1) * torch.tensor([corner + 0.5, 0.5 - corner])
    along = torch.nn.functional.normalize(velocities, dim=-1)
    turn = float((along[0] @ along[1]).clamp(-1, 1).acos())
    return float(arms.min()) > SHORTEST_ARM * ball_radius and turn > SMALLEST_TURN


def _lengthened(path: Tensor, ball_radius: float) -> Tensor:
    """Let a path of hardly any length have a little, to the right in the picture."""
    shortest = LEAST_TRAVEL * ball_radius
    if float(torch.linalg.vector_norm(path[-1] - path[0])) >= shortest:
        return path
    share = torch.linspace(-0.5, 0.5, len(path), dtype=path.dtype)
    right = torch.tensor([shortest, 0.0, 0.0], dtype=path.dtype)
    return path.mean(0) + share[:, None] * right


def _runs_forward(path: Tensor, camera: Camera) -> bool:
    """Whether a path runs right in the picture, or down where it is upright, or away."""
    dx, dy = (camera.project(path[-1]) - camera.project(path[0])).tolist()
    if max(abs(dx), abs(dy)) > 0:
        return bool(dx > 0 if abs(dx) > 1e-6 * abs(dy) else dy > 0)
    return float(path[-1, 2] - path[0, 2]) >= 0
