"""The rough motion that short streaks start from, against rendered truth."""

import pytest
import torch

from plugins.uniform import Uniform
from toolkit import Camera
from toolkit.rough_motion import rough_motion
from toolkit.synthetic import (
    BouncingPath,
    NoiseLevel,
    PlainBall,
    Scene,
    benchmark_scene,
    render_shot,
    textured_background,
)
from toolkit.synthetic.scenes import contrasting_colour
from toolkit.view import observe_streak

TENTH = 0.1


def rendered(width, length, noise=0.01, seed=0, **scene):
    level = NoiseLevel(read=noise)
    return render_shot(
        benchmark_scene(width_px=width, length_widths=length, noise=level, seed=seed, **scene),
        seed=seed,
    )


def roughly_moved(shot, estimator):
    view = observe_streak(shot.image, shot.background, estimator)
    return rough_motion(view, estimator, shot.scene.camera, shot.scene.ball_radius)


def true_path(shot, found):
    """The true path at the same shares of the exposure, in the direction that was found."""
    time = torch.linspace(0, shot.scene.exposure, len(found.path), dtype=torch.float64)
    path = shot.scene.path.position(time)
    return path if ((path[-1] - path[0]) @ (found.path[-1] - found.path[0])) > 0 else path.flip(0)


def check_near(shot, found):
    """Centres within a tenth of the ball's image, depths within a tenth, 0.2 widths of length."""
    camera, truth = shot.scene.camera, true_path(shot, found)
    middle = len(truth) // 2
    half_width = camera.fx * shot.scene.ball_radius / float(truth[middle].norm())
    pixels, true_pixels = camera.project(found.path), camera.project(truth)
    assert float((pixels - true_pixels)[middle].norm()) < TENTH * half_width
    assert float(found.path[middle].norm() / truth[middle].norm()) == pytest.approx(1, abs=TENTH)
    length, true_length = (
        float(p.diff(dim=0).norm(dim=-1).sum()) / (2 * half_width) for p in (pixels, true_pixels)
    )
    assert length == pytest.approx(true_length, abs=0.2)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize(
    ("width", "length", "noise"), [(20, 1.0, 0.03), (40, 0.3, 0.01), (60, 2.5, 0.02)]
)
def test_a_short_streak_says_roughly_how_the_ball_moved(width, length, noise, is_known):
    shot = rendered(width, length, noise, tilt=0.4, seed=width)
    colour = shot.scene.appearance.colour
    found = roughly_moved(shot, Uniform(colour=colour) if is_known else Uniform())
    check_near(shot, found)
    assert found.corner is None
    if is_known:
        assert found.colour is None
    else:
        assert torch.allclose(found.colour, torch.tensor(colour).double(), atol=0.03)


def bounced(width, length, share, *, noise=0.01, seed=0, restitution=0.8, **ball):
    """A shot of a ball 50 radii away that bounces at a share of the exposure, 0 to 1."""
    radius, distance, exposure = 0.05, 2.5, 0.02
    focal, speed = width / 2 / radius * distance, 2 * radius * length / exposure
    down, along = 0.8 * speed, 0.6 * speed
    path = BouncingPath(
        start=(-along * exposure / 2, -down * exposure * share, distance),
        start_velocity=(along, down, 0.3 * speed),
        contact_height=0.0,
        acceleration=(0.0, 0.2 * speed / exposure, 0.0),
        restitution=restitution,
    )
    side = int(width * (length + 3)) + 60
    background = textured_background(side, side, contrast=0.1, seed=seed)
    scene = Scene(
        camera=Camera.centred(side, side, focal),
        path=path,
        ball_radius=radius,
        exposure=exposure,
        appearance=PlainBall(colour=contrasting_colour(background, 0.4)),
        background=background,
        noise=NoiseLevel(read=noise),
    )
    return render_shot(scene, seed=seed, step=0.4, supersampling=2)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize(
    ("width", "length", "share", "noise"),
    [(60, 1.0, 0.4, 0.01), (40, 2.0, 0.7, 0.03), (24, 5.0, 0.5, 0.01)],
)
def test_a_bounce_is_found_with_its_place_and_time(width, length, share, noise, is_known):
    shot = bounced(width, length, share, noise=noise)
    colour = shot.scene.appearance.colour if is_known else None
    found = roughly_moved(shot, Uniform(colour=colour))
    camera, truth = shot.scene.camera, true_path(shot, found)
    apart = (camera.project(found.path) - camera.project(truth)).norm(dim=-1)
    assert float(apart.mean()) < TENTH * width / 2
    depths = found.path.norm(dim=-1) / truth.norm(dim=-1)
    assert float(depths.mean()) == pytest.approx(1, abs=TENTH)
    bounce = shot.scene.path.bounce_time / shot.scene.exposure - 0.5
    assert found.corner == pytest.approx(bounce, abs=0.05)
