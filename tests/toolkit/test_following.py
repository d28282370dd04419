"""Which shape of path explains a streak, and what comes of it."""

import math
from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.alpha import Observation
from toolkit.contours import smooth_contours
from toolkit.following import follow_motion, refit_flight, surroundings
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


def test_a_flight_through_another_focal_length_lies_deeper(curved):
    shot, found = curved
    camera = shot.scene.camera
    longer = replace(camera, fx=1.01 * camera.fx, fy=1.01 * camera.fy)
    same = refit_flight(found, found.flight, camera, shot.scene.ball_radius)
    deeper = refit_flight(found, found.flight, longer, shot.scene.ball_radius)
    gap = same.flight.coefficients - found.flight.flight.coefficients
    assert gap.abs().max() < 1e-3 * shot.scene.ball_radius
    ratio = deeper.flight.coefficients[0, 2] / same.flight.coefficients[0, 2]
    assert float(ratio) == pytest.approx(1.01, abs=1e-3)


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
