"""Fitting the profiles across a streak, from a rough axis to the smooth course of all of them."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.appearance import guess_appearance
from toolkit.appearance_fit import find_appearance
from toolkit.common_residual import common_misfit
from toolkit.contours import (
    check_enough,
    mark_profiles,
    orders,
    smooth_parameters,
    widen_for_correlation,
)
from toolkit.ends import rough_ends
from toolkit.errors import StreakError
from toolkit.profile_fit import MAX_ITERATIONS, Start, fit_profiles, refine_profiles
from toolkit.profile_model import KNOWN_SKEW, Skew, WhitePixels
from toolkit.profiles import axis_bend, gather_profiles
from toolkit.streak import refine_axis
from toolkit.types import Appearance, ProfileFit, ProfileFlag, Profiles
from toolkit.view import StreakView

PROFILE_REACH = 1.5
"""Half widths that a profile extends to either side, and 4 px more."""
PROFILES = 24
"""To a half width, but never closer than one px: closer ones say no more together."""
FIRST_LOOK = 8
"""The same in the first look, about."""
FIRST_ITERATIONS = 5
"""Most steps in the first look: what has not settled then is hardly a semi-ellipse."""
FIRST_TOLERANCE = 0.5
"""Standard deviations of a step that ends a profile's search there: it leads on much nearer."""
START_TOLERANCE = 0.2
"""The same where profiles are laid closer: the refinement needs no better start."""
REFINEMENTS = (2, 6)
"""Rounds in which profiles are fitted about the smooth course of all of them: least and most."""
BLUR_SETTLED = 0.03
"""px by which the blur may change in the last of them."""
MISFIT = 2.0
"""Chi-square per degree of freedom beyond which the ball is not of one colour."""
MANY_COLOURS = 10.0
"""The same, from which no one colour can be found in the fit."""
SHADING = 0.3
"""Standard deviation of the skew that shading may cause."""
CORNER = math.radians(40)
"""Turn of the axis over two half widths, radians, beyond which the path has a corner."""
END_MARGIN = 2.0
"""px beyond the ball's first and last image in which profiles are still left out."""


class ManyColours(StreakError):
    """The ball is not what the estimator takes it for, and no other way of looking helps."""


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
    first, guess, known = _first_look(view, estimator)
    half_width = _median_half_width(first.fit)
    profiles = _laid_across(view, _middle_line(first.fit), half_width, PROFILES)
    look = _fit_as_seen(profiles, known, half_width, first.excess, first.fit)
    profiles, pixels, fit, skew = look.profiles, look.pixels, look.fit, look.skew
    _check_corner(profiles, float(_median_half_width(fit)))
    if guess is not None:
        fit = find_appearance(profiles, pixels, estimator, guess, fit, skew)
        known = settled(estimator, fit)
    fit = _refine(profiles, pixels, known, fit, skew)
    misfit = common_misfit(pixels, fit, known, skew)
    if guess is not None and misfit > MANY_COLOURS:
        raise ManyColours(
            "the ball is not of one colour that the fit could find: its profiles have another "
            f"shape, by {misfit:.0f} times the variance of their mean; use --estimator "
            "known-shading with a sharp picture (--ball-image) of a shaded ball, two-colour for "
            "one of two pigments, or give --ball-colour where it is evenly lit"
        )
    fit = widen_for_correlation(fit)
    chi2 = fit.chi2_per_dof * look.excess
    return replace(fit, chi2_per_dof=chi2, common_misfit=misfit), profiles


def fit_roughly(view: StreakView, estimator: AlphaEstimator) -> ProfileFit:
    """Fit some profiles across the rough axis: enough to start a search that sees every pixel.

    Raises:
        StreakError: when too few profiles are good, or the path turns a corner.
    """
    first, guess, known = _first_look(view, estimator)
    profiles, pixels, fit, skew = first.profiles, first.pixels, first.fit, first.skew
    _check_corner(profiles, float(_median_half_width(fit)))
    if guess is None:
        about = smooth_parameters(fit)[None]
        fit = refine_profiles(profiles, known, fit, about, skew, pixels)
    else:
        fit = find_appearance(profiles, pixels, estimator, guess, fit, skew, most_rounds=1)
    return replace(fit, chi2_per_dof=fit.chi2_per_dof * first.excess)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """Profiles and the fit of each by itself."""

    profiles: Profiles  # with noise as large as the misfit
    pixels: WhitePixels  # theirs
    fit: ProfileFit
    skew: Skew  # that the fit assumed
    excess: float  # of the misfit over the noise, as a variance


def _first_look(
    view: StreakView, estimator: AlphaEstimator
) -> tuple[_Look, Appearance | None, AlphaEstimator]:
    """Fit some profiles across the rough axis.

    Returns:
        The profiles, a guess of what the estimator leaves open, and the estimator settled on it.
    """
    half_width = view.streak.half_width
    profiles = _laid_across(view, view.streak.axis, half_width, FIRST_LOOK)
    guess, known = None, estimator
    if estimator.unknowns():
        guess = guess_appearance(profiles, float(half_width), estimator)
        known = estimator.settled(guess.values)
    return _fit_as_seen(profiles, known, half_width), guess, known


def _laid_across(
    view: StreakView, axis: Tensor, half_width: Tensor, per_half_width: int
) -> Profiles:
    """Lay profiles square to an axis, so many to a half width [1] px."""
    spacing = max(1.0, float(half_width) / PROFILES)
    return gather_profiles(
        view.observation,
        view.clipped,
        axis,
        PROFILE_REACH * float(half_width) + 4,
        corner=view.corner,
        spacing=spacing,
        every=max(1, int(float(half_width) / per_half_width / spacing)),
        smooth_ground=view.smooth_ground,
    )


def _fit_as_seen(
    profiles: Profiles,
    estimator: AlphaEstimator,
    half_width: Tensor,
    excess: float = 1.0,
    before: ProfileFit | None = None,
) -> _Look:
    """Fit profiles, and once more with noise as large as their misfit where one colour fails.

    Args:
        profiles: laid across the axis.
        estimator: of the ball's opacity.
        half_width: rough, px [1].
        excess: by how much the misfit was seen to exceed the noise before, as a variance; else 1.
        before: a fit of fewer profiles to start from.
    """
    # a bent axis is covered for longer on its inner side: skew = half width / (2 bending radius)
    bend_skew = axis_bend(profiles) * half_width[:, None] / 2
    start = None if before is None else _between(before, profiles, half_width, bend_skew)
    for is_last in (False, True):
        skew = Skew(mean=bend_skew, std=KNOWN_SKEW if excess == 1 else SHADING)
        widened = replace(profiles, variance=profiles.variance * excess)
        pixels = WhitePixels.of(widened)
        fit = fit_profiles(
            widened,
            estimator,
            half_width=half_width,
            skew=skew,
            tolerance=FIRST_TOLERANCE if before is None else START_TOLERANCE,
            blur_rounds=1,  # what is noisy one by one looks sharper than it is
            max_iterations=FIRST_ITERATIONS if before is None else MAX_ITERATIONS,
            start=start,
            pixels=pixels,
        )
        fit = _mark_ends(fit)
        misfit = excess * _median_chi2(fit)
        if is_last or excess > 1 or misfit <= MISFIT:
            break
        excess = misfit
    check_enough(fit)
    return _Look(profiles=widened, pixels=pixels, fit=fit, skew=skew, excess=excess)


def _between(fit: ProfileFit, profiles: Profiles, half_width: Tensor, skew: Tensor) -> Start:
    """Start profiles laid along the middle of a fit from what those next to them were."""
    share, known = profiles.position / profiles.position[0, -1], fit.position / fit.position[0, -1]
    widths = fit.half_width.clamp(min=0.6 * half_width[0], max=1.4 * half_width[0])
    width, opacity = (
        torch.from_numpy(np.interp(share[0].numpy(), known[0].numpy(), values[0].numpy()))[None]
        for values in (widths, fit.opacity)
    )
    parameters = torch.stack([torch.zeros_like(width), width, opacity, skew], dim=-1)
    return Start(parameters=parameters, blur=fit.blur)


def _refine(
    profiles: Profiles, pixels: WhitePixels, estimator: AlphaEstimator, fit: ProfileFit, skew: Skew
) -> ProfileFit:
    """Fit the profiles about their smooth course until the blur of all stays as it is."""
    least, most = REFINEMENTS
    for done in range(1, most + 1):
        blur = float(fit.blur)
        fit = refine_profiles(profiles, estimator, fit, smooth_parameters(fit)[None], skew, pixels)
        if done >= least and abs(float(fit.blur) - blur) < BLUR_SETTLED:
            break
    return fit


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
