"""The most likely motion: all pixels of the streak at once, from coarse squares to single pixels."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.least_squares import invert_information, minimise_equations
from toolkit.sweep.model import Comparison, SweepModel, compare
from toolkit.sweep.opacity import PIXEL_VARIANCE
from toolkit.sweep.pixels import Frame, StreakPixels

COARSE_HALF_WIDTH = 8.0
"""Half width of the streak on the coarsest squares, px."""
MAX_STEPS = 40
TOLERANCE = 0.02
"""Standard deviations that a step may leave undone."""
SMALLEST_SPREAD = 0.02
LARGEST_SPREAD = 30.0
"""px^2, of lens and pixel; the pixel's own area counts for 1/12."""
PATH_POINTS = 33


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepFit:
    """The most likely motion of one kind of path."""

    model: SweepModel
    parameters: Tensor  # [P]
    pixels: StreakPixels
    seen: Comparison
    converged: bool
    iterations: int

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


def first_parameters(model: SweepModel, shape: Tensor, blur: float, looks: Tensor | None) -> Tensor:
    """Put together where a search starts: the path's parameters [K], blur in px, appearance [A]."""
    channels = len(_gains(model))
    spread = torch.tensor([blur**2 + PIXEL_VARIANCE], dtype=torch.float64)
    known = shape.new_zeros(0) if looks is None or not model.unknowns else looks.double()
    return torch.cat([shape, spread, known, torch.ones(channels), torch.zeros(channels)]).double()


def _gains(model: SweepModel) -> range:
    from toolkit.sweep.colours import _middle  # noqa

    return range(
        model.estimator.foreground(
            _middle(), torch.zeros(model.unknowns) if model.unknowns else None
        ).shape[-1]
    )


def fit_sweep(
    model: SweepModel,
    start: Tensor,
    frame: Frame,
    *,
    is_close: bool,
    steps: int = MAX_STEPS,
) -> SweepFit:
    """Find the most likely parameters.

    Args:
        model: of the streak.
        start: parameters to search from [P].
        frame: the window about the streak.
        is_close: whether the start is good to a px; else squares of pixels are compared first.
        steps: of each search, at most.
    """
    x, iterations = start, 0
    _, half_width = outline(model, x)
    side = 1 if is_close else max(1, int(half_width / COARSE_HALF_WIDTH))
    while True:
        path_px, half_width = outline(model, x)
        pixels = frame.about(path_px, half_width, side)
        solution = _search(model, x, pixels, steps)
        x, iterations = solution[0], iterations + solution[2]
        if side == 1:
            break
        side //= 2
    return SweepFit(
        model=model,
        parameters=x,
        pixels=pixels,
        seen=compare(model, x, pixels),
        converged=solution[1],
        iterations=iterations,
    )


def _search(
    model: SweepModel, start: Tensor, pixels: StreakPixels, steps: int
) -> tuple[Tensor, bool, int]:
    lower = torch.full_like(start, -torch.inf)
    upper = torch.full_like(start, torch.inf)
    k = model.path.size
    lower[k], upper[k] = SMALLEST_SPREAD, LARGEST_SPREAD

    def equations(x: Tensor, _: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        seen = compare(model, x[0], pixels)
        return torch.tensor([seen.cost]).double(), seen.gradient[None], seen.information[None]

    solution = minimise_equations(
        equations,
        start[None],
        lower=lower,
        upper=upper,
        max_iterations=steps,
        tolerance=TOLERANCE,
    )
    return solution.parameters[0], bool(solution.converged[0]), solution.iterations


def outline(model: SweepModel, x: Tensor) -> tuple[Tensor, float]:
    """Give the path in the picture [T, 2] px and the largest half width of the ball on it, px."""
    arcs = model.path.arcs(x[: model.path.size])
    points, _ = arcs.at(torch.linspace(-0.5, 0.5, PATH_POINTS, dtype=torch.float64))
    focal = max(model.camera.fx, model.camera.fy)
    # seen askew a sphere's image is longer than wide
    distance = torch.linalg.vector_norm(points, dim=-1)
    size = model.ball_radius * focal * distance / points[:, 2].clamp_min(1e-6) ** 2
    return model.camera.project(points), float(size.max())
