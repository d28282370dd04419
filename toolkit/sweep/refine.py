"""From a rough motion to the most likely one, with its uncertainty, its sign and its limits."""

import math
from dataclasses import dataclass, replace

import torch

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.errors import StreakError
from toolkit.measurement import Alternative, Sign, numbers
from toolkit.sweep.choose import (
    COLOURS,
    Start,
    finer_shade,
    most_likely_motion,
    strays,
    strays_from_edges,
)
from toolkit.sweep.describe import SweepResult
from toolkit.sweep.doubt import motion_of, sweep_uncertainty
from toolkit.sweep.fit import LARGEST_SPREAD, SweepFit, outline
from toolkit.sweep.likelihood import compare
from toolkit.sweep.linearity import judge_linearity, response_changes
from toolkit.sweep.marks import STRONGEST, MarkedFit, fit_with_marks
from toolkit.sweep.misfit import Misfit, is_noise, look_for_misfit, with_coarse_misfit
from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import STRAIGHT
from toolkit.sweep.pixels import Frame
from toolkit.sweep.relight import JointLight, joint_light
from toolkit.sweep.shade import Shaded
from toolkit.sweep.still import looks_still, speed_limit
from toolkit.view import StreakView

UNEXPLAINED = 10.0
"""Squared misfit over noise from which the exact image is not that of the ball."""
OTHER_COLOUR = 14.0
"""Squared misfit of all the streak alike, over that of its pixels, of another colour than known."""
SOFTEST = 0.95 * LARGEST_SPREAD
"""px^2, of lens and pixel: what is softer is no rim of a ball."""
STRAYED, STRAYED_EDGES = 0.5, 0.35
"""Half widths by which the likeliest path may leave the one that some profiles told at first, and
by which its edges may at the median."""
RELIGHTINGS = 2
"""Fits in a light that the streak itself corrected, at most."""
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

    def delay_of(self, row: float) -> float:
        """Time by which a row was exposed later than the first, s."""
        return row * self.row_delay * (self.exposure or 0.0)


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
    middle_row = float(camera.project(start.path[[0, -1]].mean(0))[1])
    model = SweepModel(
        path=STRAIGHT,
        estimator=estimator,
        camera=camera,
        ball_radius=ball_radius,
        row_delay=shutter.row_delay,
        middle_row=middle_row,
    )
    fit, sign, light = _in_likeliest_light(frame, model, start, shutter)
    if not fit.converged:
        raise StreakError(
            "the exact streak does not settle on one motion; "
            "measure with --stage contours, or name a region that holds the whole streak"
        )
    misfit = with_coarse_misfit(look_for_misfit(fit), fit)
    linearity = judge_linearity(view, fit, misfit.factor)
    still_below = speed_limit(fit, misfit) if looks_still(fit, misfit) else None
    marked = None
    if misfit.significant and still_below is None and _is_light(fit.model):
        marked = None if is_noise(fit, misfit, frame) else fit_with_marks(fit, frame)
    if marked is None:
        _check_explained(fit, misfit, start)
    else:
        _check_marks(marked)
        _check_explained(marked.fit, marked.left, start)
    finer = finer_shade(fit, frame)
    others = () if finer is None or not finer.converged else (finer,)
    if marked is not None:
        fit, misfit, others = marked.fit, marked.left, (*marked.others, *others)
    uncertainty = sweep_uncertainty(
        fit,
        misfit,
        others=others,
        light=light,
        ball_radius_std=ball_radius_std,
        exposure_std_share=exposure_std_share,
        response_changes=response_changes(view, estimator, frame, fit, linearity),
    )
    return SweepResult(
        fit=fit,
        misfit=misfit,
        marked=marked,
        linearity=linearity,
        uncertainty=uncertainty,
        sign=sign,
        still_below=still_below,
        delay=shutter.delay_of(middle_row),
    )


def _is_light(model: SweepModel) -> bool:
    """Say whether the signal is light, that marks on the ball change."""
    return model.channels >= COLOURS


def _check_marks(marked: MarkedFit) -> None:
    """Raise `StreakError` where even with marks on it no ball explains the streak."""
    spread = float(marked.fit.parameters[marked.fit.model.path.size])
    if not marked.fit.converged or spread > SOFTEST or marked.marks.strength >= STRONGEST:
        raise StreakError(
            "not even a ball with marks on it explains the streak: its rim or its light is too "
            "uneven; another estimator may suit the ball, and --estimator auto tries all"
        )


def _check_explained(fit: SweepFit, misfit: Misfit, start: Start) -> None:
    """Raise `StreakError` where the picture is of something else, or the path ran away."""
    miss = misfit.pixels * fit.pixels.excess
    if miss > UNEXPLAINED:
        raise StreakError(
            f"no motion of such a ball explains the streak: {miss:.1f} times the noise is left "
            "(a pattern, light that changes along the path, a changed background); another "
            "estimator may suit the ball, and --estimator auto tries all"
        )
    if misfit.lanes > OTHER_COLOUR and _shows_known_colour(fit.model):
        raise StreakError(
            "the ball does not show the one colour it is known by: all of the streak misses it "
            f"alike, by {misfit.lanes:.0f} times what single pixels tell; take its colour where it "
            "flies, or leave it open"
        )
    strayed, at_edges = strays(fit, start), strays_from_edges(fit, start)
    if strayed > STRAYED or at_edges > STRAYED_EDGES:
        raise StreakError(
            "the exact streak runs away from its profiles, by "
            f"{max(strayed, at_edges):.1f} half widths; "
            "something else than the ball may lie beside it"
        )


def _shows_known_colour(model: SweepModel) -> bool:
    """Say whether the ball was held to one colour that was given, with a shade over it or not."""
    ball = model.estimator
    if not isinstance(ball, Shaded):
        return model.is_plain and not model.unknowns
    return model.is_laned and model.unknowns == ball.shades and not ball.is_recoloured


def _in_likeliest_light(
    frame: Frame, model: SweepModel, start: Start, shutter: Shutter
) -> tuple[SweepFit, Sign | None, JointLight | None]:
    """Fit the motion, and the light with it where that is known with errors alone."""
    told = model.estimator
    fit, sign = _both_ways(frame, model, start, shutter)
    loose = told.loosened()
    if loose is None or not fit.converged:
        return fit, sign, None
    light = joint_light(fit, loose, torch.zeros(loose.unknowns(), dtype=torch.float64))
    for _ in range(RELIGHTINGS):
        if light.is_settled:
            break
        amounts = light.amounts + light.step
        lit = replace(model, estimator=told.relit(amounts))
        trial, its_sign = _both_ways(frame, lit, start, shutter)
        if not trial.converged:
            break
        fit, sign, light = trial, its_sign, joint_light(trial, loose, amounts)
    return fit, sign, light


def _both_ways(
    frame: Frame, model: SweepModel, start: Start, shutter: Shutter
) -> tuple[SweepFit, Sign | None]:
    """Fit one motion, or where rows were read out one after another both, and keep the likelier."""
    if not shutter.row_delay:
        return most_likely_motion(frame, model, start), None
    fits = [most_likely_motion(frame, model, _delayed(start, model, sign)) for sign in (1.0, -1.0)]
    lead = _lead(fits[0], fits[1], frame)
    best, other = fits if lead >= 0 else fits[::-1]
    odds = math.exp(min(abs(lead) / 2, 700.0))
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


def _lead(first: SweepFit, second: SweepFit, frame: Frame) -> float:
    """Give the chi-square by which one fit beats another, all pixels of either compared."""
    outlines = [outline(fit.model, fit.parameters) for fit in (first, second)]
    (middle, size), (other_middle, other_size) = outlines
    middle, size = torch.cat([middle, other_middle.flip(0)]), torch.cat([size, other_size.flip(0)])
    pixels = frame.noisier(first.pixels.excess).about(middle, size)
    costs = [compare(fit.model, fit.parameters, pixels).cost for fit in (first, second)]
    return (costs[1] - costs[0]) / look_for_misfit(first).factor


def _delayed(start: Start, model: SweepModel, sign: float) -> Start:
    """Say when the ball was where on its path, one way or the other, as its rows were exposed."""
    rows = model.camera.project(start.path[[0, -1]])[:, 1]
    delay = model.row_delay * (rows - model.middle_row)
    first, last = (delay + sign * torch.tensor([-0.5, 0.5], dtype=torch.float64)).tolist()
    if last < first:
        return replace(start, span=(last, first), path=start.path.flip(0))
    return replace(start, span=(first, last))
