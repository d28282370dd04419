"""Turning the most likely motion into a `Measurement`."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.measurement import (
    Bound,
    Budget,
    Caution,
    ContourPoints,
    FitSummary,
    Measurement,
    ProfileTable,
    ResidualMap,
    Sign,
    numbers,
)
from toolkit.motion import DEPTH, SPEED, Motion
from toolkit.outline import outline
from toolkit.result import (
    Check,
    due,
    light_check,
    open_sign,
    path_samples,
    shares,
    unit_vector,
    with_speed,
)
from toolkit.sweep.doubt import motion_of
from toolkit.sweep.explain import explain_misfit, explain_shade, other_colour
from toolkit.sweep.fit import SweepFit
from toolkit.sweep.linearity import Linearity
from toolkit.sweep.marks import MarkedFit
from toolkit.sweep.misfit import Misfit
from toolkit.sweep.opacity import PIXEL_VARIANCE
from toolkit.sweep.shade import Shaded
from toolkit.sweep.still import SpeedLimit
from toolkit.uncertainty import Uncertainty

NEARLY_AT_REST = 0.2
"""Share of its highest speed below which the ball may as well have turned back."""
WARNED_MISFIT = 1.5
"""Chi-square per degree of freedom beyond which a warning is due."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepResult:
    """The most likely motion with all that is known about it."""

    fit: SweepFit
    misfit: Misfit
    linearity: Linearity
    uncertainty: Uncertainty
    sign: Sign | None = None  # where the readout tells something about it
    marked: MarkedFit | None = None  # the same fit, where marks on the ball were allowed for
    still_below: SpeedLimit | None = None  # the ball may have stood still
    delay: float = 0.0  # s by which the ball's own row was exposed later than the first


def describe_sweep(
    found: SweepResult,
    *,
    exposure: float | None,
    drift: Tensor,
    profiles: ProfileTable | None,
) -> Measurement:
    """Report the most likely motion.

    Args:
        found: the fit, what it misses, and how sure it is.
        exposure: s, or None.
        drift: change of the light since the background [3].
        profiles: of the stage before, where there was one.
    """
    fit, uncertainty = found.fit, found.uncertainty
    motion = motion_of(fit)
    std = uncertainty.total.diagonal().clamp_min(0).sqrt()
    camera, ball_radius = fit.model.camera, fit.model.ball_radius
    left, right = outline(motion.path, motion.path_displacement, camera, ball_radius)
    is_still = found.still_below is not None
    measurement = Measurement(
        stage="sweep",
        position_m=numbers(motion.position),
        position_std_m=numbers(std[:3]),
        direction=None if is_still else numbers(unit_vector(motion.displacement)),
        sign=None if is_still else found.sign or open_sign(motion, exposure),
        trajectory=path_samples(motion, std, exposure),
        contours=ContourPoints(left=numbers(left), right=numbers(right)),
        profiles=profiles,
        budget=Budget(
            speed=None if exposure is None or is_still else shares(uncertainty, SPEED),
            depth=shares(uncertainty, DEPTH),
        ),
        bound=_bound(found, exposure),
        fit=_summary(found),
        warnings=_cautions(found, motion, exposure, drift),
    )
    if exposure is None:
        return measurement
    measurement = _delayed(with_speed(measurement, motion, uncertainty, exposure), found.delay)
    if found.still_below is None:
        return measurement
    return replace(
        measurement,
        velocity_m_s=None,
        speed_m_s=None,
        speed_std_m_s=None,
        speed_upper_m_s=found.still_below.any_way / exposure,
        state_covariance=None,
    )


def _delayed(measurement: Measurement, delay: float) -> Measurement:
    """Count time from the start of the first row's exposure."""
    path, time = measurement.trajectory, measurement.time_s
    if not delay or time is None or path is None or path.time_s is None:
        return measurement
    later = replace(path, time_s=tuple(t + delay for t in path.time_s))
    return replace(measurement, time_s=time + delay, trajectory=later)


def _bound(found: SweepResult, exposure: float | None) -> Bound:
    """Give what no unbiased estimator could beat, and the share of it that was reached."""
    excess = found.misfit.factor * found.fit.pixels.excess
    variance = found.uncertainty.noise.diagonal() / excess
    total = found.uncertainty.total.diagonal()
    is_known = exposure is not None and found.still_below is None
    return Bound(
        position_std_m=numbers(variance[:3].clamp_min(0).sqrt()),
        speed_std_m_s=math.sqrt(float(variance[SPEED])) / exposure
        if exposure and is_known
        else None,
        efficiency=float((variance[DEPTH] / total[DEPTH]).clamp(0, 1)),
    )


def _summary(found: SweepResult) -> FitSummary:
    fit, misfit = found.fit, found.misfit
    _, spread, appearance, _, _ = fit.model.split(fit.parameters)
    place, sigma = misfit.patch_place, misfit.patch_sigma
    if found.marked is not None:
        place, sigma = found.marked.residuals
    return FitSummary(
        chi2_per_dof=misfit.pixels * fit.pixels.excess,
        pixels=int((fit.seen.residual != 0).sum()),
        iterations=fit.iterations,
        appearance=numbers(appearance) if len(appearance) else None,
        blur_px=math.sqrt(max(float(spread) - PIXEL_VARIANCE, 0.0)),
        residuals=ResidualMap(place_px=numbers(place), sigma=numbers(sigma)),
    )


def _cautions(
    found: SweepResult, motion: Motion, exposure: float | None, drift: Tensor
) -> tuple[Caution, ...]:
    fit, misfit = found.fit, found.misfit
    single, brighter = misfit.pixels * fit.pixels.excess, other_colour(fit, misfit.factor)
    checks: list[Check] = [
        (
            exposure is None,
            "exposure-unknown",
            "no exposure time is known, so the speed is not either; give --exposure",
        ),
        (
            found.uncertainty.camera is None,
            "camera-uncertainty-unknown",
            "the camera file holds no covariance; the stated uncertainties leave the camera out",
        ),
        (
            found.still_below is not None,
            "may-stand-still",
            "the streak is no longer than a ball at rest may leave, so that no velocity is stated"
            + _limits(found.still_below, exposure),
        ),
        (
            _may_turn_back(motion),
            "may-turn-back",
            "the ball nearly came to rest on its path; a way passed once, from or to rest, and one "
            "passed there and back look alike, and where the ball was when differs",
        ),
        (
            isinstance(fit.model.estimator, Shaded),
            "shade-fitted",
            f"the ball is shaded{explain_shade(fit)}, which its estimator knows nothing of; a "
            "smooth shade was fitted, and the uncertainties are widened by what a less smooth one "
            "would change; known-shading or two-colour may suit the ball better",
        ),
        (
            brighter is not None,
            "other-colour",
            f"the ball shows another colour than the one it is known by, {_percent(brighter)} all "
            "over (marks on it, other light, another ball); its colour was found from the streak "
            "instead, and the uncertainties are those of a colour that nobody knows",
        ),
        (
            found.marked is not None,
            "marks-fitted",
            "the ball is not of one smooth colour: marks on it were fitted with all else, and the "
            "uncertainties say what they may have changed",
        ),
        (
            found.marked is not None or misfit.significant or single > WARNED_MISFIT,
            "streak-misfit",
            _misfit_text(found),
        ),
        (
            found.linearity.is_doubted,
            "response-doubted",
            "ball and background mix as if light had been decoded with an exponent "
            f"{abs(found.linearity.found):.0%} too {_size(found.linearity.found)}; check the "
            "response, or take RAW; the ball's looks or another light may show like this too; "
            "the uncertainties are widened by what it would change",
        ),
        light_check(drift),
    ]
    return due(checks)


def _misfit_text(found: SweepResult) -> str:
    """Say how much and what the streak of a plain ball leaves unexplained."""
    misfit, noise = found.misfit, found.fit.pixels.excess
    if found.marked is not None:
        misfit = found.marked.before
        noise = found.marked.fit.pixels.excess / misfit.pixels
    return (
        "the streak differs from that of such a ball by more than noise: "
        f"{misfit.pixels * noise:.2f} times its variance in single pixels, "
        f"{misfit.patches * noise:.1f} in patches of what is left, "
        f"{misfit.lanes * noise:.1f} along the whole streak "
        f"({explain_misfit(found.fit, found.marked)}); the uncertainties are widened"
    )


def _percent(brighter: float | None) -> str:
    if brighter is None:
        return ""
    return f"by {abs(brighter):.0%} {'brighter' if brighter > 0 else 'darker'}"


def _size(change: float) -> str:
    return "large" if change > 0 else "small"


def _may_turn_back(motion: Motion) -> bool:
    """Whether the ball all but stops somewhere, as at the apex of a throw straight up."""
    speed = torch.linalg.vector_norm(motion.path_displacement, dim=-1)
    return float(speed.min()) < NEARLY_AT_REST * float(speed.max())


def _limits(limit: SpeedLimit | None, exposure: float | None) -> str:
    if limit is None or exposure is None:
        return ""
    return (
        f"; it went at most {limit.any_way / exposure:.3g} m/s, at most "
        f"{limit.across / exposure:.3g} m/s across the line of sight (95 %)"
    )
