import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from toolkit.camera import Camera
from toolkit.errors import ConfigError, ShapeError
from toolkit.synthetic import (
    LambertBall,
    NoiseLevel,
    PlainBall,
    Scene,
    StraightPath,
    StripedBall,
    benchmark_scene,
    flat_background,
    render_shot,
    textured_background,
)

LENS = (-0.2, 0.06, 1e-3, -5e-4, 0.0)
COLOUR = (0.8, 0.5, 0.1)


def make_scene(**changes):
    """A ball 24 px wide that stands still off the axis, in front of grey, without blur or noise."""
    camera = Camera(width=120, height=90, fx=150.0, fy=150.0, cx=60.0, cy=45.0)
    values = {
        "camera": camera,
        "path": StraightPath(start=(0.08, -0.06, 0.6), start_velocity=(0.0, 0.0, 0.0)),
        "ball_radius": 0.05,
        "exposure": 0.01,
        "appearance": PlainBall(colour=COLOUR),
        "background": flat_background(120, 90),
        "blur": 0.0,
    }
    return Scene(**(values | changes))


def moving(**changes):
    path = StraightPath(start=(-0.09, -0.02, 0.6), start_velocity=(17.0, 5.0, 2.0))
    return make_scene(path=path, **changes)


def exact_alpha(scene, samples=6):
    """The closed form for straight motion, averaged over each pixel."""
    camera, exposure = scene.camera, scene.exposure
    sub = (torch.arange(samples).double() + 0.5) / samples - 0.5
    x = (torch.arange(camera.width)[:, None] + sub).flatten()
    y = (torch.arange(camera.height)[:, None] + sub).flatten()
    u = camera.unproject(torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1))
    start = torch.tensor([0.0], dtype=torch.float64)
    w = torch.linalg.cross(scene.path.velocity(start).expand_as(u), u)
    m = torch.linalg.cross(scene.path.position(start).expand_as(u), u)
    a, b = (w * w).sum(-1), (w * m).sum(-1)
    root = (b * b - a * ((m * m).sum(-1) - scene.ball_radius**2)).clamp_min(0).sqrt()
    first, last = ((-b - root) / a).clamp(0, exposure), ((-b + root) / a).clamp(0, exposure)
    alpha = (last - first) / exposure
    cells = alpha.reshape(camera.height, samples, camera.width, samples)
    return cells.mean(dim=(1, 3))


def test_a_still_ball_covers_the_ellipse_of_its_image():
    scene = make_scene()
    shot = render_shot(scene, supersampling=8)
    # the cone u.C >= sqrt(C.C - R^2) cut by the image plane; its area from the conic's determinants
    C = np.array(scene.path.start)
    Q = np.outer(C, C) - (C @ C - scene.ball_radius**2) * np.eye(3)
    area = math.pi * abs(np.linalg.det(Q)) / abs(np.linalg.det(Q[:2, :2])) ** 1.5
    assert float(shot.alpha.sum()) == pytest.approx(area * scene.camera.fx**2, rel=2e-3)
    assert shot.alpha.max() == 1


@pytest.mark.parametrize("distortion", [(), LENS])
def test_a_straight_streak_agrees_with_the_closed_form(distortion):
    camera = replace(make_scene().camera, distortion=distortion)
    scene = moving(camera=camera)
    difference = render_shot(scene).alpha - exact_alpha(scene, samples=8)
    assert difference.abs().max() < 5e-4
    assert difference.pow(2).mean().sqrt() < 4e-5
    assert float(difference.sum()) == pytest.approx(0, abs=5e-3)


def test_more_instants_come_closer_to_the_closed_form():
    scene = moving()
    exact = exact_alpha(scene)
    errors = [
        float((render_shot(scene, step=step, supersampling=6).alpha - exact).pow(2).mean().sqrt())
        for step in (8.0, 2.0, 0.5)
    ]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_without_blur_the_shot_is_the_paper_s_mixture():
    scene = moving(background=textured_background(120, 90, seed=4))
    shot = render_shot(scene)
    alpha, ball = shot.alpha, torch.tensor(COLOUR)[:, None, None]
    mixture = alpha * ball + (1 - alpha) * scene.background
    assert torch.allclose(shot.clean_image, mixture, atol=1e-6)
    assert torch.equal(shot.clean_background, scene.background)


def test_the_lens_blurs_ball_and_background_alike():
    scene = moving(background=textured_background(120, 90, seed=4), blur=1.1)
    fine = replace(scene, blur=0.0)
    shot, sharp = render_shot(scene), render_shot(fine)
    kernel = torch.exp(-0.5 * (torch.arange(-6, 7) / 1.1) ** 2)
    kernel = (kernel / kernel.sum()).expand(3, 1, 1, 13)

    def blurred(picture):
        padded = torch.nn.functional.pad(picture[None], (6, 6, 6, 6), mode="replicate")
        across = torch.nn.functional.conv2d(padded, kernel, groups=3)
        return torch.nn.functional.conv2d(across, kernel.mT, groups=3)[0]

    # blurring whole pixels differs a little from blurring within them
    assert (shot.clean_image - blurred(sharp.clean_image)).abs().max() < 4e-3
    assert (shot.clean_background - blurred(sharp.clean_background)).abs().max() < 4e-3
    is_far = torch.nn.functional.max_pool2d(shot.alpha[None], 21, 1, 10)[0] == 0
    assert torch.equal(shot.clean_image[:, is_far], shot.clean_background[:, is_far])


def test_a_ball_that_leaves_the_picture_is_cut_off():
    path = StraightPath(start=(-0.30, 0.0, 0.6), start_velocity=(30.0, 0.0, 0.0))
    scene = make_scene(path=path, blur=0.7)
    shot = render_shot(scene)
    assert shot.alpha[:, 0].max() > 0
    assert (shot.alpha - exact_alpha(scene, samples=16)).abs().max() < 4e-4


def test_seeds_repeat_and_shot_and_background_have_their_own_noise():
    scene = moving(noise=NoiseLevel(read=0.01, gain=1e-4))
    first, again, other = render_shot(scene, seed=1), render_shot(scene, seed=1), render_shot(scene)
    assert torch.equal(first.image.rgb, again.image.rgb)
    assert not torch.equal(first.image.rgb, other.image.rgb)
    shot_noise = (first.image.rgb[0] - first.clean_image).flatten()
    background_noise = (first.background.rgb[0] - first.clean_background).flatten()
    correlation = torch.corrcoef(torch.stack([shot_noise, background_noise]))[0, 1]
    assert correlation.abs() < 0.02  # 32 400 samples: 0.006 expected
    assert float(shot_noise.var()) == pytest.approx(0.01**2 + 1e-4 * 0.3, rel=0.05)


def test_new_noise_on_the_same_shot_equals_a_new_rendering():
    scene = moving(noise=NoiseLevel(read=0.01))
    assert torch.equal(
        render_shot(scene, seed=1).with_noise(9).image.rgb, render_shot(scene, seed=9).image.rgb
    )
    quiet = render_shot(scene, seed=1).with_noise(9, NoiseLevel())
    assert torch.equal(quiet.image.rgb[0], quiet.clean_image)


def test_pictures_carry_shape_exposure_and_clipping():
    scene = moving(background=flat_background(120, 90, (0.2, 0.3, 1.2)))
    shot = render_shot(scene)
    assert shot.image.rgb.shape == (1, 3, 90, 120)
    assert shot.image.rgb.dtype == torch.float32
    assert shot.image.exposure.tolist() == [0.01]
    assert shot.background.clipped.shape == (1, 1, 90, 120)
    assert shot.background.clipped.all()
    assert shot.background.rgb.max() == 1


def test_the_state_is_that_of_mid_exposure():
    shot = render_shot(moving())
    assert shot.position.tolist() == pytest.approx([-0.005, 0.005, 0.61])
    assert shot.velocity.tolist() == [17.0, 5.0, 2.0]


def test_a_lambert_ball_under_ambient_light_only_is_plain():
    lit = LambertBall(colour=COLOUR, ambient=1.0)
    plain, shaded = render_shot(moving()), render_shot(moving(appearance=lit))
    assert torch.allclose(plain.clean_image, shaded.clean_image, atol=2e-5)


def test_a_lamp_beside_the_camera_lights_the_middle_fully_and_the_rim_dimly():
    lamp = LambertBall(colour=(1.0, 1.0, 1.0), ambient=0.0, light=(-0.08, 0.06, -0.6))
    scene = make_scene(appearance=lamp)
    shot = render_shot(scene, supersampling=5)
    x, y = scene.camera.project(shot.position).round().int().tolist()
    assert shot.clean_image[0, y, x] == pytest.approx(1, abs=2e-3)
    # light falls as sqrt(1 - s^2) of the distance from the middle: 0.8 at 0.6 of the radius
    half = math.sqrt(float(shot.alpha.sum()) / math.pi)
    assert shot.clean_image[0, y - round(0.6 * half), x] == pytest.approx(0.8, abs=0.06)


def test_appearances_get_outward_unit_normals_and_the_time():
    seen = []

    def watch(normal, time):
        seen.append((normal, time))
        return normal.abs()

    scene = make_scene(appearance=watch)
    render_shot(scene)
    normal, time = seen[0]
    assert time == scene.exposure / 2
    assert torch.allclose(normal.norm(dim=-1), torch.ones(len(normal)), atol=1e-4)
    centre = torch.tensor(scene.path.start, dtype=torch.float64)
    surface = centre + scene.ball_radius * normal.double()
    assert ((surface * normal).sum(-1) < 1e-6).all()  # all face the camera
    assert (normal.double() @ centre).min() < -0.99 * centre.norm()


def test_a_striped_ball_shows_both_pigments_and_turns():
    red, white = (0.8, 0.1, 0.1), (0.9, 0.9, 0.9)
    ball = StripedBall(colours=(red, white), spin=(0.0, math.pi / 2 / 0.01, 0.0))
    normal = torch.tensor([[0.99, 0.0, -0.1], [0.0, 0.1, -0.99]], dtype=torch.float64)
    assert torch.allclose(ball(normal, 0.0)[0], torch.tensor(red).double())
    # after a quarter turn about y the pole x has moved to -z, towards the camera
    assert torch.allclose(ball(normal, 0.01)[1], torch.tensor(red).double())
    still = StripedBall(colours=(red, white))
    shot = render_shot(make_scene(appearance=still))
    green = shot.clean_image[1][shot.alpha == 1]
    assert (green < 0.15).any()
    assert (green > 0.85).any()


def test_a_streak_five_widths_long_is_a_fifth_opaque():
    shot = render_shot(benchmark_scene())
    assert shot.alpha.max() == pytest.approx(0.2, abs=0.005)


@pytest.mark.parametrize("blur", [0.0, 0.6])
@pytest.mark.parametrize("velocity", [(12.0, 8.0, 2.0), (10.0, -9.0, 1.0)])
@pytest.mark.parametrize("ball", [PlainBall(colour=COLOUR), LambertBall(colour=COLOUR)])
def test_a_row_of_a_rolling_shutter_shows_what_a_later_exposure_would(velocity, blur, ball):
    start = (-0.11, -0.04 if velocity[1] > 0 else 0.12, 0.6)
    path = StraightPath(start=start, start_velocity=velocity)
    background = textured_background(120, 90, seed=4)
    scene = make_scene(path=path, blur=blur, background=background, appearance=ball, readout=6e-3)
    shot = render_shot(scene)
    for row in (12, 40, 44, 51):
        later = torch.tensor(start) + torch.tensor(velocity) * (6e-3 * row / 89)
        global_path = StraightPath(start=tuple(later.tolist()), start_velocity=velocity)
        expected = render_shot(replace(scene, path=global_path, readout=0.0))
        assert (shot.clean_image[:, row] - expected.clean_image[:, row]).abs().max() < 2e-4
        assert (shot.alpha[row] - expected.alpha[row]).abs().max() < 5e-4
    assert shot.alpha.max() > 0.1


def test_a_ball_that_falls_with_the_readout_leaves_the_longer_streak():
    def height(speed):
        path = StraightPath(start=(0.0, -0.005 * speed, 0.6), start_velocity=(0.0, speed, 0.0))
        shot = render_shot(make_scene(path=path, readout=4e-3))
        return int((shot.alpha.amax(dim=1) > 0).sum())

    along, against = height(10.0), height(-10.0)
    # 25 px in the exposure, and 24 px of the ball, of which the readout makes tau v = 0.11 more
    assert along == pytest.approx((25 + 24) / (1 - 0.112), abs=3)
    assert against == pytest.approx((25 + 24) / (1 + 0.112), abs=3)


def test_truth_may_be_asked_for_at_any_time():
    shot = render_shot(moving(readout=5e-3))
    assert shot.position_at(0.0).tolist() == pytest.approx([-0.09, -0.02, 0.6])
    assert shot.position_at(0.02).tolist() == pytest.approx([0.25, 0.08, 0.64])
    assert shot.velocity_at(0.02).tolist() == [17.0, 5.0, 2.0]


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_ball_s_own_row_is_exposed_at_its_own_time(share):
    scene = moving(readout=5e-3)
    time = scene.own_time(share)
    position = scene.path.position(torch.tensor([time], dtype=torch.float64))
    row = float(scene.camera.project(position)[0, 1])
    assert time == pytest.approx(row * 5e-3 / 89 + share * 0.01, abs=1e-12)
    assert moving().own_time(share) == share * 0.01


def test_a_slow_readout_shows_only_the_ball_that_passes_its_rows():
    # it crosses the picture in 14 ms, long before the lower rows are exposed
    path = StraightPath(start=(-0.30, 0.10, 0.6), start_velocity=(60.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="never inside the picture"):
        render_shot(make_scene(path=path, exposure=1e-3, readout=0.3))


def test_contours_bound_the_streak_of_a_rolling_shutter():
    scene = moving(readout=8e-3)
    shot = render_shot(scene)
    contours = shot.contours()
    inside = contours.mean(dim=0).round().long()
    assert (shot.alpha[inside[10:-10, 1], inside[10:-10, 0]] > 0.2).all()
    ends = scene.camera.project(
        scene.path.position(torch.tensor([scene.own_time(0.0), scene.own_time(1.0)]))
    )
    assert torch.allclose(contours.mean(dim=0)[[0, -1]], ends, atol=0.4)


def test_impossible_scenes_are_refused():
    with pytest.raises(ConfigError, match="readout is -1"):
        make_scene(readout=-1.0)
    away = StraightPath(start=(5.0, 0.0, 0.6), start_velocity=(0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="never inside the picture"):
        render_shot(make_scene(path=away))
    through = StraightPath(start=(0.0, 0.0, 0.6), start_velocity=(0.0, 0.0, -60.0))
    with pytest.raises(ConfigError, match="move the path away"):
        render_shot(make_scene(path=through))
    with pytest.raises(ShapeError, match="background"):
        make_scene(background=flat_background(90, 120))
    with pytest.raises(ConfigError, match="exposure 0"):
        make_scene(exposure=0)
