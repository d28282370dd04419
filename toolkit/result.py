"""Turning what was found into a `Measurement`: both signs, budget, cautions, plain numbers."""

import math
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

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
from toolkit.reconstruction import Reconstruction
from toolkit.uncertainty import DURATION, PATH, SPEED, Uncertainty

DISAGREEMENT = 0.02
"""Least relative difference between the speeds from opacity and from the ends that is worth a warning."""
MISFIT = 3.0
"""Chi-square per degree of freedom of the profiles beyond which the model is visibly not the whole truth."""


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
    measurement = _without_speed(found, uncertainty)
    if exposure is not None:
        measurement = _with_speed(measurement, found, uncertainty, exposure)
    cautions = _cautions(found, uncertainty, ball_radius, exposure, drift)
    return replace(measurement, warnings=cautions)


def _without_speed(found: Reconstruction, uncertainty: Uncertainty) -> Measurement:
    motion, total = found.motion, uncertainty.total
    direction = motion.displacement / torch.linalg.vector_norm(motion.displacement)
    std = total.diagonal().clamp_min(0).sqrt()
    good = found.fit.good[0]
    return Measurement(
        stage="contours",
        position_m=numbers(motion.position),
        position_std_m=numbers(std[:3]),
        direction=numbers(direction),
        sign=Sign(
            ambiguous=True,
            probability=0.5,
            alternatives=(
                Alternative(direction=numbers(-direction), velocity_m_s=None, probability=0.5),
            ),
        ),
        trajectory=PathSamples(
            time_s=None,
            position_m=numbers(motion.path),
            velocity_m_s=None,
            position_std_m=numbers(std[PATH:].reshape(-1, 3)),
        ),
        contours=ContourPoints(
            left=numbers(found.contours.points[0]), right=numbers(found.contours.points[1])
        ),
        profiles=ProfileTable(
            centre_px=numbers(found.fit.middle[0]),
            half_width_px=numbers(found.fit.half_width[0]),
            opacity=numbers(found.fit.opacity[0]),
            flags=numbers(found.fit.flags[0]),
        ),
        budget=Budget(speed=None, depth=_shares(uncertainty, 2)),
        fit=FitSummary(
            chi2_per_dof=float(found.fit.chi2_per_dof[0][good].median()),
            pixels=int(found.fit.samples[0][good].sum()),
            iterations=found.fit.iterations,
        ),
    )


def _with_speed(
    measurement: Measurement, found: Reconstruction, uncertainty: Uncertainty, exposure: float
) -> Measurement:
    motion = found.motion
    velocity = motion.displacement / exposure
    scale = torch.ones(6, dtype=torch.float64)
    scale[3:] = 1 / exposure
    covariance = scale[:, None] * uncertainty.total[:6, :6] * scale
    count = len(motion.path)
    sign, trajectory, budget = measurement.sign, measurement.trajectory, measurement.budget
    if sign is None or trajectory is None or budget is None:
        raise ValueError("a measurement without speed must be complete before the speed is added")
    alternatives = tuple(
        replace(other, velocity_m_s=numbers(-velocity)) for other in sign.alternatives
    )
    speed_std = float(uncertainty.total[SPEED, SPEED].clamp_min(0).sqrt()) / exposure
    return replace(
        measurement,
        time_s=exposure / 2,
        velocity_m_s=numbers(velocity),
        speed_m_s=float(torch.linalg.vector_norm(velocity)),
        speed_std_m_s=speed_std,
        state_covariance=numbers((covariance + covariance.mT) / 2),
        sign=replace(sign, alternatives=alternatives),
        trajectory=replace(
            trajectory,
            time_s=numbers(torch.linspace(0, exposure, count, dtype=torch.float64)),
            velocity_m_s=numbers(motion.path_displacement / exposure),
        ),
        budget=replace(budget, speed=_shares(uncertainty, SPEED)),
    )


def _shares(uncertainty: Uncertainty, place: int) -> Shares:
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
    duration_std = float(uncertainty.noise[DURATION, DURATION].sqrt())
    bend = float(found.axis.curve.curvature_radius(found.opacity.s[good]).min())
    misfit = float(found.fit.chi2_per_dof[0][good].median())
    change = float((drift - 1).abs().max())
    checks: list[tuple[bool, str, str]] = [
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
            abs(duration - 1) > max(3 * duration_std, DISAGREEMENT),
            "opacity-and-ends-disagree",
            f"the distance between the streak's ends would take {duration:.3f} of the exposure at the speed its opacity "
            "tells; ball colour, response curve or exposure is off by about as much, and the speed's uncertainty is widened",
        ),
        (
            bend < ball_radius,
            "bends-too-sharply",
            f"the path bends with a radius of {bend:.3g} m, less than the ball's; the contours do not fix it there",
        ),
        (
            misfit > MISFIT,
            "profiles-misfit",
            f"the profiles miss the picture by {misfit:.1f} times the variance of its noise (shading, a pattern, or a "
            "background that changed); the uncertainties are widened by as much",
        ),
        (
            change > 0,
            "background-brightness",
            f"the light changed by {100 * change:.1f} % since the background was taken; the background was scaled",
        ),
    ]
    return tuple(Caution(code=code, message=message) for is_due, code, message in checks if is_due)
