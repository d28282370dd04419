"""From one blurred picture to the ball's motion: the whole method, in the order of the paper."""

import math
import time
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.background import check_pair
from toolkit.camera import Camera
from toolkit.camera_file import fit_camera
from toolkit.contours import smooth_contours
from toolkit.errors import BadOutputError, ConfigError, StreakError
from toolkit.following import Reconstruction, follow_motion
from toolkit.guarded import guarded
from toolkit.light_change import light_caution
from toolkit.measurement import Caution, Measurement
from toolkit.motion import DEPTH, Motion
from toolkit.reconstruction import check_rays, reconstruct_axis
from toolkit.registry import name_of
from toolkit.result import describe, describe_profiles, profile_table
from toolkit.rough_motion import rough_motion
from toolkit.shot_checks import check_readout
from toolkit.sketch import sketch_motion, smooth_edges
from toolkit.streak import ROI
from toolkit.streak_fit import ManyColours, fit_roughly, fit_streak, settled
from toolkit.sweep.choose import Start
from toolkit.sweep.describe import describe_sweep
from toolkit.sweep.doubt import motion_of
from toolkit.sweep.refine import Shutter, refine
from toolkit.types import LinearImage, ProfileFit
from toolkit.uncertainty import Uncertainty, covariances
from toolkit.view import StreakView, observe_streak

STAGES = ("profiles", "contours", "sweep")
"""Of a measurement, each starting from the one before."""
TRACEABLE = 2.8
"""Length over width from which profiles between the ball's first and last image are looked for."""
CORNER = math.radians(25)
"""Turn of the rough axis over two half widths from which the path may have a corner."""
LOST_DEPTH = 1.0
"""Relative standard deviation of the depth from which nothing is known of it."""

READOUT_LEFT_OUT = Caution(
    code="readout-left-out",
    message="the contours know nothing of the readout: direction and speed are those of a picture "
    "whose rows were all exposed at once; take --stage sweep",
)


def measure(
    image: LinearImage,
    background: LinearImage,
    *,
    camera: Camera,
    ball_radius: float,
    estimator: AlphaEstimator,
    exposure: float | None = None,
    ball_radius_std: float = 0.0,
    exposure_std: float = 0.0,
    roi: ROI | None = None,
    stage: str = "sweep",
    readout: float = 0.0,
) -> Measurement:
    """Measure position, direction, speed and path of the ball in one motion-blurred picture.

    Source: Caglioti & Giusti 2007, section 5. Deviations: each stage's module names its own; the
    streak's ends, which the paper leaves out, place the ball along its path.

    Args:
        image: the shot, linear light, B = 1.
        background: the same view without the ball.
        camera: of the same sensor; a known crop or scale is followed.
        ball_radius: m.
        estimator: how this kind of ball is told from its background.
        exposure: s; None leaves the speed open.
        ball_radius_std: standard deviation of the radius, m.
        exposure_std: of the exposure, s.
        roi: left, top, width, height in px to search in.
        stage: the last one, of STAGES.
        readout: s from the start of the first row's exposure to that of the last row's.

    Returns:
        Measurement of the branch that moves right in the picture, or down, or away; the other sign
        is listed beside it.

    Raises:
        ConfigError: when a number is not positive and finite, or the region lies outside.
        MismatchError: when camera, background and shot do not fit together.
        StreakError: when no trustworthy measurement is possible, with the reason.
        BadOutputError: when the estimator breaks, or gives what cannot be.
    """
    _check_numbers(ball_radius, ball_radius_std, exposure, exposure_std, readout)
    _check_stage(stage)
    check_pair(image, background)
    camera = fit_camera(camera, image)
    name, estimator = name_of(type(estimator)), guarded(estimator).seen_through(camera)
    watch = Stopwatch()

    view = observe_streak(image, background, estimator, roi)
    watch.lap("streak")
    task = Task(
        view=view,
        estimator=estimator,
        camera=camera,
        ball_radius=ball_radius,
        ball_radius_std=ball_radius_std,
        exposure=exposure,
        exposure_std_share=exposure_std / exposure if exposure else 0.0,
        shutter=Shutter(exposure=exposure, readout=readout, rows=image.height),
        size=(image.width, image.height),
        watch=watch,
    )
    result = {"profiles": by_profiles, "contours": by_contours, "sweep": by_sweep}[stage](task)
    doubts = (Caution(code=code, message=text) for code, text in estimator.doubts().items())
    return replace(
        result, estimator=name, timing_s=watch.seconds, warnings=(*result.warnings, *doubts)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """All that is given, the streak found in it."""

    view: StreakView
    estimator: AlphaEstimator
    camera: Camera
    ball_radius: float  # m
    ball_radius_std: float  # m
    exposure: float | None  # s
    exposure_std_share: float
    shutter: Shutter
    size: tuple[int, int]  # of the picture, px
    watch: "Stopwatch"


def by_profiles(task: Task) -> Measurement:
    """Stop at the profiles across the streak, before any camera."""
    fit, _ = fit_streak(task.view, task.estimator)
    contours, fit = smooth_contours(fit)
    task.watch.lap("profiles")
    return describe_profiles(fit, contours, drift=task.view.drift)


def by_contours(task: Task) -> Measurement:
    """Follow the paper: profiles, contours, the canal surface, and the motion along its axis."""
    found, cautions = follow_contours(task)
    if task.shutter.row_delay:
        cautions = (*cautions, READOUT_LEFT_OUT)
    return report_contours(task, found, cautions)


def by_sweep(task: Task) -> Measurement:
    """Find the motion whose exact image is the likeliest, starting from what is known roughly.

    Where no motion's image explains the streak, what its contours say is reported instead.
    """
    check_rays(task.camera, task.view.streak.axis)
    rough, refusal = None, None
    if _length_in_widths(task.view) >= TRACEABLE and not _turns_corner(task.view):
        try:
            rough = sketch(task)
        except StreakError as error:  # too few profiles, or a corner: both can be done without
            refusal = error
    try:
        likeliest = refine(
            task.view,
            task.estimator,
            task.camera,
            task.ball_radius,
            rough_start(task) if rough is None else close_start(*rough),
            task.shutter,
            ball_radius_std=task.ball_radius_std,
            exposure_std_share=task.exposure_std_share,
        )
    except StreakError as error:
        return contours_instead(task, refusal or error)
    _check_depth(motion_of(likeliest.fit), likeliest.uncertainty)
    task.watch.lap("sweep")
    return describe_sweep(
        likeliest,
        exposure=task.exposure,
        drift=task.view.drift,
        profiles=None if rough is None else profile_table(rough[0]),
    )


def sketch(task: Task) -> tuple[ProfileFit, Motion]:
    """Find some profiles, and roughly the motion they tell: the exact streak needs no better."""
    fit = fit_roughly(task.view, task.estimator)
    _check_inside(smooth_edges(fit), task.size)
    task.watch.lap("profiles")
    motion = sketch_motion(fit, task.camera, task.ball_radius)
    task.watch.lap("motion")
    return fit, motion


def contours_instead(task: Task, reason: StreakError) -> Measurement:
    """Report what the contours say where the exact streak was not found; else raise the reason.

    They know of no rolling shutter: where there is one, nothing can stand in for the exact streak.
    """
    if task.shutter.row_delay:
        raise reason
    try:
        found, cautions = follow_contours(task)
    except ManyColours:
        raise
    except (StreakError, BadOutputError):  # looks that were found wrongly are no fault of theirs
        raise reason from None
    lost = Caution(
        code="sweep-failed", message=f"{reason}; what the contours say is reported instead"
    )
    return report_contours(task, found, (*cautions, lost))


def follow_contours(task: Task) -> tuple[Reconstruction, tuple[Caution, ...]]:
    """Find the motion from the streak's contours, its opacity and its ends."""
    fit, profiles = fit_streak(task.view, task.estimator)
    contours, fit = smooth_contours(fit)
    _check_inside(contours.points, task.size)
    task.watch.lap("profiles")
    axis = reconstruct_axis(fit, contours, task.camera, task.ball_radius)
    task.watch.lap("axis")
    known = settled(task.estimator, fit)
    light = None if task.estimator.unknowns() else light_caution(profiles, fit, known)
    found = follow_motion(task.view, known, task.camera, task.ball_radius, fit, contours, axis)
    task.watch.lap("motion")
    return found, () if light is None else (light,)


def report_contours(
    task: Task, found: Reconstruction, cautions: tuple[Caution, ...]
) -> Measurement:
    """Report what the contours say, with its uncertainty."""
    uncertainty = covariances(
        found,
        task.camera,
        task.ball_radius,
        ball_radius_std=task.ball_radius_std,
        exposure_std_share=task.exposure_std_share,
    )
    _check_depth(found.motion, uncertainty)
    result = describe(
        found,
        uncertainty,
        ball_radius=task.ball_radius,
        exposure=task.exposure,
        drift=task.view.drift,
    )
    task.watch.lap("uncertainty")
    return replace(result, warnings=(*result.warnings, *cautions))


def close_start(fit: ProfileFit, motion: Motion) -> Start:
    """Start the exact fit where profiles say that the ball was."""
    return Start(
        path=motion.path,
        appearance=None if fit.appearance is None else fit.appearance.values,
        blur=float(fit.blur[0]),
        is_close=True,
    )


def rough_start(task: Task) -> Start:
    """Start it at the opacity's moments, where there are no profiles to tell more."""
    rough = rough_motion(task.view, task.estimator, task.camera, task.ball_radius)
    task.watch.lap("rough motion")
    return Start(path=rough.path, appearance=rough.colour, corner=rough.corner)


def _check_inside(points: Tensor, size: tuple[int, int]) -> None:
    """Raise `StreakError` where a contour runs along or over the picture's border."""
    border = torch.tensor(size, dtype=points.dtype) - 1
    is_inside = ((points > 0) & (points < border)).all(-1)
    if not bool(is_inside.all()):
        x, y = points[~is_inside][0].tolist()
        raise StreakError(
            f"the streak leaves the picture along its side near ({x:.0f}, {y:.0f}) px, so that its "
            "width is not seen; aim so that the whole streak is inside"
        )


def _check_depth(motion: Motion, uncertainty: Uncertainty) -> None:
    """Raise `StreakError` where the depth is as good as unknown."""
    depth = float(motion.position[2])
    std = float(uncertainty.total[DEPTH, DEPTH].clamp_min(0).sqrt())
    if not std < LOST_DEPTH * depth:
        raise StreakError(
            f"the ball's depth is not determined ({depth:.3g} +/- {std:.3g} m): the streak is too "
            "faint or short, or the ball is not what the estimator takes it for; "
            "try --estimator auto"
        )


class Stopwatch:
    """How long each stage took."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Note the time since the last stage ended."""
        now = time.perf_counter()
        self.seconds[stage] = now - self._since
        self._since = now


def _check_numbers(
    ball_radius: float,
    ball_radius_std: float,
    exposure: float | None,
    exposure_std: float,
    readout: float,
) -> None:
    positive = {"ball radius": ball_radius}
    if exposure is not None:
        positive["exposure"] = exposure
    for name, value in positive.items():
        if not (math.isfinite(value) and value > 0):
            raise ConfigError(f"{name} is {value}; a positive number is needed")
    check_readout(readout, exposure)
    others = {"ball radius std": ball_radius_std, "exposure std": exposure_std, "readout": readout}
    for name, value in others.items():
        if not (math.isfinite(value) and value >= 0):
            raise ConfigError(f"{name} is {value}; zero or a positive number is needed")


def _check_stage(stage: str) -> None:
    if stage not in STAGES:
        raise ConfigError(f"stage '{stage}' is unknown; use one of {', '.join(STAGES)}")


def _length_in_widths(view: StreakView) -> float:
    """Length of the whole streak over its width, roughly."""
    axis = view.streak.axis[0]
    length = float(torch.linalg.vector_norm(axis.diff(dim=0), dim=-1).sum())
    return length / (2 * float(view.streak.half_width))


def _turns_corner(view: StreakView) -> bool:
    """Say whether the rough axis, which smooths any corner, turns as if at a bounce."""
    axis = view.streak.axis[0]
    spacing = float(torch.linalg.vector_norm(axis.diff(dim=0), dim=-1).mean())
    step = max(1, round(2 * float(view.streak.half_width) / max(spacing, 1e-6)))
    ahead = torch.nn.functional.normalize(axis[step:] - axis[:-step], dim=-1)
    cosine = (ahead[:-step] * ahead[step:]).sum(-1)
    return len(cosine) > 0 and float(cosine.min()) < math.cos(CORNER)
