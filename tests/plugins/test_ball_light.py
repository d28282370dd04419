import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from plugins.ball_light import BallLight, picture_noise
from plugins.known_shading import KnownShading
from toolkit import Camera, Chord, Disc
from toolkit.ball import SharpBall
from toolkit.sweep.doubt import J_state, sweep_uncertainty
from toolkit.sweep.fit import fit_sweep
from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import STRAIGHT
from toolkit.sweep.pixels import Frame
from toolkit.synthetic import (
    LambertBall,
    NoiseLevel,
    Scene,
    StraightPath,
    flat_background,
    render_shot,
    true_disc,
)

RADIUS = 0.05
MATT = LambertBall(colour=(0.8, 0.6, 0.1), light=(-0.5, -0.4, -0.75), ambient=0.4)
CAMERA = Camera.centred(320, 240, 300.0, distortion=(-0.1, 0.02, 0.0, 0.0))
NODES = 257


def scene(velocity=(0.0, 0.0, 0.0), middle=(0.0, 0.0, 15 * RADIUS)):
    start = tuple(m - v * 0.01 for m, v in zip(middle, velocity, strict=True))
    return Scene(
        camera=CAMERA,
        path=StraightPath(start=start, start_velocity=velocity),
        ball_radius=RADIUS,
        exposure=0.02,
        appearance=MATT,
        background=flat_background(320, 240, (0.3, 0.3, 0.3)),
        blur=0.0,
    )


def seen_sharply(centre):
    """The light of the disc of a ball there, without a picture of it."""
    disc, middle = true_disc(scene(), centre), torch.tensor(centre, dtype=torch.float64)
    line = torch.linspace(-1, 1, NODES, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1)
    place = place * (0.999 / place.norm(dim=-1, keepdim=True)).clamp_max(1)
    ray = CAMERA.unproject(disc.from_unit(place))
    near = ray @ middle
    depth = near - (near**2 - middle @ middle + RADIUS**2).clamp_min(0).sqrt()
    normal = torch.nn.functional.normalize(depth[..., None] * ray - middle, dim=-1)
    light = MATT(normal.reshape(-1, 3), 0.0).mT.reshape(3, NODES, NODES)
    return SharpBall(disc=disc, rgb=light.float())


def some_normals(away, widest, count=400):
    """Evenly drawn within an angle about those that face a viewer who looks along `away`."""
    drawn = torch.randn(20 * count, 3, generator=torch.Generator().manual_seed(0)).double()
    normal = torch.nn.functional.normalize(drawn, dim=-1)
    return normal[normal @ away < -math.cos(widest)][:count]


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.75), (0.25, -0.15, 0.7)])
def test_light_is_found_by_the_normal_of_the_surface(centre):
    light = BallLight.of(seen_sharply(centre), CAMERA)
    centre = torch.tensor(centre, dtype=torch.float64)
    away = centre / centre.norm()
    assert (light.axes @ light.axes.mT - torch.eye(3)).abs().max() < 1e-12
    assert torch.linalg.det(light.axes) == pytest.approx(1)
    assert (light.axes[2] - away).abs().max() < 1e-3
    assert light.sine == pytest.approx(RADIUS / float(centre.norm()), rel=0.01)
    hidden = math.asin(light.sine)
    normal = some_normals(away, math.radians(86) - hidden)
    error = light.at(normal @ light.axes.mT) - MATT(normal, 0.0)
    assert error.abs().max() < 0.008
    assert error.square().mean().sqrt() < 5e-4


def test_from_afar_no_camera_is_needed():
    line = torch.linspace(-1, 1, NODES)
    y, x = torch.meshgrid(line, line, indexing="ij")
    shorter = (0.999 / torch.hypot(x, y)).clamp_max(1)
    x, y = x * shorter, y * shorter
    normal = torch.stack([x, y, -(1 - x * x - y * y).sqrt()], dim=-1)
    rgb = MATT(normal.reshape(-1, 3), 0.0).mT.reshape(3, NODES, NODES)
    disc = Disc(centre=(40.0, 30.0), semi_axes=(20.0, 20.0), angle=0.0, std=0.05)
    light = BallLight.of(SharpBall(disc=disc, rgb=rgb))
    normal = some_normals(torch.tensor([0.0, 0.0, 1.0]).double(), math.radians(86))
    assert light.sine == 0
    assert (light.at(normal) - MATT(normal, 0.0)).abs().max() < 0.005


def test_what_is_hidden_is_continued_as_a_distant_lamp_would_light_it():
    light = BallLight.of(seen_sharply((0.0, 0.0, 0.75)), CAMERA)
    angle = torch.deg2rad(torch.tensor([88.0, 95.0, 105.0, 112.0])).double()
    towards, from_lamp = (
        torch.tensor([sign * 0.5, sign * 0.4]).double() / math.hypot(0.5, 0.4) for sign in (-1, 1)
    )
    for side, most in ((towards, 0.01), (from_lamp, 0.05)):
        normal = torch.cat([angle.sin()[:, None] * side, -angle.cos()[:, None]], dim=-1)
        error = (light.at(normal) - MATT(normal, 0.0)).abs()
        assert error.max() < most
        # to hold the light as it is at the rim would be worse by far on the lamp's side
        if side is towards:
            rim = MATT(normal[:1], 0.0)
            assert (rim - MATT(normal[-1:], 0.0)).abs().max() > 10 * error.max()


def test_light_that_one_lens_cannot_show_stays_finite():
    folded = Camera.centred(401, 301, 150.0, distortion=(-0.4, 0.0, 0.0, 0.0))
    light = BallLight.of(seen_sharply((0.0, 0.0, 0.75)), folded)
    assert torch.isfinite(light.chart).all()


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("depth", [0.0, 6.0])
def test_streaks_far_from_the_sharp_ball_are_foretold(side, depth):
    """Brute force at 15 R, 40 px wide, the view turned by 15 degrees."""
    velocity = (25.0, 10.0, depth)
    shot = render_shot(scene(velocity), step=0.4)
    when = 0.01 + side * 0.007
    centre, motion = shot.position_at(when), shot.velocity_at(when)
    place = CAMERA.project(centre[None])[0]
    step = torch.nn.functional.normalize(CAMERA.J_project(centre[None])[0] @ motion, dim=0)
    rows, columns = shot.alpha.shape
    y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    pixel = torch.stack([x, y], dim=-1).double()
    along, across = (pixel - place) @ step, (pixel - place) @ torch.stack([-step[1], step[0]])
    alpha, image = shot.alpha, shot.clean_image
    is_seen = (along.abs() < 2) & (across.abs() < 15) & (alpha > 0.01)
    ray = CAMERA.unproject(pixel[is_seen])
    ahead = torch.nn.functional.normalize(motion - (ray @ motion)[:, None] * ray, dim=-1)
    light = (image - (1 - alpha) * 0.3)[:, is_seen] / alpha[is_seen]
    right = torch.linalg.cross(ray, ahead, dim=-1)
    # the ray passes the ball, where that is nearest to it, at this offset
    away = torch.linalg.cross(centre.expand_as(ray), motion.expand_as(ray), dim=-1)
    length = torch.linalg.cross(motion.expand_as(ray), ray, dim=-1).norm(dim=-1)
    offset = (ray * away).sum(-1) / length / RADIUS
    assert bool(((right * ray).sum(-1).abs() < 1e-12).all())
    blind = KnownShading(ball=seen_sharply((0.0, 0.0, 0.75)))
    known = blind.seen_through(CAMERA)
    direction = torch.atan2(step[1], step[0])[None]
    held = Chord(offset=offset, direction=direction)
    whole = Chord(offset=offset, direction=direction, place=place[None])
    exact = Chord(offset=offset[None], direction=direction[None], ray=ray[None], ahead=ahead[None])
    errors = [
        float((one.foreground(chord, None).reshape(-1, 3).mT - light).abs().max())
        for one, chord in ((blind, held), (known, whole), (known, exact))
    ]
    assert errors[0] > 0.03
    assert errors[1] < errors[0]
    assert errors[2] < 0.004


def test_noise_of_the_sharp_picture_is_told_from_its_shade():
    ball = seen_sharply((0.0, 0.0, 0.75))
    assert max(picture_noise(ball)) < 3e-4
    generator = torch.Generator().manual_seed(0)
    noise = torch.tensor([0.01, 0.02, 0.005])[:, None, None]
    rgb = ball.rgb + noise * torch.randn(ball.rgb.shape, generator=generator)
    found = torch.tensor(picture_noise(SharpBall(disc=ball.disc, rgb=rgb)))
    assert (found / noise.flatten() - 1).abs().max() < 0.1
    assert KnownShading(ball=ball).other_lights() == ()
    few = SharpBall(disc=ball.disc, rgb=ball.rgb[:, :9, :9])
    assert picture_noise(few) == (0.0, 0.0, 0.0)


def test_a_noisy_picture_whose_shade_is_not_told_is_doubted():
    ball = seen_sharply((0.0, 0.0, 0.75))
    noisy = replace(ball, rgb=ball.rgb + 0.01 * torch.randn(ball.rgb.shape))
    assert list(KnownShading(ball=noisy).doubts()) == ["rim-light-doubted"]
    assert KnownShading(ball=ball).doubts() == {}
    told = replace(noisy, others=noisy.rgb[None])
    assert KnownShading(ball=told).doubts() == {}


def test_what_the_sharp_picture_s_noise_does_to_the_answer_is_stated():
    """Against what the fit's own equations answer to pictures with other noise."""
    shot = render_shot(replace(scene((12.0, 5.0, 0.0)), noise=NoiseLevel(read=0.01)), step=0.5)
    clean, level = seen_sharply((0.0, 0.0, 0.75)), 0.02
    known = KnownShading(ball=clean).seen_through(CAMERA)
    time = torch.linspace(-0.5, 0.5, 3).double()
    points = torch.stack([shot.position_at(0.01 + 0.02 * t) for t in time.tolist()])
    light, empty = shot.image.rgb[0], shot.background.rgb[0]
    noise = torch.full_like(light, 1e-4)
    frame = Frame(
        corner=(0, 0),
        usable=torch.ones(light.shape[1:], dtype=torch.bool),
        signal=light,
        ground=empty,
        shot_variance=noise,
        ground_variance=noise,
        camera=CAMERA,
    )
    model = SweepModel(path=STRAIGHT, estimator=known, camera=CAMERA, ball_radius=RADIUS)
    neutral = torch.tensor([0.1, 1, 1, 1, 0, 0, 0]).double()
    fit = fit_sweep(model, torch.cat([STRAIGHT.through(time, points), neutral]), frame, doubt=1.0)
    alpha = fit.seen.coverage.alpha
    scale = alpha / (noise[0, 0, 0] * (1 + (1 - alpha) ** 2)).sqrt()
    before = model.colours(fit.parameters, fit.pixels, fit.seen.coverage).colour
    answers, generator = [], torch.Generator().manual_seed(1)
    for _ in range(16):
        rgb = clean.rgb + level * torch.randn(clean.rgb.shape, generator=generator)
        noisy = KnownShading(ball=SharpBall(disc=clean.disc, rgb=rgb)).seen_through(CAMERA)
        other = replace(model, estimator=noisy)
        colour = other.colours(fit.parameters, fit.pixels, fit.seen.coverage).colour
        answers.append(J_state(fit) @ fit.seen.answer(scale * (colour - before))[:6])
    scatter = torch.stack(answers)[:, :7].square().mean(0).sqrt()
    options = {"light": None, "ball_radius_std": 0, "exposure_std_share": 0}
    quiet = SimpleNamespace(factor=1.0)
    options |= {"response_changes": torch.zeros(0)}
    stated = [
        sweep_uncertainty(one, quiet, **options).order.diagonal()[:7].sqrt()
        for one in (fit, replace(fit, model=replace(model, estimator=noisy)))
    ]
    assert (stated[0] == 0).all()
    # eight draws against sixteen
    assert (stated[1] / scatter).min() > 0.4
    assert (stated[1] / scatter).max() < 2.5
