import math

import cv2
import numpy as np
import pytest
import torch

from toolkit.synthetic import (
    CircularPath,
    StraightPath,
    benchmark_scene,
    render_shot,
    true_contours,
)
from toolkit.synthetic.presets import preset_camera

LENS = (-0.2, 0.06, 1e-3, -5e-4, 0.0)
SCENES = {
    "straight": benchmark_scene(width_px=30, seed=1),
    "tilted": benchmark_scene(width_px=30, tilt=0.9, distance_R=15, seed=2),
    "curved": benchmark_scene(width_px=30, sagitta_widths=0.8, distance_R=15, seed=3),
    "distorted": benchmark_scene(width_px=40, sagitta_widths=0.3, distortion=LENS, seed=4),
}
EACH = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)


def nearest_approach(scene, pixels):
    """Least distance of each pixel's ray from the ball's centre, in radii, by brute force."""
    time = torch.linspace(0, scene.exposure, 4001, dtype=torch.float64)
    rays = scene.camera.unproject(pixels)
    centres = scene.path.position(time)
    distance = torch.linalg.cross(centres[:, None].expand(-1, len(rays), 3), rays[None])
    return distance.norm(dim=-1).amin(dim=0) / scene.ball_radius


@EACH
def test_contour_rays_graze_the_ball(scene):
    contours = true_contours(scene.path, scene.camera, scene.ball_radius, scene.exposure, 60)
    assert contours.shape == (2, 60, 2)
    middle = contours[:, 5:-5].reshape(-1, 2)
    assert (nearest_approach(scene, middle) - 1).abs().max() < 1e-4


@EACH
def test_contours_bound_the_rendered_streak(scene):
    shot = render_shot(scene)
    left, right = shot.contours(400).numpy()
    outline = np.concatenate([left, right[::-1]]).astype(np.float32)
    y, x = np.mgrid[: scene.camera.height, : scene.camera.width]
    signed = [
        cv2.pointPolygonTest(outline, (float(a), float(b)), True)
        for a, b in zip(x.ravel(), y.ravel(), strict=True)
    ]
    inside = np.array(signed).reshape(x.shape)
    # the ball's first and last image reach beyond the contours' ends: judge what is abreast of them
    ends = torch.tensor([0.0, scene.exposure], dtype=torch.float64)
    first, last = scene.camera.project(scene.path.position(ends)).numpy()
    along = ((x - first[0]) * (last - first)[0] + (y - first[1]) * (last - first)[1]) / (
        (last - first) ** 2
    ).sum()
    abreast = (along > 0.15) & (along < 0.85)
    alpha = shot.alpha.numpy()
    half_diagonal = 0.5 * math.sqrt(2)
    assert (alpha[abreast & (inside > half_diagonal + 0.05)] > 0).all()
    assert (alpha[abreast & (inside < -half_diagonal - 0.05)] == 0).all()
    assert alpha[abreast & (np.abs(inside) < 0.2)].min() > 0


def test_left_is_left_when_walking_along_the_motion():
    camera = preset_camera(600, 400)
    to_the_right = StraightPath(start=(-0.2, 0.0, 2.0), start_velocity=(20.0, 0.0, 0.0))
    left, right = true_contours(to_the_right, camera, 0.05, 0.02)
    assert (left[:, 1] < right[:, 1]).all()  # up in the picture
    downwards = StraightPath(start=(0.0, -0.2, 2.0), start_velocity=(0.0, 20.0, 0.0))
    left, right = true_contours(downwards, camera, 0.05, 0.02)
    assert (left[:, 0] > right[:, 0]).all()


def test_a_ball_that_flies_at_the_camera_has_no_contours():
    path = StraightPath(start=(0.01, 0.0, 2.0), start_velocity=(0.0, 0.0, -20.0))
    assert true_contours(path, preset_camera(600, 400), 0.05, 0.02).isnan().all()


def test_a_swung_ball_has_contours_all_along():
    path = CircularPath(
        centre=(0.0, 0.0, 2.0), arm=(0.3, 0.0, 0.0), axis=(0.0, 0.1, 1.0), rate=10.0
    )
    contours = true_contours(path, preset_camera(600, 400), 0.05, 0.2)
    assert contours.isfinite().all()
