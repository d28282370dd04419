"""From a rough motion to the most likely one, with its uncertainty, its sign and its limits."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.errors import StreakError
from toolkit.measurement import Alternative, Sign, numbers
from toolkit.sweep.choose import Start, most_likely_motion
from toolkit.sweep.describe import SweepResult
from toolkit.sweep.doubt import motion_of, sweep_uncertainty
from toolkit.sweep.fit import SweepFit
from toolkit.sweep.misfit import look_for_misfit
from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import STRAIGHT
from toolkit.sweep.pixels import Frame
from toolkit.sweep.still import looks_still, speed_limit
from toolkit.types import LinearImage
from toolkit.view import StreakView

ASSUMED_EXPONENT_STD = 0.05
"""Standard deviation of the exponent of a response that was assumed from the kind of file."""
NAMED_EXPONENT_STD = 0.02
"""The same of one that somebody named: real cameras follow no curve exactly."""
DECIDED = 0.99
"""Probability from which the sign of the motion counts as decided."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shutter:
    """How the rows of the picture were exposed."""

    exposure: float | None  # s
    readout: float  # s from the first row's start to the last row's
    rows: int

    @property
    def row_delay(self) -> float:
        """Exposures from one row to the next."""
        if self.exposure is None or self.rows < 2:
            return 0.0
        return self.readout / (self.rows - 1) / self.exposure

    def time_of(self, row: float) -> float | None:
        """Time at which the middle of a row's exposure came, s from the first row's start."""
        if self.exposure is None:
            return None
        return row * self.row_delay * self.exposure + self.exposure / 2


def refine(
    view: StreakView,
    estimator: AlphaEstimator,
    camera: Camera,
    ball_radius: float,
    start: Start,
    shutter: Shutter,
    *,
    ball_radius_std: float = 0.0,
    exposure_std_share: float = 0.0,
) -> SweepResult:
    """Find the motion that makes the streak most likely.

    Args:
        view: the streak's surroundings.
        estimator: of the ball's looks.
        camera: distortion included.
        ball_radius: m.
        start: of the search.
        shutter: when each row was exposed.
        ball_radius_std: m.
        exposure_std_share: standard deviation of the exposure over itself.

    Raises:
        StreakError: when the search does not settle.
    """
    frame = Frame.of(view, estimator, camera)
    middle_row = float(camera.project(start.path[len(start.path) // 2])[1])
    model = SweepModel(
        path=STRAIGHT,
        estimator=estimator,
        camera=camera,
        ball_radius=ball_radius,
        row_delay=shutter.row_delay,
        middle_row=middle_row,
    )
    fit, sign = _both_ways(frame, model, start, shutter)
    if not fit.converged:
        raise StreakError(
            "the exact streak does not settle on one motion; "
            "measure with --stage contours, or name a region that holds the whole streak"
        )
    misfit = look_for_misfit(fit)
    change = _response_change(view, estimator, frame, fit)
    uncertainty = sweep_uncertainty(
        fit,
        misfit,
        ball_radius_std=ball_radius_std,
        exposure_std_share=exposure_std_share,
        response_change=change,
    )
    return SweepResult(
        fit=fit,
        misfit=misfit,
        uncertainty=uncertainty,
        sign=sign,
        still_below=speed_limit(fit, misfit) if looks_still(fit, misfit) else None,
        state_time=shutter.time_of(middle_row) if shutter.row_delay else None,
    )


def _both_ways(
    frame: Frame, model: SweepModel, start: Start, shutter: Shutter
) -> tuple[SweepFit, Sign | None]:
    """Fit one motion, or where rows were read out one after another both, and keep the likelier."""
    if not shutter.row_delay:
        return most_likely_motion(frame, model, start), None
    fits = [most_likely_motion(frame, model, _delayed(start, model, sign)) for sign in (1.0, -1.0)]
    fits.sort(key=lambda fit: fit.seen.cost)
    best, other = fits
    odds = math.exp(min((other.seen.cost - best.seen.cost) / 2, 700.0))
    probability = odds / (1 + odds)
    motion = motion_of(other)
    reverse = Alternative(
        direction=numbers(torch.nn.functional.normalize(motion.displacement, dim=0)),
        velocity_m_s=None
        if shutter.exposure is None
        else numbers(motion.displacement / shutter.exposure),
        probability=1 - probability,
    )
    is_decided = probability >= DECIDED
    return best, Sign(
        ambiguous=not is_decided,
        probability=probability,
        cue="readout" if is_decided else None,
        alternatives=(reverse,),
    )


def _delayed(start: Start, model: SweepModel, sign: float) -> Start:
    """Say when the ball was where on its path, one way or the other, as its rows were exposed."""
    rows = model.camera.project(start.path[[0, -1]])[:, 1]
    delay = model.row_delay * (rows - model.middle_row)
    first, last = (delay + sign * torch.tensor([-0.5, 0.5], dtype=torch.float64)).tolist()
    if last < first:
        return replace(start, span=(last, first), path=start.path.flip(0))
    return replace(start, span=(first, last))


def _response_change(
    view: StreakView, estimator: AlphaEstimator, frame: Frame, fit: SweepFit
) -> Tensor | None:
    """Give how the pixels change [Q, N] for one standard deviation of the response's exponent."""
    std = _exponent_std(view.shot)
    if std == 0:
        return None
    shot, empty = (_with_exponent(picture, 1 + std) for picture in (view.shot, view.background))
    other = estimator.observe(shot, empty, view.noise)
    x, y = (fit.pixels.place - torch.tensor(frame.corner)).long().mT
    signal, ground = other.signal[0][:, y, x], other.ground[0][:, y, x]
    rest = 1 - fit.seen.coverage.alpha
    return (signal - fit.pixels.signal) - rest * (ground - fit.pixels.ground)


def _exponent_std(shot: LinearImage) -> float:
    if shot.response_is_assumed:
        return ASSUMED_EXPONENT_STD
    return 0.0 if shot.response == "linear" else NAMED_EXPONENT_STD


def _with_exponent(picture: LinearImage, exponent: float) -> LinearImage:
    light = picture.recorded
    return picture.remade(light.clamp_min(0) ** exponent)
