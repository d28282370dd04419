"""Turning what was found into a `Measurement`: both signs, budget, cautions, plain numbers."""

from collections.abc import Iterable
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.common_residual import MISSHAPEN
from toolkit.following import Reconstruction, opacity_doubt
from toolkit.measurement import (
    Alternative,
    Budget,
    Caution,
    ContourPoints,
    FitSummary,
    Measurement,
    PathSamples,
    ProfileTable,
    Shares,
    Sign,
    numbers,
)
from toolkit.motion import DEPTH, PATH, SPEED, Motion
from toolkit.types import Contours, ProfileFit
from toolkit.uncertainty import Uncertainty, duration_std

DISAGREEMENT = 0.02
"""Relative difference between the speeds from opacity and ends from which a warning is due."""
UNTOLD = 0.05
"""Relative standard deviation of the opacity that a colour found leaves, from which it is said."""
WARNED_MISFIT = 1.5
"""Chi-square per degree of freedom of the profiles beyond which a warning is due."""

Check = tuple[bool, str, str]
"""Whether a caution is due, its code, and its message."""


def describe_profiles(
    fit: ProfileFit, contours: Contours, *, drift: Tensor | None = None
) -> Measurement:
    """Report what the profiles tell in the picture, where the measurement stops at them.

    Position, motion and path are None: no camera has been looked through yet.

    Args:
        fit: of all profiles, its axis running to the right in the picture, or down.
        contours: through their edges.
        drift: change of the light since the background [3]; None where nobody looked.
    """
    light = [] if drift is None else [light_check(drift)]
    return Measurement(
        stage="profiles",
        contours=contour_points(contours),
        profiles=profile_table(fit),
        fit=_summary(fit),
        warnings=due([*_profile_checks(fit), *light]),
    )


def describe(
    found: Reconstruction,
    uncertainty: Uncertainty,
    *,
    ball_radius: float,
    exposure: float | None,
    drift: Tensor,
) -> Measurement:
    """Report the reconstruction on the branch of the sign in which the axis was followed.

    Args:
        found: the reconstruction; its axis runs to the right in the picture, or down.
        uncertainty: of its state.
        ball_radius: m.
        exposure: s, or None.
        drift: change of the light since the background [3].
    """
    std = uncertainty.total.diagonal().clamp_min(0).sqrt()
    measurement = Measurement(
        stage="contours",
        position_m=numbers(found.motion.position),
        position_std_m=numbers(std[:3]),
        direction=numbers(unit_vector(found.motion.displacement)),
        sign=open_sign(found.motion, exposure),
        trajectory=path_samples(found.motion, std, exposure),
        contours=contour_points(found.contours),
        profiles=profile_table(found.fit),
        budget=Budget(
            speed=None if exposure is None else shares(uncertainty, SPEED),
            depth=shares(uncertainty, DEPTH),
        ),
        fit=_summary(found.fit),
        warnings=_cautions(found, uncertainty, ball_radius, exposure, drift),
    )
    if exposure is None:
        return measurement
    return with_speed(measurement, found.motion, uncertainty, exposure)


def with_speed(
    measurement: Measurement, motion: Motion, uncertainty: Uncertainty, exposure: float
) -> Measurement:
    """Add what only the exposure time, s, makes known."""
    velocity = motion.displacement / exposure
    scale = torch.ones(6, dtype=torch.float64)
    scale[3:] = 1 / exposure
    covariance = scale[:, None] * uncertainty.total[:6, :6] * scale
    return replace(
        measurement,
        time_s=exposure / 2,
        velocity_m_s=numbers(velocity),
        speed_m_s=float(torch.linalg.vector_norm(velocity)),
        speed_std_m_s=float(uncertainty.total[SPEED, SPEED].clamp_min(0).sqrt()) / exposure,
        state_covariance=numbers((covariance + covariance.mT) / 2),
    )


def open_sign(motion: Motion, exposure: float | None) -> Sign:
    """Say that the motion may as well be the reverse."""
    reverse = Alternative(
        direction=numbers(-unit_vector(motion.displacement)),
        velocity_m_s=None if exposure is None else numbers(-motion.displacement / exposure),
        probability=0.5,
    )
    return Sign(ambiguous=True, probability=0.5, alternatives=(reverse,))


def path_samples(motion: Motion, std: Tensor, exposure: float | None) -> PathSamples:
    """Sample the path; `std` is that of the state, times and velocities need the exposure."""
    time = velocity = None
    if exposure is not None:
        time = numbers(torch.linspace(0, exposure, len(motion.path), dtype=torch.float64))
        velocity = numbers(motion.path_displacement / exposure)
    return PathSamples(
        time_s=time,
        position_m=numbers(motion.path),
        velocity_m_s=velocity,
        position_std_m=numbers(std[PATH:].reshape(-1, 3)),
    )


def contour_points(contours: Contours) -> ContourPoints:
    """Put both contours into the result."""
    return ContourPoints(left=numbers(contours.points[0]), right=numbers(contours.points[1]))


def profile_table(fit: ProfileFit) -> ProfileTable:
    """Put all profiles into the result."""
    return ProfileTable(
        centre_px=numbers(fit.middle[0]),
        half_width_px=numbers(fit.half_width[0]),
        opacity=numbers(fit.opacity[0]),
        flags=numbers(fit.flags[0]),
    )


def _summary(fit: ProfileFit) -> FitSummary:
    good = fit.good[0]
    return FitSummary(
        chi2_per_dof=float(fit.chi2_per_dof[0][good].median()),
        pixels=int(fit.samples[0][good].sum()),
        iterations=fit.iterations,
        appearance=None if fit.appearance is None else numbers(fit.appearance.values),
    )


def unit_vector(vector: Tensor) -> Tensor:
    """Give the vector [3] at length 1."""
    length: Tensor = torch.linalg.vector_norm(vector)
    return vector / length


def shares(uncertainty: Uncertainty, place: int) -> Shares:
    """Shares of the variance of one component of the state; None for a source that is not known."""
    total = float(uncertainty.total[place, place])

    def share(covariance: Tensor | None) -> float | None:
        return None if covariance is None or total <= 0 else float(covariance[place, place]) / total

    return Shares(
        noise=share(uncertainty.noise + uncertainty.order),
        camera=share(uncertainty.camera),
        radius=share(uncertainty.radius),
        exposure=share(uncertainty.exposure),
        response=share(uncertainty.brightness),
    )


def _cautions(
    found: Reconstruction,
    uncertainty: Uncertainty,
    ball_radius: float,
    exposure: float | None,
    drift: Tensor,
) -> tuple[Caution, ...]:
    good = found.fit.good[0]
    duration = float(found.motion.duration)
    chance = duration_std(found, uncertainty.noise)
    bend = float(found.axis.curve.curvature_radius(found.opacity.s[good]).min())
    checks = [
        (
            exposure is None,
            "exposure-unknown",
            "no exposure time is known, so the speed is not either; give --exposure",
        ),
        (
            uncertainty.camera is None,
            "camera-uncertainty-unknown",
            "the camera file holds no covariance; the stated uncertainties leave the camera out",
        ),
        (
            abs(duration - 1) > max(3 * chance, DISAGREEMENT),
            "opacity-and-ends-disagree",
            f"the distance between the streak's ends would take {duration:.3f} of the exposure at "
            "the speed its opacity tells; ball colour, response curve or exposure is off by about "
            "as much, and the speed's uncertainty is widened",
        ),
        (
            opacity_doubt(found.fit) > UNTOLD,
            "colour-from-length",
            "the background varies too little to tell the ball's colour from its opacity "
            f"(to {100 * opacity_doubt(found.fit):.0f} %), so that the speed rests on the streak's "
            "length; give the colour, or take a background with more texture",
        ),
        (
            bend < ball_radius,
            "bends-too-sharply",
            f"the path bends with a radius of {bend:.3g} m, less than the ball's; "
            "the contours do not fix it there",
        ),
        *_profile_checks(found.fit),
        light_check(drift),
    ]
    return due(checks)


def _profile_checks(fit: ProfileFit) -> list[Check]:
    misfit = float(fit.chi2_per_dof[0][fit.good[0]].median())
    return [
        (
            misfit > WARNED_MISFIT,
            "profiles-misfit",
            f"the profiles miss the picture by {misfit:.1f} times the variance of its noise "
            "(shading, a pattern, or a background that changed); "
            "the uncertainties are widened by as much",
        ),
        (
            fit.common_misfit > MISSHAPEN,
            "profiles-misshapen",
            "all profiles differ alike from the shape that this estimator expects, by "
            f"{fit.common_misfit:.0f} times the variance of their mean (shading, a pattern, "
            "a wrong colour or response); width and depth may be wrong, and the uncertainties are "
            "widened; another estimator may suit the ball, and --estimator auto tries all",
        ),
    ]


def light_check(drift: Tensor) -> Check:
    """Say whether the background had to follow a change of the light."""
    change = float((drift - 1).abs().max())
    return (
        change > 0,
        "background-brightness",
        f"the light changed by {100 * change:.1f} % since the background was taken; "
        "the background was scaled",
    )


def due(checks: Iterable[Check]) -> tuple[Caution, ...]:
    """Keep the cautions that are due."""
    return tuple(Caution(code=code, message=message) for is_due, code, message in checks if is_due)
