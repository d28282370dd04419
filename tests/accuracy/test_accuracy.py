"""Errors on rendered streaks of the benchmark scene against their budgets.

Ball at 50 R, |F - B| at least 0.4, noise 1 % of white in every channel of shot and background,
point spread 0.7 px, unless told.
"""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit.contours import smooth_contours
from toolkit.pipeline import measure
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import benchmark_scene, render_shot
from toolkit.view import observe_streak

PROFILE_BUDGET = 0.5
"""px rms: edge of a single profile, across the contour, 120 px wide."""
CONTOUR_BUDGET = 1 / 15
"""px rms: the smoothed contour, 120 px wide."""
AXIS_BUDGET = 0.15
"""R, median over the path: distance from the true one."""
SPEED_BUDGET = 0.01
"""Relative, or three stated standard deviations where they are more."""
DIRECTION_BUDGET = 3.0
"""Degrees, or three stated standard deviations where they are more."""
CHI2_BUDGET = {"contours": 0.25, "sweep": 0.05}
"""Of chi-square per degree of freedom, from 1: that of profiles, and of all pixels."""
Z_RANGE = (0.6, 1.6)
"""rms of error over stated standard deviation, 12 repetitions."""
REPETITIONS = 12


@functools.cache
def rendered(seed, **options):
    return render_shot(benchmark_scene(seed=seed, **options), seed=seed)


def measured(shot, **options):
    scene = shot.scene
    arguments = {
        "camera": scene.camera,
        "ball_radius": scene.ball_radius,
        "exposure": scene.exposure,
        "estimator": Uniform(colour=scene.appearance.colour),
    }
    return measure(shot.image, shot.background, **(arguments | options))


def distance_from(points, line):
    """Distance of points [N, 2] from the polyline [M, 2], M being dense."""
    return torch.cdist(points.double(), line.double()).amin(1)


def rms(values):
    return float(torch.as_tensor(values).double().pow(2).mean().sqrt())


def edge_errors(shot):
    """Distance from the true contours, px: edges of single profiles, and smooth contours."""
    estimator = Uniform(colour=shot.scene.appearance.colour)
    fit, _ = fit_streak(observe_streak(shot.image, shot.background, estimator), estimator)
    contours, fit = smooth_contours(fit)
    # the axis may be followed against the motion, which exchanges left and right
    lines = shot.contours(20_000)
    edges = fit.edges[0, fit.good[0]]
    swapped = rms(distance_from(edges[:, 0], lines[0])) > rms(distance_from(edges[:, 0], lines[1]))
    lines = lines.flip(0) if swapped else lines
    single = [distance_from(edges[:, side], lines[side]) for side in range(2)]
    smooth = [distance_from(contours.points[side], lines[side]) for side in range(2)]
    return torch.cat(single), torch.cat(smooth)


def test_profiles_and_contours_lie_on_the_true_ones():
    shot = rendered(3, width_px=120, length_widths=3.0, heading=0.4)
    errors = [edge_errors(shot.with_noise(seed)) for seed in range(4)]
    assert rms(torch.cat([single for single, _ in errors])) < PROFILE_BUDGET
    assert rms(torch.cat([smooth for _, smooth in errors])) < CONTOUR_BUDGET


def test_profiles_of_a_bent_streak_lie_on_the_true_contours():
    shot = rendered(3, width_px=120, length_widths=3.0, heading=0.4, sagitta_widths=0.3)
    single, _ = edge_errors(shot)
    assert rms(single) < PROFILE_BUDGET


def path_errors(shot, result):
    """Distance of the path found from the true one, in R."""
    scene = shot.scene
    time = torch.linspace(0, scene.exposure, 4001, dtype=torch.float64)
    return distance_from_3d(result.trajectory.position_m, scene.path.position(time)) / (
        scene.ball_radius
    )


def distance_from_3d(points, line):
    return torch.cdist(torch.tensor(points, dtype=torch.float64), line).amin(1)


STREAKS = {
    "straight": {"width_px": 60, "length_widths": 4.0, "heading": 0.3},
    "tilted": {"width_px": 60, "length_widths": 4.0, "heading": 2.0, "tilt": 0.4},
    "curved": {"width_px": 70, "length_widths": 5.0, "heading": -0.5, "sagitta_widths": 0.8},
    "close": {"width_px": 70, "length_widths": 3.0, "heading": 1.0, "distance_R": 15.0},
    "through a real lens": {
        "width_px": 60,
        "length_widths": 4.0,
        "heading": 0.7,
        "distortion": (-0.25, 0.08, 1e-3, -5e-4, 0.0),
    },
}


@pytest.mark.parametrize("stage", CHI2_BUDGET)
@pytest.mark.parametrize("name", STREAKS)
def test_path_speed_and_direction(name, stage):
    shot = rendered(11, **STREAKS[name])
    result = measured(shot, stage=stage)
    assert (result.status, result.stage) == ("ok", stage)
    assert float(path_errors(shot, result).median()) < AXIS_BUDGET
    velocity = shot.velocity.numpy()
    found = np.array(result.velocity_m_s)
    cosine = abs(found @ velocity) / np.linalg.norm(found) / np.linalg.norm(velocity)
    std = np.sqrt(np.diag(np.array(result.state_covariance))[3:])
    stated = math.degrees(np.linalg.norm(std) / result.speed_m_s)
    assert math.degrees(math.acos(min(1.0, cosine))) < max(DIRECTION_BUDGET, 3 * stated)
    speed_error = result.speed_m_s / np.linalg.norm(velocity) - 1
    allowed = max(SPEED_BUDGET, 3 * result.speed_std_m_s / result.speed_m_s)
    assert abs(speed_error) < allowed
    assert float(result.fit.chi2_per_dof) == pytest.approx(1, abs=CHI2_BUDGET[stage])


def z_scores(shot, seeds):
    rows = []
    for seed in seeds:
        noisy = shot.with_noise(seed)
        result = measured(noisy)
        std = np.array(result.position_std_m)
        z = (np.array(result.position_m) - shot.position.numpy()) / std
        speed = float(shot.velocity.norm())
        rows.append([*z, (result.speed_m_s - speed) / result.speed_std_m_s])
    return np.array(rows)


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_errors_are_as_large_as_stated(tilt):
    shot = rendered(21, width_px=44, length_widths=4.0, heading=0.5, tilt=tilt)
    z = z_scores(shot, range(100, 100 + REPETITIONS))
    for name, column in zip(("x", "y", "z", "speed"), z.T, strict=True):
        spread = rms(column)
        assert Z_RANGE[0] < spread < Z_RANGE[1], f"{name}: {spread:.2f}"


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_intervals_hold_the_truth_as_often_as_they_say(tilt):
    z = np.concatenate(
        [
            z_scores(
                rendered(seed, width_px=50, length_widths=4.0, tilt=tilt), range(seed, seed + 20)
            )
            for seed in range(300, 310)
        ]
    )
    within = (np.abs(z) < 1.96).mean(0)
    # 1.5 % is the standard deviation of a share of 95 % in 200
    assert (within > 0.89).all()


def test_a_known_camera_covariance_enters_the_result():
    shot = rendered(11, **STREAKS["straight"])
    camera = shot.scene.camera
    share = 0.01
    covariance = torch.zeros(4, 4, dtype=torch.float64)
    # fx and fy err together, by one per cent
    covariance[:2, :2] = (share * camera.fx) ** 2
    plain, result = measured(shot), measured(shot, camera=replace(camera, covariance=covariance))
    assert plain.budget.depth.camera is None
    assert "camera-uncertainty-unknown" in [w.code for w in plain.warnings]
    assert "camera-uncertainty-unknown" not in [w.code for w in result.warnings]
    # the focal length acts on depth: one per cent of it is one per cent of the distance
    added = math.sqrt(result.position_std_m[2] ** 2 - plain.position_std_m[2] ** 2)
    assert added == pytest.approx(share * result.position_m[2], rel=0.05)
    assert result.position_m == plain.position_m
    shares = result.budget.depth
    assert shares.noise + shares.camera + shares.radius + shares.exposure + shares.response == (
        pytest.approx(1)
    )


def test_a_known_error_of_radius_and_exposure_enters_the_result():
    shot = rendered(11, **STREAKS["straight"])
    scene = shot.scene
    plain = measured(shot)
    result = measured(
        shot, ball_radius_std=0.02 * scene.ball_radius, exposure_std=0.03 * scene.exposure
    )
    added = math.sqrt(result.position_std_m[2] ** 2 - plain.position_std_m[2] ** 2)
    assert added == pytest.approx(0.02 * result.position_m[2], rel=1e-3)
    added = math.sqrt(result.speed_std_m_s**2 - plain.speed_std_m_s**2)
    assert added == pytest.approx(math.hypot(0.02, 0.03) * result.speed_m_s, rel=1e-3)
    speed = result.budget.speed
    assert speed.exposure / speed.radius == pytest.approx((0.03 / 0.02) ** 2, rel=1e-6)
