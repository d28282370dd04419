"""The whole measurement: what it reports, and what it refuses."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit import Camera, ConfigError, MismatchError, ProfileFlag, StreakError, measure, pipeline
from toolkit.synthetic import (
    BouncingPath,
    NoiseLevel,
    PlainBall,
    Scene,
    add_noise,
    benchmark_scene,
    preset_scene,
    render_shot,
    textured_background,
)


@pytest.fixture(scope="module")
def shot():
    scene = benchmark_scene(width_px=30, length_widths=5, heading=0.4, tilt=0.2, seed=4)
    return render_shot(scene, seed=4)


def run(shot, image=None, background=None, colour=None, **changes):
    scene = shot.scene
    settings = {
        "camera": scene.camera,
        "ball_radius": scene.ball_radius,
        "exposure": scene.exposure,
        "estimator": Uniform(colour=colour or scene.appearance.colour),
    }
    return measure(image or shot.image, background or shot.background, **settings | changes)


def codes(result):
    return {caution.code for caution in result.warnings}


@pytest.mark.parametrize("stage", ["contours", "sweep"])
def test_a_whole_measurement_agrees_with_the_truth(shot, stage):
    result = run(shot, stage=stage)
    assert result.status == "ok"
    assert (result.estimator, result.stage) == ("uniform", stage)
    error = np.abs(np.array(result.position_m) - shot.position.numpy())
    assert (error < 4 * np.array(result.position_std_m)).all()
    speed = float(shot.velocity.norm())
    assert abs(result.speed_m_s - speed) < 4 * result.speed_std_m_s
    assert result.speed_std_m_s < 0.05 * speed
    assert codes(result) == {"camera-uncertainty-unknown"}


def test_both_signs_are_reported(shot):
    result = run(shot)
    assert result.sign.ambiguous
    assert result.direction[0] > 0
    (other,) = result.sign.alternatives
    np.testing.assert_allclose(other.velocity_m_s, -np.array(result.velocity_m_s))
    assert other.probability + result.sign.probability == 1


def test_profiles_at_both_ends_are_left_out(shot):
    flags = np.array(run(shot).profiles.flags)
    is_end = (flags & int(ProfileFlag.END)) > 0
    assert is_end[:15].all()
    assert is_end[-15:].all()
    assert not is_end[len(flags) // 2]


def test_the_path_runs_through_the_exposure(shot):
    path = run(shot).trajectory
    assert path.time_s[0] == 0
    assert path.time_s[-1] == pytest.approx(shot.scene.exposure)
    ends = shot.scene.path.position(torch.tensor([0.0, shot.scene.exposure], dtype=torch.float64))
    found = np.array(path.position_m)[[0, -1]]
    found = found if np.dot(found[1] - found[0], (ends[1] - ends[0]).numpy()) > 0 else found[::-1]
    assert np.abs(found - ends.numpy())[:, :2].max() < 0.2 * shot.scene.ball_radius


def test_without_an_exposure_only_the_speed_is_missing(shot):
    result, full = run(shot, exposure=None), run(shot)
    assert result.speed_m_s is None
    assert result.velocity_m_s is None
    assert result.state_covariance is None
    assert result.time_s is None
    assert result.position_m == pytest.approx(full.position_m, abs=0.01 * min(full.position_std_m))
    assert "exposure-unknown" in codes(result)


def test_radius_and_exposure_errors_enter_the_budget(shot):
    scene = shot.scene
    result = run(shot, ball_radius_std=0.02 * scene.ball_radius, exposure_std=0.03 * scene.exposure)
    plain = run(shot)
    extra = result.speed_std_m_s**2 - plain.speed_std_m_s**2
    assert extra == pytest.approx(plain.speed_m_s**2 * (0.02**2 + 0.03**2), rel=1e-6)
    depth = result.position_std_m[2] ** 2 - plain.position_std_m[2] ** 2
    assert depth == pytest.approx((0.02 * plain.position_m[2]) ** 2, rel=1e-6)
    shares = result.budget.speed
    assert shares.noise + shares.radius + shares.exposure + shares.response == pytest.approx(1)


def test_a_camera_s_covariance_enters_the_depth(shot):
    camera = shot.scene.camera
    sigma = 0.01 * camera.fx
    covariance = torch.diag(torch.tensor([sigma**2, sigma**2, 1e-6, 1e-6], dtype=torch.float64))
    covariance[0, 1] = covariance[1, 0] = sigma**2  # one focal length
    result = run(shot, camera=replace(camera, covariance=covariance))
    plain = run(shot)
    added = result.position_std_m[2] ** 2 - plain.position_std_m[2] ** 2
    assert added**0.5 == pytest.approx(0.01 * plain.position_m[2], rel=0.05)


def test_a_camera_known_exactly_needs_no_caution(shot):
    camera = replace(shot.scene.camera, covariance=torch.zeros(4, 4, dtype=torch.float64))
    result, plain = run(shot, camera=camera), run(shot)
    assert codes(result) == set()
    assert (result.budget.depth.camera, plain.budget.depth.camera) == (0, None)
    assert np.allclose(result.state_covariance, plain.state_covariance, rtol=1e-3)


@pytest.mark.parametrize(
    ("stage", "code"), [("contours", "opacity-and-ends-disagree"), ("sweep", "other-colour")]
)
def test_a_wrong_colour_shows_and_widens_the_speed(shot, stage, code):
    red, green, blue = shot.scene.appearance.colour
    result = run(shot, colour=(0.8 * red, 0.8 * green, 0.8 * blue), stage=stage)
    assert code in codes(result)
    assert abs(result.speed_m_s - float(shot.velocity.norm())) < 3 * result.speed_std_m_s


def test_a_change_of_light_is_corrected_and_reported(shot):
    darker = replace(shot.background, rgb=0.97 * shot.background.rgb)
    result, plain = run(shot, background=darker), run(shot)
    assert "background-brightness" in codes(result)
    gap = np.array(result.position_m) - np.array(plain.position_m)
    assert np.linalg.norm(gap) < 1.5 * np.linalg.norm(plain.position_std_m)


@pytest.mark.parametrize("light", [0.5, 0.75, 1.3])
def test_quite_another_light_is_followed(shot, light):
    clean = light * shot.scene.background
    noisy = add_noise(clean, shot.scene.noise, 99)[None]
    result = run(shot, background=replace(shot.background, rgb=noisy))
    assert "background-brightness" in codes(result)
    error = np.abs(np.array(result.position_m) - shot.position.numpy())
    assert (error < 4 * np.array(result.position_std_m)).all()
    assert abs(result.speed_m_s - float(shot.velocity.norm())) < 4 * result.speed_std_m_s


def test_a_background_that_does_not_fit_is_named(shot):
    start = "^background and shot do not fit together: "
    shifted = replace(shot.background, rgb=shot.background.rgb.roll(6, -1))
    with pytest.raises(MismatchError, match=start + "the camera moved"):
        run(shot, background=shifted)
    elsewhere = replace(shot.background, rgb=shot.background.rgb.flip(-1))
    with pytest.raises(MismatchError, match=start + "most of what stands out"):
        run(shot, background=elsewhere)
    black = replace(shot.background, rgb=0 * shot.background.rgb)
    with pytest.raises(MismatchError, match=start + ".* times as bright"):
        run(shot, background=black)


def test_the_same_picture_gives_the_same_answer(shot):
    assert replace(run(shot), timing_s={}) == replace(run(shot), timing_s={})


def test_a_shot_without_a_ball_is_refused(shot):
    with pytest.raises(StreakError, match="no ball found"):
        run(shot, image=shot.background)


def test_a_streak_that_leaves_the_picture_is_refused(shot):
    width = shot.image.width // 2
    cut = {
        "image": shot.image.window(0, 0, width, shot.image.height),
        "background": shot.background.window(0, 0, width, shot.image.height),
        "camera": shot.scene.camera.cropped(0, 0, width, shot.image.height),
    }
    with pytest.raises(StreakError, match="leaves the picture"):
        run(shot, **cut)


def test_a_short_streak_is_measured_by_its_exact_image_but_not_by_its_contours():
    short = render_shot(benchmark_scene(width_px=40, length_widths=0.9, seed=1), seed=1)
    result = run(short)
    assert (result.stage, result.profiles) == ("sweep", None)
    error = np.abs(np.array(result.position_m) - short.position.numpy())
    assert (error < 4 * np.array(result.position_std_m)).all()
    speed = float(short.velocity.norm())
    assert abs(result.speed_m_s - speed) < 4 * result.speed_std_m_s < 0.2 * speed
    with pytest.raises(StreakError, match=r"too short .* about 2\.6 widths are needed") as refusal:
        run(short, stage="contours")
    length, width, widths = re.search(
        r"a streak (\d+) px long and (\d+) px wide \((\S+) widths\)", str(refusal.value)
    ).groups()
    assert float(length) == pytest.approx(1.9 * 40, abs=6)
    assert float(width) == pytest.approx(40, abs=6)
    assert float(widths) == pytest.approx(1.9, abs=0.3)


def test_a_streak_of_the_least_length_is_measured():
    short = render_shot(benchmark_scene(width_px=60, length_widths=1.7, seed=1), seed=1)
    result = run(short)
    error = np.abs(np.array(result.position_m) - short.position.numpy())
    assert (error < 3 * np.array(result.position_std_m)).all()
    assert abs(result.speed_m_s - float(short.velocity.norm())) < 3 * result.speed_std_m_s


def test_a_bounce_has_no_contours_to_follow():
    scene = preset_scene("bounce", size=(600, 400), seed=0)
    with pytest.raises(StreakError, match="corner"):
        run(render_shot(scene, seed=0), stage="contours")


@pytest.mark.parametrize("exposure", [0.5, 1.0])
def test_a_throw_and_a_bounce_are_followed_through_a_long_exposure(exposure):
    scene = Scene(
        camera=Camera.centred(300, 210, 375.0),
        path=BouncingPath(
            start=(-0.31, 0.165, 0.94), start_velocity=(0.62, -2.75, 0.14), contact_height=0.17
        ),
        ball_radius=0.02,
        exposure=exposure,
        appearance=PlainBall(colour=(0.9, 0.9, 0.9)),
        background=textured_background(300, 210, colour=(0.12, 0.12, 0.12), contrast=0.05),
        noise=NoiseLevel(read=0.003),
    )
    found = run(render_shot(scene, seed=0), colour=(0.9, 0.9, 0.9))
    assert found.stage == "sweep"
    time = torch.linspace(0, exposure, 2001, dtype=torch.float64)
    true = scene.path.position(time).numpy()
    path, std = np.array(found.trajectory.position_m), np.array(found.trajectory.position_std_m)
    gaps = np.array([np.linalg.norm(true - point, axis=-1).min() for point in path])
    assert gaps.mean() < 0.1 * scene.ball_radius
    assert (gaps < 4 * np.linalg.norm(std, axis=-1)).all()


def test_inputs_that_do_not_fit_are_named(shot):
    small = shot.background.window(0, 0, 50, 40)
    with pytest.raises(MismatchError, match="background is 50x40"):
        run(shot, background=small)
    with pytest.raises(MismatchError, match="camera"):
        run(shot, camera=replace(shot.scene.camera, width=333))


@pytest.mark.parametrize(
    "change",
    [
        {"ball_radius": 0.0},
        {"ball_radius": float("nan")},
        {"exposure": -1.0},
        {"ball_radius_std": -0.1},
        {"exposure_std": float("inf")},
    ],
)
def test_impossible_numbers_are_named(shot, change):
    name = next(iter(change)).replace("_", " ")
    with pytest.raises(ConfigError, match=name):
        run(shot, **change)


def test_a_streak_along_the_border_is_measured_by_what_is_seen_of_it_but_has_no_contours():
    scene = benchmark_scene(width_px=30, length_widths=5, heading=0.0, seed=4)
    level = render_shot(scene, seed=4)
    # cuts through the ball's image all along a level streak
    top = int(level.scene.camera.project(level.position)[1]) - 4
    size = (0, top, level.image.width, level.image.height - top)
    cut = {
        "image": level.image.window(*size),
        "background": level.background.window(*size),
        "camera": scene.camera.cropped(*size),
    }
    with pytest.raises(StreakError, match="leaves the picture"):
        run(level, **cut, stage="contours")
    result = run(level, **cut)
    error = np.abs(np.array(result.position_m) - level.position.numpy())
    assert (error < 4 * np.array(result.position_std_m)).all()
    assert abs(result.speed_m_s - float(level.velocity.norm())) < 4 * result.speed_std_m_s


@pytest.mark.parametrize("stage", ["contours", "sweep"])
def test_a_camera_without_an_inverse_is_refused(shot, stage):
    wild = replace(shot.scene.camera, distortion=(0.1, 0.2, 0.0, 0.0, -5e9))
    with pytest.raises(StreakError, match="distortion cannot be inverted"):
        run(shot, camera=wild, stage=stage)


def test_a_depth_that_is_not_known_is_refused(shot, monkeypatch):
    monkeypatch.setattr(pipeline, "LOST_DEPTH", 1e-4)
    with pytest.raises(StreakError, match="the ball's depth is not determined"):
        run(shot)


def lost(*_, **__):
    raise StreakError("no motion explains it")


def test_where_the_exact_streak_fails_the_contours_stand_in(shot, monkeypatch):
    monkeypatch.setattr(pipeline, "refine", lost)
    result = run(shot)
    assert result.stage == "contours"
    assert "sweep-failed" in codes(result)
    (caution,) = (caution for caution in result.warnings if caution.code == "sweep-failed")
    assert "no motion explains it" in caution.message


def test_behind_a_rolling_shutter_nothing_stands_in(shot, monkeypatch):
    monkeypatch.setattr(pipeline, "refine", lost)
    with pytest.raises(StreakError, match="no motion explains it"):
        run(shot, readout=0.01)


def test_contours_say_that_they_leave_the_readout_out(shot):
    assert "readout-left-out" in codes(run(shot, stage="contours", readout=0.01))
    assert "readout-left-out" not in codes(run(shot, stage="contours"))
