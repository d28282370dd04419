"""Which shape of path explains a streak, and what comes of it."""

import math
from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.alpha import Observation
from toolkit.contours import smooth_contours
from toolkit.flight import SIZE, STRAIGHT, fit_flight, levelled, with_known_opacity
from toolkit.following import flight_answer, follow_motion, opacity_data, surroundings
from toolkit.reconstruction import reconstruct_axis
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import CircularPath, NoiseLevel, benchmark_scene, render_shot
from toolkit.uncertainty import SPEED, covariances
from toolkit.view import observe_streak

CURVED = benchmark_scene(width_px=44, length_widths=5, sagitta_widths=0.8, heading=0.3, seed=3)
TURN = 1.6
"""Of the circular path, rad."""
CIRCLE_RADIUS = 0.35
"""m; the ball's is 0.05."""


def look(scene, seed=3):
    """A shot of the scene, as the estimator sees it."""
    shot = render_shot(scene, seed=seed)
    estimator = Uniform(colour=scene.appearance.colour)
    return shot, observe_streak(shot.image, shot.background, estimator), estimator


def reconstruct(scene):
    shot, view, estimator = look(scene)
    contours, fit = smooth_contours(fit_streak(view, estimator)[0])
    axis = reconstruct_axis(fit, contours, scene.camera, scene.ball_radius)
    return shot, follow_motion(
        view, estimator, scene.camera, scene.ball_radius, fit, contours, axis
    )


@pytest.fixture(scope="module")
def curved():
    return reconstruct(CURVED)


@pytest.fixture(scope="module")
def swung():
    """A ball on a string, at an even speed."""
    middle = -math.pi / 2
    first = middle - TURN / 2
    path = CircularPath(
        centre=(0.0, 0.9 * CIRCLE_RADIUS, 50 * CURVED.ball_radius),
        arm=(CIRCLE_RADIUS * math.cos(first), CIRCLE_RADIUS * math.sin(first), 0.0),
        axis=(0.0, 0.0, 1.0),
        rate=TURN / CURVED.exposure,
    )
    return reconstruct(replace(CURVED, path=path))


def path_error(shot, path):
    """Distances of points from the true path, ball radii [N]."""
    time = torch.linspace(0, shot.scene.exposure, 2001, dtype=torch.float64)
    truth = shot.scene.path.position(time)
    return torch.cdist(path, truth).amin(1) / shot.scene.ball_radius


def speed_errors(shot, found):
    speed = torch.linalg.vector_norm(found.motion.path_displacement, dim=-1)
    time = torch.linspace(0, shot.scene.exposure, len(speed), dtype=torch.float64)
    if float(found.motion.displacement @ shot.velocity) < 0:
        time = time.flip(0)
    truth = torch.linalg.vector_norm(shot.scene.path.velocity(time), dim=-1)
    return speed / shot.scene.exposure / truth - 1


def test_a_parabola_is_taken_for_a_flight(curved):
    shot, found = curved
    assert found.flight is not None
    assert found.flight.converged
    assert float(path_error(shot, found.motion.path).square().mean().sqrt()) < 0.15
    assert float(speed_errors(shot, found).abs().max()) < 0.03
    assert float(found.motion.duration) == pytest.approx(1, abs=0.02)


def test_a_circle_is_left_to_splines(swung):
    shot, found = swung
    assert found.flight is None
    assert float(path_error(shot, found.motion.path).square().mean().sqrt()) < 0.3
    assert float(speed_errors(shot, found).abs().max()) < 0.03


def test_a_flight_knows_its_errors(curved):
    shot, found = curved
    scene = shot.scene
    uncertainty = covariances(
        found, scene.camera, scene.ball_radius, ball_radius_std=0, exposure_std_share=0
    )
    assert uncertainty.order.abs().max() == 0
    std = uncertainty.noise.diagonal().sqrt()
    assert ((found.motion.position - shot.position).abs() < 4 * std[:3]).all()
    speed = float(torch.linalg.vector_norm(found.motion.displacement)) / scene.exposure
    assert abs(speed - float(shot.velocity.norm())) < 4 * float(std[SPEED]) / scene.exposure


def refit(found, camera, radius):
    """The flight fitted anew through another camera: its coefficients and duration."""
    data = opacity_data(found.fit, found.opacity.s, camera)
    seen = found.flight.seen
    seen = replace(seen, opacity=replace(data, weight=seen.opacity.weight))
    size = STRAIGHT if found.axis.curve.is_line else SIZE
    fit = fit_flight(found.flight.flight, seen, camera, radius, size=size)
    fit = levelled(with_known_opacity(fit), is_level=found.flight.is_level)
    return torch.cat([fit.flight.coefficients.flatten(), fit.duration[None]])


@pytest.mark.parametrize("sagitta", [0.0, 0.8], ids=["straight", "curved"])
def test_a_flight_follows_the_camera_as_if_fitted_anew(sagitta):
    scene = benchmark_scene(
        width_px=44,
        length_widths=5,
        sagitta_widths=sagitta,
        tilt=0.2,
        heading=0.3,
        seed=3,
        distortion=(-0.1, 0.05, 1e-3, -1e-3, 0.02),
        noise=NoiseLevel(read=0.003),
    )
    _, found = reconstruct(scene)
    radius, camera = scene.ball_radius, scene.camera
    answer = flight_answer(found, camera, radius)
    std = found.flight.covariance.diagonal().sqrt()
    for index, size in enumerate((1.0, 1.0, 1.0, 1.0, 3e-3, 1e-2, 1e-4, 1e-4, 1e-2)):
        step = torch.zeros_like(camera.parameters)
        step[index] = size
        ahead, back = (
            refit(found, camera.with_parameters(camera.parameters + sign * step), radius)
            for sign in (1, -1)
        )
        expected, predicted = (ahead - back) / 2, answer @ step
        error = (predicted - expected).abs()
        assert (error < 0.03 * expected.abs().max() + 0.02 * std).all()


def test_pixels_off_the_ball_are_covered_by_nothing_on_average():
    _, view, estimator = look(replace(CURVED, noise=NoiseLevel(read=0.03)))
    pixels = surroundings(view, estimator)
    seen = (pixels.signal, pixels.ground, pixels.variance)
    signal, ground, variance = (values[None] for values in seen)
    found, _ = estimator.alpha(Observation(signal=signal, ground=ground, variance=variance))
    alpha = found[0, 0]
    naive, _ = estimator.alpha(view.observation)
    y, x = torch.meshgrid(*(torch.arange(n) for n in alpha.shape), indexing="ij")
    place = torch.stack([x, y], -1).double() + torch.tensor(view.corner)
    away = torch.cdist(place.flatten(0, 1), view.streak.axis[0]).amin(1).reshape(x.shape)
    off = away > 1.5 * float(view.streak.half_width) + 3
    error = float(alpha[off].std()) / float(off.sum()) ** 0.5
    assert abs(float(alpha[off].mean())) < 4 * error
    assert float(naive[0, 0][off].mean()) > 8 * error  # each pixel's own noise in its contrast
