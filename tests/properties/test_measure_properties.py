"""What must hold for every streak, whatever its numbers."""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from plugins.uniform import Uniform
from toolkit.camera import Camera
from toolkit.measurement import Measurement
from toolkit.pipeline import measure
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import NoiseLevel, benchmark_scene, render_shot
from toolkit.types import LinearImage
from toolkit.view import observe_streak

few = settings(
    max_examples=4,
    derandomize=True,
    deadline=None,
    phases=(Phase.generate,),  # every example is a rendered picture: too dear to shrink
)
seeds = st.integers(0, 1000)
tilts = st.sampled_from([-0.35, 0.0, 0.25])
headings = st.sampled_from([0.2, 0.9, -0.6])
SAME_PLACE, SAME_SPEED = 0.03, 0.005
"""R, relative: what the same picture, seen otherwise, may change: a hundredth of a px."""
QUIET = 0.003
"""Noise of sensor white."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """What a measurement takes."""

    image: LinearImage
    background: LinearImage
    camera: Camera
    estimator: Uniform
    ball_radius: float = 0.05
    exposure: float = 0.02

    def measure(self) -> Measurement:
        return measure(
            self.image,
            self.background,
            camera=self.camera,
            ball_radius=self.ball_radius,
            exposure=self.exposure,
            estimator=self.estimator,
        )


@functools.cache
def rendered(seed, tilt, heading, length_widths=4.0, noise=0.01):
    scene = benchmark_scene(
        width_px=34,
        length_widths=length_widths,
        tilt=tilt,
        heading=heading,
        seed=seed,
        noise=NoiseLevel(read=noise),
    )
    shot = render_shot(scene, seed=seed)
    return Shot(
        image=shot.image,
        background=shot.background,
        camera=scene.camera,
        estimator=Uniform(colour=scene.appearance.colour),
    )


def seen_by(change, shot, camera):
    """The shot with both pictures changed, and the camera that sees them so."""

    def changed(image):
        return replace(image, rgb=change(image.rgb), clipped=change(image.clipped))

    return replace(
        shot, image=changed(shot.image), background=changed(shot.background), camera=camera
    )


def up_to_sign(velocity, other):
    velocity, other = np.array(velocity), np.array(other)
    return math.copysign(1.0, velocity @ other) * other


def assert_same(shot, result, other, turn):
    """`other` is `result` with its vectors turned by the matrix `turn`, but for a trifle."""
    gap = np.array(other.position_m) - turn @ np.array(result.position_m)
    assert np.linalg.norm(gap) < SAME_PLACE * shot.ball_radius
    velocity = turn @ np.array(result.velocity_m_s)
    found = up_to_sign(velocity, other.velocity_m_s)
    assert np.linalg.norm(found - velocity) < 5 * SAME_SPEED * result.speed_m_s
    assert abs(other.speed_m_s / result.speed_m_s - 1) < SAME_SPEED


@few
@given(seed=seeds, tilt=tilts, heading=headings, factor=st.floats(0.1, 20))
def test_a_ball_of_another_size_scales_positions_and_speed(seed, tilt, heading, factor):
    shot = rendered(seed, tilt, heading)
    one, other = shot.measure(), replace(shot, ball_radius=factor * shot.ball_radius).measure()
    for name in ("position_m", "position_std_m", "velocity_m_s", "speed_m_s", "speed_std_m_s"):
        np.testing.assert_allclose(
            getattr(other, name), factor * np.array(getattr(one, name)), rtol=1e-4
        )
    np.testing.assert_allclose(other.direction, one.direction, atol=1e-5)
    # linear algebra rounds by where in memory its numbers lie
    for name in ("centre_px", "half_width_px", "opacity", "flags"):
        np.testing.assert_allclose(
            getattr(other.profiles, name), getattr(one.profiles, name), rtol=1e-3, atol=1e-3
        )


@few
@given(seed=seeds, tilt=tilts, factor=st.floats(0.01, 100))
def test_another_exposure_scales_the_speed_alone(seed, tilt, factor):
    shot = rendered(seed, tilt, 0.2)
    one, other = shot.measure(), replace(shot, exposure=factor * shot.exposure).measure()
    # linear algebra rounds by where in memory its numbers lie
    tiny = 0.01 * min(one.position_std_m)
    np.testing.assert_allclose(other.position_m, one.position_m, rtol=0, atol=tiny)
    np.testing.assert_allclose(other.direction, one.direction, rtol=0, atol=1e-4)
    velocity = np.array(other.velocity_m_s) * factor
    np.testing.assert_allclose(velocity, one.velocity_m_s, atol=0.01 * one.speed_std_m_s)
    np.testing.assert_allclose(other.speed_std_m_s * factor, one.speed_std_m_s, rtol=1e-3)


@few
@given(seed=seeds, tilt=tilts, heading=headings)
def test_rolling_the_camera_rolls_the_answer(seed, tilt, heading):
    """A quarter turn of the picture: what was to the right is now below."""
    shot = rendered(seed, tilt, heading, noise=QUIET)
    c = shot.camera
    turned = Camera(
        width=c.height, height=c.width, fx=c.fy, fy=c.fx, cx=c.height - 1 - c.cy, cy=c.cx
    )
    rolled = seen_by(lambda picture: torch.rot90(picture, -1, (-2, -1)), shot, turned)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert_same(shot, shot.measure(), rolled.measure(), turn)


@few
@given(seed=seeds, tilt=tilts, heading=headings)
def test_a_mirrored_picture_mirrors_the_answer(seed, tilt, heading):
    shot = rendered(seed, tilt, heading, noise=QUIET)
    c = shot.camera
    mirrored = seen_by(lambda picture: picture.flip(-1), shot, replace(c, cx=c.width - 1 - c.cx))
    assert_same(shot, shot.measure(), mirrored.measure(), np.diag([-1.0, 1.0, 1.0]))


@few
@given(seed=seeds, factor=st.floats(0.3, 0.95))
def test_less_light_changes_nothing(seed, factor):
    shot = rendered(seed, 0.25, 0.2, noise=QUIET)
    colour = tuple(factor * value for value in shot.estimator.colour)

    def darker(image):
        return replace(image, rgb=factor * image.rgb)

    dim = replace(
        shot,
        image=darker(shot.image),
        background=darker(shot.background),
        estimator=Uniform(colour=colour),
    )
    assert_same(shot, shot.measure(), dim.measure(), np.eye(3))


@few
@given(seed=seeds)
def test_double_speed_halves_the_opacity(seed):
    opacity, speed = [], []
    for length in (3.0, 6.0):
        shot = rendered(seed, 0.0, 0.2, length, noise=QUIET)
        view = observe_streak(shot.image, shot.background, shot.estimator)
        fit, _ = fit_streak(view, shot.estimator)
        opacity.append(float(fit.opacity[fit.good].median()))
        speed.append(shot.measure().speed_m_s)
    assert abs(opacity[0] / opacity[1] / 2 - 1) < 0.01
    assert abs(speed[1] / speed[0] / 2 - 1) < 0.01
