"""Which path the streak asks for: straight, parabola, spline or bounce, each by its evidence."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.errors import StreakError
from toolkit.sweep.fit import SweepFit, fit_sweep, half_widths, outline
from toolkit.sweep.likelihood import compare
from toolkit.sweep.misfit import bulk_excess, look_for_misfit
from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import PARABOLA, STRAIGHT, BouncePath, SplinePath, SweepPath
from toolkit.sweep.pixels import Frame
from toolkit.sweep.shade import Shaded

EVIDENCE = 4.0
"""Chi-square that each further number must gain: three are added by chance once in a hundred."""
CLOSE = 0.15
"""Half widths to which a path must follow the start in the picture, lest the search begin too far
away. Depth and pace along a start are too rough to ask for a bend."""
PIECES = (2, 3, 4, 6, 8, 12)
"""Of the splines tried."""
STEPS_OF_RICHER = 15
"""In which a richer path must settle, which starts from the best of a simpler kind."""
SHORTEST_BEND = 2.0
"""Ball radii of travel from which a bend of the path is looked for."""
PROLONGED = 0.1
"""Share of its time by which a path is drawn longer where a start is held against it: the start's
ends are rough along the path."""
SAMPLES, DENSE = 65, 513
FINE, COARSE = 10.0, 7.0
"""Squares to the half width: where the path is chosen, and where a rough start is bettered."""
LARGEST_SQUARE = 6
"""px, where the path is chosen."""
STRAY = 0.35
"""Half widths by which a richer path may leave the one that some profiles told at first."""
MISFIT = 1.5
"""Excess of the squared misfit from which noise is taken to be as large as the misfit."""
SHADE_STD = 0.3
"""Prior standard deviation of a shade, over the mean signal of the streak."""
COLOURS = 3
"""Channels from which a signal is light, that a shade can change."""
DOUBT = 0.3
"""Half widths by which a rough start may be off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where the search begins."""

    path: Tensor  # [T, 3] m, from start to end of the exposure
    appearance: Tensor | None  # [A] of the estimator's unknowns
    span: tuple[float, float] = (-0.5, 0.5)  # times of the first and last point, exposures
    blur: float = 0.8  # px, of lens and pixel
    corner: float | None = None  # instant of a bounce
    is_close: bool = False  # to a px

    @property
    def time(self) -> Tensor:
        """When the ball was at each point [T], exposures from the middle."""
        return torch.linspace(*self.span, len(self.path), dtype=torch.float64)


def most_likely_motion(frame: Frame, model: SweepModel, start: Start) -> SweepFit:
    """Fit the simplest path that the start allows, and further ones while the picture asks.

    The path is chosen on squares of pixels, where that takes little time; the last fit compares
    every pixel.

    Args:
        frame: the window about the streak.
        model: its path is chosen here.
        start: of the search.
    """
    model = replace(model, path=_first_path(start, model))
    x = _first_parameters(model, start)
    half_width = float(outline(model, x)[1].max())
    if not half_width < max(frame.usable.shape):
        raise StreakError(
            "the rough motion leads out of the picture's window, so that the exact streak cannot "
            "start from it; name a region that holds the whole streak and little else"
        )
    fine = max(1, min(LARGEST_SQUARE, int(half_width / FINE)))
    sides = [fine] if start.is_close else _descending(int(half_width / COARSE), fine)
    for side in sides:
        doubt = DOUBT * half_width if side > fine else 2.0 * fine
        fit = fit_sweep(model, x, frame, side=side, doubt=doubt)
        x = fit.parameters
    excess = bulk_excess(fit.seen)
    if excess > MISFIT:
        frame = frame.noisier(excess)
        fit = fit_sweep(model, x, frame, side=fine, doubt=2.0 * fine)
    if not fit.converged:  # it leads nowhere
        return fit
    fit = _shaded_if_asked(fit, frame, fine)
    while (richer := _asked_for(fit)) is not None:
        trial = fit_sweep(*richer, frame, side=fine, doubt=2.0 * fine, most_steps=STEPS_OF_RICHER)
        if not trial.converged:
            break
        if strays(trial, start) > STRAY:
            break
        if _gain(fit, trial) < EVIDENCE * (trial.model.path.size - fit.model.path.size):
            break
        fit = trial
    if fine > 1:
        fit = fit_sweep(
            fit.model,
            fit.parameters,
            frame,
            doubt=1.0,
            contrast=_contrast(fit),
            contraction=fit.contraction,
        )
    return fit


def _contrast(fit: SweepFit) -> float:
    """Give how much ball and ground differ behind the streak: root mean square, light."""
    covered = fit.seen.coverage.alpha > 0
    ball = fit.model.colours(fit.parameters, fit.pixels, fit.seen.coverage).colour
    return float((ball - fit.pixels.ground)[:, covered].square().sum(0).mean().sqrt())


def strays(fit: SweepFit, start: Start) -> float:
    """Give by how many half widths the path leaves a close start in the picture; else 0."""
    if not start.is_close:
        return 0.0
    shape = fit.parameters[: fit.model.path.size]
    points, _ = fit.model.path.arcs(shape).at(start.time)
    camera = fit.model.camera
    apart = torch.cdist(camera.project(points), camera.project(start.path)).amin(1)
    return float(apart.max() / outline(fit.model, fit.parameters)[1].max())


def strays_from_edges(fit: SweepFit, start: Start) -> float:
    """Give by how many half widths the edges leave a close start, at the median; else 0."""
    if not start.is_close:
        return 0.0
    camera = fit.model.camera
    points, _ = fit.model.path.arcs(fit.parameters[: fit.model.path.size]).at(start.time)
    apart = torch.cdist(camera.project(start.path), camera.project(points))
    nearest, index = apart.min(1)
    first, now = half_widths(fit.model, start.path), half_widths(fit.model, points)[index]
    moved = (nearest + (now - first).abs()) / torch.minimum(first, now)
    return float(moved.median())


def _descending(first: int, last: int) -> list[int]:
    """Give sides of squares, each about half of the one before."""
    sides = [max(first, last)]
    while sides[-1] > last:
        sides.append(max(sides[-1] // 2, last))
    return sides


def _first_parameters(model: SweepModel, start: Start) -> Tensor:
    shape = model.path.through(start.time, start.path)
    spread = torch.tensor([max(start.blur, 0.3) ** 2], dtype=torch.float64)
    looks = shape.new_zeros(0)
    if model.unknowns and start.appearance is not None:
        looks = start.appearance.double()
    neutral = torch.cat([torch.ones(model.channels), torch.zeros(model.channels)]).double()
    return torch.cat([shape, spread, looks, neutral])


def _shaded_if_asked(fit: SweepFit, frame: Frame, side: int) -> SweepFit:
    """Let the ball be shaded where the whole streak misses alike, and the picture gains by it."""
    model = fit.model
    misfit = look_for_misfit(fit)
    if not misfit.significant or model.channels < COLOURS:
        return fit
    bright = float(fit.pixels.signal[:, fit.seen.coverage.alpha > 0].abs().mean())
    shaded = replace(model, shade_std=SHADE_STD * bright)
    trial = _with_shade(shaded, model.estimator, fit, frame, side)
    new = trial.model.unknowns - model.unknowns
    # what the rest of the streak misses alike is what such a shade is there for, at least in part
    left = look_for_misfit(trial)
    gain = _saved(fit, trial) / (max(left.pixels, 1.0) if misfit.is_common else left.factor)
    return trial if trial.converged and gain > EVIDENCE * new else fit


def finer_shade(fit: SweepFit, frame: Frame) -> SweepFit | None:
    """Fit a shade of twice as many terms; None where none was fitted at all."""
    estimator = fit.model.estimator
    if not isinstance(estimator, Shaded):
        return None
    frame = frame.noisier(fit.pixels.excess)
    return _with_shade(fit.model, estimator, fit, frame, 1)


def _with_shade(
    model: SweepModel, estimator: AlphaEstimator, fit: SweepFit, frame: Frame, side: int
) -> SweepFit:
    """Fit the same with a further shade over the ball, starting from none."""
    shaded = Shaded(
        estimator=estimator,
        channels=model.channels,
        powers=Shaded.powers_above(estimator),
        is_ahead=not isinstance(estimator, Shaded),
    )
    first = model.path.size + 1 + fit.model.unknowns
    none = torch.zeros(shaded.unknowns() - estimator.unknowns(), dtype=torch.float64)
    x = torch.cat([fit.parameters[:first], none, fit.parameters[first:]])
    model = replace(model, estimator=shaded)
    return fit_sweep(model, x, frame, side=side, doubt=2.0 * side)


def _first_path(start: Start, model: SweepModel) -> SweepPath:
    """Take the simplest path that follows the start."""
    paths: list[SweepPath] = [STRAIGHT, PARABOLA, *(SplinePath(2, n) for n in PIECES)]
    if start.corner is not None:
        paths = [BouncePath((start.corner,), is_accelerated=bends) for bends in (False, True)]
    seen, half_width = model.camera.project(start.path), half_widths(model, start.path)
    for path in paths:
        arcs = path.arcs(path.through(start.time, start.path))
        points = arcs.at(_prolonged(start))[0]
        points = points[points[:, 2] > model.ball_radius]
        if not len(points):
            continue
        gap = torch.cdist(seen, model.camera.project(points)).amin(1)
        if bool((gap < CLOSE * half_width).all()):
            return path
    return paths[-1]


def _prolonged(start: Start) -> Tensor:
    """Give times densely, from a little before the first point to a little after the last."""
    first, last = start.span
    more = PROLONGED * (last - first)
    return torch.linspace(first - more, last + more, DENSE, dtype=torch.float64)


def _asked_for(fit: SweepFit) -> tuple[SweepModel, Tensor] | None:
    """Find the richer path that a single step towards it promises most of, if any is worth it."""
    _, displacement = fit.state()
    if float(torch.linalg.vector_norm(displacement)) < SHORTEST_BEND * fit.model.ball_radius:
        return None
    best, promised = None, 0.0
    for path in _richer(fit.model.path, is_explained=fit.pixels.excess == 1):
        model = replace(fit.model, path=path)
        x = _carried(fit, path)
        seen = compare(model, x, fit.pixels)
        gain, price = seen.step()[1], EVIDENCE * (path.size - fit.model.path.size)
        if gain > price:  # misfit only makes less of it
            gain /= look_for_misfit(fit).factor
        if gain - price > promised:
            best, promised = (model, x), gain - price
    return best


def _richer(path: SweepPath, *, is_explained: bool) -> list[SweepPath]:
    """Give the paths to try next; what is not the path's fault asks for no more than a parabola."""
    if path == STRAIGHT:
        return [PARABOLA]
    if not is_explained:
        return []
    if isinstance(path, BouncePath):
        return [] if path.is_accelerated else [replace(path, is_accelerated=True)]
    pieces = path.pieces if isinstance(path, SplinePath) else PIECES[-1]
    finer: list[SweepPath] = [SplinePath(2, n) for n in PIECES if pieces < n]
    return finer[:2]


def _carried(fit: SweepFit, path: SweepPath) -> Tensor:
    """Give the parameters of another path that follows the one fitted."""
    old = fit.model.path
    time = torch.linspace(-0.5, 0.5, SAMPLES, dtype=torch.float64)
    shape = fit.parameters[: old.size]
    if isinstance(path, BouncePath):
        path = replace(path, instants=tuple(old.arcs(shape).joints.tolist()))
    points = old.arcs(shape).at(time)[0]
    return torch.cat([path.through(time, points), fit.parameters[old.size :]])


def _gain(fit: SweepFit, trial: SweepFit) -> float:
    """Chi-square that another fit saves on the same pixels, in units of the misfit that stays."""
    return _saved(fit, trial) / look_for_misfit(trial).factor


def _saved(fit: SweepFit, trial: SweepFit) -> float:
    """Chi-square that another fit saves on the same pixels."""
    return compare(fit.model, fit.parameters, trial.pixels).cost - trial.cost
