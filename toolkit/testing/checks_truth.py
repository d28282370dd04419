"""Checks against the sample's truth. Each is named as its function."""

import torch
from torch import Tensor

from toolkit.measurement import Measurement
from toolkit.pipeline import measure
from toolkit.synthetic import RenderedShot
from toolkit.testing.case import Case, expect

BIAS = 0.02
"""Of the opacity, beside what chance explains."""
CHANCE = 4.0
"""Standard deviations."""
SURPRISE = (0.6, 1.5)
"""Mean of (error / standard deviation)^2, 1 where the variance is honest."""
DEPTH_ERROR_R, ACROSS_ERROR_R, SPEED_ERROR = 0.2, 0.05, 0.02
"""In ball radii, and a share of the speed; beside what chance explains."""
WORST_DEPTH_STD_R = 0.3
"""Stated standard deviation of the depth beyond which the sample is not measured at all."""
OPACITY_ERROR = 0.05


def truth_alpha(case: Case) -> None:
    """The opacity found with the ball's foreground is the true one, on average."""
    error, variance, alpha = _errors(case)
    weight = 1 / variance
    bias = float((error * weight).sum() / weight.sum())
    limit = BIAS * float(alpha.mean()) + CHANCE * float(weight.sum()) ** -0.5
    expect(
        abs(bias) <= limit,
        f"opacities err by {bias:+.4f} on average where {float(alpha.mean()):.2f} is true; "
        f"{limit:.4f} is allowed",
    )


def truth_variance(case: Case) -> None:
    """The errors of the opacity are as large as its variance says."""
    error, variance, _ = _errors(case)
    surprise = float((error * error / variance).mean())
    low, high = SURPRISE
    expect(
        low <= surprise <= high,
        f"squared errors are {surprise:.2f} of the variance; it must lie within {low} and {high}",
    )


def truth_measure(case: Case) -> None:
    """Measuring the sample finds place and speed of the ball, and the opacity of its profiles."""
    sample, shot = case.sample, case.sample.shot
    scene = shot.scene
    found = measure(
        sample.image,
        sample.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=case.estimator,
    )
    _check_position(found, shot)
    _check_speed(found, float(torch.linalg.vector_norm(shot.velocity)))
    _check_opacity(found, float(sample.alpha[sample.core].max()))


def _check_position(found: Measurement, shot: RenderedShot) -> None:
    expect(found.position_m and found.position_std_m, "no position was measured")
    radius = shot.scene.ball_radius
    error = (torch.tensor(found.position_m, dtype=torch.float64) - shot.position).abs() / radius
    std = torch.tensor(found.position_std_m, dtype=torch.float64) / radius
    worst = f"the depth is known to {float(std[2]):.2f} ball radii only"
    expect(std[2] <= WORST_DEPTH_STD_R, worst)
    least = torch.tensor([ACROSS_ERROR_R, ACROSS_ERROR_R, DEPTH_ERROR_R], dtype=torch.float64)
    x, y, z = error.tolist()
    expect(
        (error <= least + CHANCE * std).all(),
        f"the position errs by {x:.2f}, {y:.2f}, {z:.2f} ball radii in x, y, z",
    )


def _check_speed(found: Measurement, true: float) -> None:
    expect(found.speed_m_s and found.speed_std_m_s, "no speed was measured")
    speed, std = float(found.speed_m_s or 0), float(found.speed_std_m_s or 0)
    expect(
        abs(speed - true) <= SPEED_ERROR * true + CHANCE * std,
        f"the speed is {speed:.2f} +/- {std:.2f} m/s where {true:.2f} is true",
    )


def _check_opacity(found: Measurement, true: float) -> None:
    """Compare the median over the good profiles."""
    table = found.profiles
    rows = [] if table is None else zip(table.opacity, table.flags, strict=True)
    good = [opacity for opacity, flag in rows if flag == 0]
    expect(good, "no profile is good")
    opacity = float(torch.tensor(good).median())
    expect(
        abs(opacity / true - 1) <= OPACITY_ERROR,
        f"the profiles' opacity is {opacity:.3f} where {true:.3f} is true",
    )


def _errors(case: Case) -> tuple[Tensor, Tensor, Tensor]:
    """Give errors, variances and truth of the core's opacities over all repeats, [N] each."""
    foreground = case.foreground(case.sample.core_chord)
    alpha = case.sample.alpha[case.sample.core]
    found = []
    for pictures in case.sample.repeats:
        signal, ground, variance = case.core(case.observe(*pictures))
        contrast = foreground - ground
        information = (contrast * contrast / variance).sum(-1)
        value = (contrast * (signal - ground) / variance).sum(-1) / information
        found.append((value - alpha, 1 / information, alpha))
    error, variance, truth = (torch.cat(parts) for parts in zip(*found, strict=True))
    return error, variance, truth
