"""The most likely motion: all pixels of the streak at once, coarse squares of them first."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.least_squares import invert_information
from toolkit.sweep.inside import far_from_rims
from toolkit.sweep.likelihood import Comparison, compare
from toolkit.sweep.model import SweepModel
from toolkit.sweep.pixels import Frame, StreakPixels
from toolkit.sweep.squares import Squares

MAX_STEPS = 40
SETTLED = 0.05
"""Chi-square that a further step may promise: shared among a dozen numbers, each then lies within a
tenth of a standard deviation of the most likely one."""
UNSEEN = 80.0
"""Times the tolerance that the last step may promise, whose end is not looked at."""
ROUGHLY = 0.5
"""The same on coarse squares."""
FIRST_DAMPING = 1e-4
SMALLEST_SPREAD = 0.02
LARGEST_SPREAD = 9.0
"""px^2, of lens and pixel; the pixel's own area counts for 1/12."""
MOST_PIXELS = 400_000
"""Compared one by one; of a larger streak squares are, which lose next to nothing there."""
WIDE, WIDEST = 8.0, 8
"""Squares to the half width far inside the streak, and px of the largest of them."""
PATH_POINTS = 33
SPAN_STEPS = 12
LONGEST_DELAY = 3.0
"""Exposures by which rows that see the ball may be later or earlier than the middle one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepFit:
    """The most likely motion of one kind of path."""

    model: SweepModel
    parameters: Tensor  # [P]
    pixels: StreakPixels
    seen: Comparison  # at the last look, one small step before
    converged: bool
    iterations: int
    promised: float = 0.0  # chi-square that this last step saves
    contraction: float = 1.0  # what a step promises, over what the one before it did

    @property
    def cost(self) -> float:
        """What the misfit of the parameters costs."""
        return self.seen.cost - self.promised

    @property
    def covariance(self) -> Tensor:
        """Cramer-Rao bound of all parameters [P, P]; infinite where nothing is known."""
        return invert_information(self.seen.information[None])[0]

    @property
    def path_covariance(self) -> Tensor:
        """That of the path alone [K, K]."""
        k = self.model.path.size
        return self.covariance[:k, :k]

    def state(self, time: float = 0.0) -> tuple[Tensor, Tensor]:
        """Give position and displacement per exposure at a time, exposures from the middle."""
        arcs = self.model.path.arcs(self.parameters[: self.model.path.size])
        position, displacement = arcs.at(torch.tensor([time], dtype=torch.float64))
        return position[0], displacement[0]


def fit_sweep(
    model: SweepModel,
    start: Tensor,
    frame: Frame,
    *,
    side: int = 1,
    doubt: float = 0.0,
    contrast: float | None = None,
    contraction: float = 1.0,
    most_steps: int | None = None,
) -> SweepFit:
    """Find the most likely parameters, all pixels compared or squares of them.

    Args:
        model: of the streak.
        start: parameters to search from [P].
        frame: the window about the streak.
        side: of the squares, px.
        doubt: px by which the start may be off.
        contrast: of ball and ground, light. Where it is told and single pixels are compared,
            squares stand for those far inside the streak, which loses next to nothing.
        contraction: what a step promises over what the one before it did, where that is known.
        most_steps: after which the search gives up.
    """
    path_px, half_width = outline(model, start)
    side = max(side, _least_side(path_px, half_width))
    wide = None
    if side == 1 and contrast is not None and not model.row_delay:
        wide = _wide_squares(model, start, frame, doubt, contrast)
    pixels = frame.about(path_px, half_width, side=side, doubt=doubt, wide=wide)
    # how the lens mixes rim and ground hangs so little on the path that the start tells it
    covered = model.opacity(start, pixels)
    slope = model.opacity_slope(start, pixels, covered)
    pixels = pixels.behind_lens(slope, float(start[model.path.size]))
    seen = compare(model, start, pixels, covered=covered)
    tolerance = SETTLED if side == 1 else ROUGHLY
    return search(
        model,
        start,
        pixels,
        seen,
        tolerance=tolerance,
        contraction=contraction,
        most_steps=most_steps,
    )


def search(
    model: SweepModel,
    start: Tensor,
    pixels: StreakPixels,
    seen: Comparison,
    *,
    tolerance: float,
    contraction: float = 1.0,
    most_steps: int | None = None,
) -> SweepFit:
    """Search by damped Gauss-Newton steps from what is seen until no next one is worth a look.

    Near the end each step promises a known small share of what the one before did: where that is
    less than the tolerance, the last step is taken, and what it leads to is not looked at.
    """
    x, damping, promised, last = start, FIRST_DAMPING, 0.0, math.inf
    converged, iterations, k = False, 0, model.path.size
    most_steps = MAX_STEPS if most_steps is None else most_steps
    while iterations < most_steps:
        step, gain = seen.step(damping)
        least, most = SMALLEST_SPREAD - float(x[k]), LARGEST_SPREAD - float(x[k])
        if not least <= float(step[k]) <= most:
            bounded = min(max(float(step[k]), least), most)
            step, gain = seen.step(damping, held=(k, bounded))
        if last < math.inf:
            contraction = min(max(gain, 0.0) / last, 1.0)
        is_possible = _is_in_front(model, x + step)
        if gain < UNSEEN * tolerance and gain * contraction < tolerance:
            converged = math.isfinite(seen.cost)
            if converged and is_possible:
                x, promised = x + step, gain
            break
        iterations += 1
        trial = compare(model, x + step, pixels) if is_possible else None
        if trial is not None and trial.cost <= seen.cost:
            x, seen, damping, last = x + step, trial, damping * 0.1, gain
        else:
            damping, last, contraction = max(damping * 10, 1e-2), math.inf, 1.0
    return SweepFit(
        model=model,
        parameters=x,
        pixels=pixels,
        seen=seen,
        converged=converged,
        iterations=iterations,
        promised=promised,
        contraction=contraction,
    )


def _least_side(path_px: Tensor, half_width: Tensor) -> int:
    """Give the side of the squares that a streak falls into, px: of a large one not single pixels.

    Args:
        path_px: [T, 2] px.
        half_width: [T] px.
    """
    steps = (path_px[1:] - path_px[:-1]).square().sum(-1).sqrt()
    area = ((half_width[1:] + half_width[:-1]) * steps).sum() + math.pi * half_width.max() ** 2
    return math.ceil(math.sqrt(float(area) / MOST_PIXELS))


def _wide_squares(
    model: SweepModel, x: Tensor, frame: Frame, doubt: float, contrast: float
) -> Squares | None:
    """Find squares that stand for their pixels: far from the ball's rims, before an even ground."""
    path_px, half_width = outline(model, x)
    side = min(WIDEST, int(float(half_width.min()) / WIDE))
    if side < 2:
        return None
    squares = frame.even_squares(path_px, half_width, side, contrast)
    if not len(squares):
        return None
    margin = side / math.sqrt(2) + doubt
    return squares[far_from_rims(model, x, frame.rays(squares), margin)]


def outline(model: SweepModel, x: Tensor) -> tuple[Tensor, Tensor]:
    """Give the path in the picture [T, 2] px and the half width of the ball on it [T], px.

    Where rows are read one after another it is the path while any row sees the ball.
    """
    points = _path_points(model, x)
    if not model.row_delay:
        return model.camera.project(points), half_widths(model, points)
    size = float(half_widths(model, points).max())
    span = (-0.5, 0.5)
    for _ in range(SPAN_STEPS):
        ends = _path_points(model, x, span)[[0, -1]]
        rows = model.camera.project(ends)[:, 1] - model.middle_row
        early, late = (model.row_delay * (rows + torch.tensor([-size, size]))).tolist()
        span = (max(early, -LONGEST_DELAY) - 0.5, min(late, LONGEST_DELAY) + 0.5)
    points = _path_points(model, x, span)
    return model.camera.project(points), half_widths(model, points)


def half_widths(model: SweepModel, points: Tensor) -> Tensor:
    """Give the half width of the ball's image at each point of a path [T], px."""
    focal = max(model.camera.fx, model.camera.fy)
    # seen askew a sphere's image is longer than wide
    distance = torch.linalg.vector_norm(points, dim=-1)
    sizes: Tensor = model.ball_radius * focal * distance / points[:, 2].clamp_min(1e-6) ** 2
    return sizes


def _is_in_front(model: SweepModel, x: Tensor) -> bool:
    """Whether the whole ball stays before the camera; behind it the equations hold as well."""
    return bool((_path_points(model, x)[:, 2] > model.ball_radius).all())


def _path_points(model: SweepModel, x: Tensor, span: tuple[float, float] = (-0.5, 0.5)) -> Tensor:
    arcs = model.path.arcs(x[: model.path.size])
    return arcs.at(torch.linspace(*span, PATH_POINTS, dtype=torch.float64))[0]
