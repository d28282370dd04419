"""A whole measurement through a fisheye, and a rational lens, far off the axis."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit import Camera, measure
from toolkit.synthetic import (
    PlainBall,
    Scene,
    StraightPath,
    benchmark_scene,
    render_shot,
    textured_background,
)

LENSES = {
    "fisheye": (-0.03, 0.008, -0.004, 0.0008),
    "rational": (0.31, -0.12, 6e-4, -9e-4, 0.02, 0.66, -0.07, 0.03),
}


def make_shot(model):
    camera = Camera(
        width=360,
        height=260,
        fx=190.0,
        fy=189.0,
        cx=181.0,
        cy=128.0,
        distortion=LENSES[model],
        model=model,
    )
    background = textured_background(360, 260, contrast=0.1, seed=3)
    path = StraightPath(start=(0.24, 0.10, 0.62), start_velocity=(11.0, -9.0, 3.0))
    scene = Scene(
        camera=camera,
        path=path,
        ball_radius=0.04,
        exposure=0.012,
        appearance=PlainBall(colour=(0.9, 0.55, 0.15)),
        background=background,
        blur=0.7,
        noise=benchmark_scene().noise,
    )
    return render_shot(scene, seed=3)


@pytest.mark.parametrize("model", ["fisheye", "rational"])
def test_the_exact_streak_is_measured_far_off_the_axis(model):
    shot = make_shot(model)
    scene = shot.scene
    count = 4 + len(LENSES[model])
    covariance = torch.zeros(count, count, dtype=torch.float64)
    covariance[:4, :4] = torch.diag(torch.tensor([0.4, 0.4, 0.2, 0.2]).double() ** 2)
    covariance[4, 4] = 1e-6
    result = measure(
        shot.image,
        shot.background,
        camera=replace(scene.camera, covariance=covariance),
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=Uniform(colour=scene.appearance.colour),
        stage="sweep",
    )
    assert result.status == "ok"
    error = np.array(result.position_m) - shot.position.numpy()
    assert (np.abs(error) < 4 * np.array(result.position_std_m)).all()
    speed = float(shot.velocity.norm())
    assert abs(result.speed_m_s - speed) < 4 * result.speed_std_m_s
    assert result.speed_std_m_s < 0.05 * speed
    # the lens's doubt is a line of the budget, whatever the lens
    assert result.budget.depth.camera > 0.05
