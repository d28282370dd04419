from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.contours import smooth_contours
from toolkit.following import follow_motion
from toolkit.motion import DURATION, PATH, PATH_POINTS, SPEED
from toolkit.reconstruction import reconstruct_axis
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import NoiseLevel, benchmark_scene, render_shot
from toolkit.uncertainty import covariances
from toolkit.view import observe_streak


@pytest.fixture(scope="module")
def streak():
    """A small streak's reconstruction, its camera and ball radius."""
    scene = benchmark_scene(
        width_px=32, length_widths=4, heading=0.4, seed=2, noise=NoiseLevel(read=0.004)
    )
    shot = render_shot(scene, seed=2)
    estimator = Uniform(colour=scene.appearance.colour)
    view = observe_streak(shot.image, shot.background, estimator)
    contours, fit = smooth_contours(fit_streak(view, estimator)[0])
    axis = reconstruct_axis(fit, contours, scene.camera, scene.ball_radius)
    found = follow_motion(view, estimator, scene.camera, scene.ball_radius, fit, contours, axis)
    return found, scene.camera, scene.ball_radius


def of(streak, radius_share=0.0, exposure_share=0.0, camera=None):
    found, own_camera, ball_radius = streak
    return covariances(
        found,
        camera or own_camera,
        ball_radius,
        ball_radius_std=radius_share * ball_radius,
        exposure_std_share=exposure_share,
    )


def test_shapes_and_total(streak):
    uncertainty = of(streak, 0.01, 0.02)
    size = 8 + 3 * PATH_POINTS
    parts = (
        uncertainty.noise,
        uncertainty.order,
        uncertainty.radius,
        uncertainty.exposure,
        uncertainty.brightness,
    )
    assert all(part.shape == (size, size) for part in parts)
    assert uncertainty.camera is None
    assert torch.allclose(uncertainty.total, sum(parts))


def test_what_is_known_exactly_adds_nothing(streak):
    uncertainty = of(streak)
    assert uncertainty.radius.abs().max() == 0
    assert uncertainty.exposure.abs().max() == 0
    assert (uncertainty.noise.diagonal()[:3] > 0).all()


def test_all_lengths_follow_the_radius(streak):
    state = streak[0].motion.state()
    std = of(streak, radius_share=0.03).radius.diagonal().sqrt()
    assert torch.allclose(std[:SPEED], 0.03 * state[:SPEED].abs())
    assert float(std[SPEED]) == pytest.approx(0.03 * float(state[SPEED]))
    assert torch.allclose(std[PATH:], 0.03 * state[PATH:].abs())
    assert float(std[DURATION]) == 0


def test_only_speeds_follow_the_exposure(streak):
    state = streak[0].motion.state()
    std = of(streak, exposure_share=0.05).exposure.diagonal().sqrt()
    assert torch.allclose(std[3 : SPEED + 1], 0.05 * state[3 : SPEED + 1].abs())
    assert std[:3].max() == 0
    assert std[DURATION:].max() == 0


def test_ends_that_agree_with_the_opacity_leave_the_brightness_alone(streak):
    assert of(streak).brightness.abs().max() == 0


def test_ends_that_contradict_the_opacity_widen_the_speed(streak):
    found, camera, ball_radius = streak
    motion = replace(found.motion, duration=torch.tensor(1.2, dtype=torch.float64))
    uncertainty = of((replace(found, motion=motion), camera, ball_radius))
    share = float(uncertainty.brightness[SPEED, SPEED].sqrt() / motion.state()[SPEED])
    assert 0.15 < share <= 0.2
    assert uncertainty.brightness.diagonal()[:3].max() == 0


def test_the_focal_length_acts_on_depth(streak):
    found, camera, _ = streak
    covariance = torch.zeros(4, 4, dtype=torch.float64)
    covariance[:2, :2] = (0.01 * camera.fx) ** 2  # both by one per cent, together
    uncertainty = of(streak, camera=replace(camera, covariance=covariance))
    std = uncertainty.camera.diagonal().sqrt()
    assert float(std[2]) == pytest.approx(0.01 * float(found.motion.position[2]), rel=0.03)
    # whatever the focal length, the ball is as wide and travels as many of its widths
    assert float(std[SPEED]) < 0.002 * float(found.motion.state()[SPEED])


def test_the_principal_point_shifts_the_ball_sideways(streak):
    found, camera, _ = streak
    covariance = torch.zeros(4, 4, dtype=torch.float64)
    covariance[2, 2] = 1.0  # px^2
    uncertainty = of(streak, camera=replace(camera, covariance=covariance))
    std = uncertainty.camera.diagonal().sqrt()
    shift = float(found.motion.position[2]) / camera.fx
    assert float(std[0]) == pytest.approx(shift, rel=0.05)
    assert float(std[1]) < 0.05 * shift
