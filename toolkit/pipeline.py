"""From one blurred picture to the ball's motion: the whole method, in the order of the paper."""

import math
import time
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.appearance import guess_appearance
from toolkit.background import check_pair
from toolkit.camera import Camera
from toolkit.camera_file import fit_camera
from toolkit.common_residual import common_misfit
from toolkit.contours import (
    check_enough,
    mark_profiles,
    orders,
    smooth_contours,
    smooth_parameters,
    widen_for_correlation,
)
from toolkit.ends import rough_ends
from toolkit.errors import ConfigError, StreakError
from toolkit.following import Reconstruction, follow_motion
from toolkit.guarded import guarded
from toolkit.light_change import light_caution
from toolkit.measurement import Measurement
from toolkit.motion import DEPTH
from toolkit.profile_fit import BLUR_ROUNDS, fit_profiles, improve_appearance, refine_profiles
from toolkit.profile_model import KNOWN_SKEW, Skew
from toolkit.profiles import axis_bend, gather_profiles
from toolkit.reconstruction import reconstruct_axis
from toolkit.registry import name_of
from toolkit.result import describe
from toolkit.streak import ROI, refine_axis
from toolkit.types import Appearance, Contours, LinearImage, ProfileFit, ProfileFlag, Profiles
from toolkit.uncertainty import Uncertainty, covariances
from toolkit.view import StreakView, observe_streak

STAGES = ("profiles", "contours", "sweep")
"""Of a measurement, each starting from the one before."""
PROFILE_REACH = 1.5
"""Half widths that a profile extends to either side, and 4 px more."""
PROFILES = 24
"""To a half width, but never closer than one px: closer ones say no more together."""
FIRST_LOOK = 8
"""The same in the first look, about."""
START_TOLERANCE = 0.2
"""Standard deviations to which profiles are searched: the refinement needs no better start."""
REFINEMENTS = 2
"""Rounds in which profiles are fitted about the smooth course of all of them."""
APPEARANCE_ROUNDS = 4
"""Rounds in which what an estimator leaves open is found, before these."""
MISFIT = 2.0
"""Chi-square per degree of freedom beyond which the ball is not of one colour."""
MANY_COLOURS = 10.0
"""The same, from which no one colour can be found in the fit."""
LOST_DEPTH = 1.0
"""Relative standard deviation of the depth from which nothing is known of it."""
SHADING = 0.3
"""Standard deviation of the skew that shading may cause."""
CORNER = math.radians(40)
"""Turn of the axis over two half widths, radians, beyond which the path has a corner."""
END_MARGIN = 2.0
"""px beyond the ball's first and last image in which profiles are still left out."""


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
    stage: str = "contours",
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
    watch = _Stopwatch()

    view = observe_streak(image, background, estimator, roi)
    watch.lap("streak")
    fit, profiles = fit_streak(view, estimator)
    contours, fit = smooth_contours(fit)
    _check_contours_inside(contours, image)
    watch.lap("profiles")
    axis = reconstruct_axis(fit, contours, camera, ball_radius)
    watch.lap("axis")
    known = settled(estimator, fit)
    light = None if estimator.unknowns() else light_caution(profiles, fit, known)
    found = follow_motion(view, known, camera, ball_radius, fit, contours, axis)
    watch.lap("motion")
    uncertainty = covariances(
        found,
        camera,
        ball_radius,
        ball_radius_std=ball_radius_std,
        exposure_std_share=exposure_std / exposure if exposure else 0.0,
    )
    _check_depth(found, uncertainty)
    watch.lap("uncertainty")

    result = describe(
        found, uncertainty, ball_radius=ball_radius, exposure=exposure, drift=view.drift
    )
    warnings = result.warnings if light is None else (*result.warnings, light)
    return replace(result, estimator=name, warnings=warnings, timing_s=watch.seconds)


def fit_streak(view: StreakView, estimator: AlphaEstimator) -> tuple[ProfileFit, Profiles]:
    """Fit all profiles of the streak, those that touch the ball's first or last image flagged END.

    A first look at some profiles across the rough axis finds the middle of the streak; profiles are
    then laid square to it, closer together, and fitted again, last of all about the smooth course
    of all of them. Where the ball is visibly not of one colour, noise is taken to be as large as
    the misfit, and the opacity may rise from one side to the other as shading makes it.

    Returns:
        The fit, and the profiles it was made of.

    Raises:
        StreakError: when too few profiles are good, or the path turns a corner.
    """
    axis, half_width, excess = view.streak.axis, view.streak.half_width, 1.0
    guess = guess_appearance(view, estimator) if estimator.unknowns() else None
    known = estimator if guess is None else estimator.settled(guess.values)
    for per_half_width, blur_rounds in ((FIRST_LOOK, 1), (PROFILES, BLUR_ROUNDS)):
        reach = PROFILE_REACH * float(half_width) + 4
        spacing = max(1.0, float(half_width) / PROFILES)
        every = max(1, int(float(half_width) / per_half_width / spacing))
        profiles = gather_profiles(
            view.observation,
            view.clipped,
            axis,
            reach,
            corner=view.corner,
            spacing=spacing,
            every=every,
        )
        fit, skew, excess = _fit_as_seen(profiles, known, half_width, excess, blur_rounds)
        axis, half_width = _middle_line(fit), _median_half_width(fit)
    _check_corner(profiles, float(half_width))
    profiles = replace(profiles, variance=profiles.variance * excess)
    if guess is not None:
        fit = _find_appearance(profiles, estimator, guess, fit, skew)
        known = settled(estimator, fit)
    for _ in range(REFINEMENTS):
        fit = refine_profiles(profiles, known, fit, smooth_parameters(fit)[None], skew)
    misfit = common_misfit(profiles, fit, known, skew)
    if guess is not None and misfit > MANY_COLOURS:
        raise StreakError(
            "the ball is not of one colour that the fit could find: its profiles have another "
            f"shape, by {misfit:.0f} times the variance of their mean; use --estimator "
            "known-shading with a sharp picture (--ball-image) of a shaded ball, two-colour for "
            "one of two pigments, or give --ball-colour where it is evenly lit"
        )
    fit = widen_for_correlation(fit)
    chi2 = fit.chi2_per_dof * excess
    return replace(fit, chi2_per_dof=chi2, common_misfit=misfit), profiles


def _fit_as_seen(
    profiles: Profiles,
    estimator: AlphaEstimator,
    half_width: Tensor,
    excess: float,
    blur_rounds: int,
) -> tuple[ProfileFit, Skew, float]:
    """Fit profiles, and once more with noise as large as their misfit where one colour fails.

    Args:
        profiles: laid across the axis.
        estimator: of the ball's opacity.
        half_width: rough, px [1].
        excess: by how much the misfit was seen to exceed the noise before, as a variance; else 1.
        blur_rounds: how often the blur is improved.

    Returns:
        The fit, the skew it assumed, and the excess.
    """
    # a bent axis is covered for longer on its inner side: skew = half width / (2 bending radius)
    bend_skew = axis_bend(profiles) * half_width[:, None] / 2
    for is_last in (False, True):
        skew = Skew(mean=bend_skew, std=KNOWN_SKEW if excess == 1 else SHADING)
        widened = replace(profiles, variance=profiles.variance * excess)
        fit = fit_profiles(
            widened,
            estimator,
            half_width=half_width,
            skew=skew,
            tolerance=START_TOLERANCE,
            blur_rounds=blur_rounds,
        )
        fit = _mark_ends(fit)
        misfit = excess * _median_chi2(fit)
        if is_last or excess > 1 or misfit <= MISFIT:
            break
        excess = misfit
    check_enough(fit)
    return fit, skew, excess


def _find_appearance(
    profiles: Profiles, estimator: AlphaEstimator, guess: Appearance, fit: ProfileFit, skew: Skew
) -> ProfileFit:
    """Find what the estimator leaves open of the ball's looks, and fit the profiles with it."""
    looks = guess
    for _ in range(APPEARANCE_ROUNDS):
        about = smooth_parameters(fit)[None]
        looks = improve_appearance(profiles, estimator, guess, looks.values, fit, about, skew)
        fit = refine_profiles(profiles, estimator.settled(looks.values), fit, about, skew)
    return replace(fit, appearance=looks)


def settled(estimator: AlphaEstimator, fit: ProfileFit) -> AlphaEstimator:
    """Give the estimator with what the fit found of the ball's looks."""
    return estimator if fit.appearance is None else estimator.settled(fit.appearance.values)


def _middle_line(fit: ProfileFit) -> Tensor:
    """Smooth axis through the centres of the good profiles [1, N, 2] px."""
    weight = torch.where(fit.good[0], 1 / fit.covariance[0, :, 0, 0], 0)
    return refine_axis(fit.middle[0], weight, fit.position[0], orders(fit))


def _median_half_width(fit: ProfileFit) -> Tensor:
    """Median over the good profiles [1] px."""
    return fit.half_width[0][fit.good[0]].median()[None]


def _median_chi2(fit: ProfileFit) -> float:
    """Median over the profiles between the ends, whether or not their search settled."""
    usable = (fit.flags[0] & ~int(ProfileFlag.NOT_CONVERGED)) == 0
    return float(fit.chi2_per_dof[0][usable].median()) if bool(usable.any()) else 1.0


def _mark_ends(fit: ProfileFit) -> ProfileFit:
    """Flag the profiles that meet the ball's first or last image.

    No semi-ellipse is expected there (Caglioti & Giusti 2007, section 2).
    """
    first, last = rough_ends(fit)
    middle = (fit.position > first) & (fit.position < last)
    usable = middle & fit.good
    width = float(fit.half_width[usable].median()) if bool(usable.any()) else 0.0
    clear = width + END_MARGIN
    is_end = (fit.position < first + clear) | (fit.position > last - clear)
    return mark_profiles(fit, ProfileFlag.END, is_end)


def _check_corner(profiles: Profiles, half_width: float) -> None:
    """Raise `StreakError` where the path turns a corner, as at a bounce: no canal surface there."""
    normal, origin = profiles.normal[0], profiles.origin[0]
    reach = max(1, int(half_width / float(profiles.position[0].diff().mean())))
    turn = (normal[: -2 * reach] * normal[2 * reach :]).sum(-1)
    if len(turn) and float(turn.min()) < math.cos(CORNER):
        x, y = origin[int(turn.argmin()) + reach].tolist()
        raise StreakError(
            f"the path turns a corner near ({x:.0f}, {y:.0f}) px, as at a bounce, where its "
            "contours do not tell where the ball was; expose so that the bounce lies outside the "
            "exposure"
        )


def _check_contours_inside(contours: Contours, image: LinearImage) -> None:
    """Raise `StreakError` where a contour runs along or over the picture's border."""
    border = torch.tensor([image.width - 1, image.height - 1], dtype=contours.points.dtype)
    is_inside = ((contours.points > 0) & (contours.points < border)).all(-1)
    if not bool(is_inside.all()):
        x, y = contours.points[~is_inside][0].tolist()
        raise StreakError(
            f"the streak leaves the picture along its side near ({x:.0f}, {y:.0f}) px, so that its "
            "width is not seen; aim so that the whole streak is inside"
        )


def _check_depth(found: Reconstruction, uncertainty: Uncertainty) -> None:
    """Raise `StreakError` where the depth is as good as unknown."""
    depth = float(found.motion.position[2])
    std = float(uncertainty.total[DEPTH, DEPTH].clamp_min(0).sqrt())
    if not std < LOST_DEPTH * depth:
        raise StreakError(
            f"the ball's depth is not determined ({depth:.3g} +/- {std:.3g} m): the streak is too "
            "faint or short, or the ball is not what the estimator takes it for; "
            "try --estimator auto"
        )


class _Stopwatch:
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
    others = {"ball radius std": ball_radius_std, "exposure std": exposure_std, "readout": readout}
    for name, value in others.items():
        if not (math.isfinite(value) and value >= 0):
            raise ConfigError(f"{name} is {value}; zero or a positive number is needed")


def _check_stage(stage: str) -> None:
    if stage not in STAGES:
        raise ConfigError(f"stage '{stage}' is unknown; use one of {', '.join(STAGES)}")
