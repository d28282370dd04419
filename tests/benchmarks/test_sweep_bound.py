from dataclasses import replace

import numpy as np
import pytest
from sweep_bound import slopes_by_rendering

from toolkit.synthetic import NoiseLevel, benchmark_scene, render_shot

SCENE = replace(benchmark_scene(width_px=24, length_widths=2, distance_R=20, seed=1), blur=0.6)


def slopes_of(scene=SCENE, *, is_colour_known=False, gain_std=0.02):
    return slopes_by_rendering(
        scene, is_colour_known=is_colour_known, gain_std=gain_std, offset_std=0.005
    )


@pytest.fixture(scope="module")
def slopes():
    return slopes_of()


def test_what_is_known_makes_the_rest_better_known(slopes):
    assert (slopes_of(is_colour_known=True).std < slopes.std).all()
    assert (slopes_of(gain_std=1e-6).std <= slopes.std).all()


def test_bounds_follow_the_noise():
    first, second = (
        slopes_of(replace(SCENE, noise=NoiseLevel(read=read)), gain_std=1e6).std
        for read in (0.001, 0.0002)
    )
    # the prior of the offset matters little where noise is low
    assert first / second == pytest.approx([5, 5, 5, 5], rel=0.05)


def test_a_small_change_of_the_state_is_found_again(slopes):
    position, velocity = np.array(SCENE.path.start), np.array(SCENE.path.start_velocity)
    nearer = replace(SCENE.path, start=tuple(position + np.array([2e-4, -1e-4, 1e-3])))
    faster = replace(
        SCENE.path,
        start=tuple(position - 0.005 * velocity * SCENE.exposure / 2),
        start_velocity=tuple(1.005 * velocity),
    )
    light = render_shot(SCENE).clean_image
    moved, sped = (
        slopes.shift((render_shot(replace(SCENE, path=path)).clean_image - light).double().numpy())
        for path in (nearer, faster)
    )
    assert moved[:3] == pytest.approx([2e-4, -1e-4, 1e-3], rel=0.03, abs=2e-6)
    assert sped[3] == pytest.approx(0.005 * np.linalg.norm(velocity), rel=0.03)
