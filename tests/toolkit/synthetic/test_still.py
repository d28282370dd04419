import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic import (
    NoiseLevel,
    PlainBall,
    Scene,
    StraightPath,
    StripedBall,
    benchmark_scene,
    flat_background,
    render_sharp,
    render_shot,
)

WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
SPIN = (0.0, 900.0, 0.0)


def off_axis(**changes):
    """A white ball far from the picture's middle, near the camera, in front of black."""
    values = {
        "camera": Camera(width=260, height=200, fx=150.0, fy=150.0, cx=40.0, cy=40.0),
        "path": StraightPath(start=(0.28, 0.21, 0.45), start_velocity=(40.0, 10.0, 5.0)),
        "ball_radius": 0.06,
        "exposure": 0.004,
        "appearance": PlainBall(colour=WHITE),
        "background": flat_background(260, 200, BLACK),
        "blur": 0.0,
    }
    return Scene(**(values | changes))


def moments(picture):
    """Area, centre and covariance of a picture [H, W]."""
    rows, columns = torch.meshgrid(
        *(torch.arange(n).double() for n in picture.shape), indexing="ij"
    )
    weight = picture.double() / picture.double().sum()
    x, y = (weight * columns).sum(), (weight * rows).sum()
    dx, dy = columns - x, rows - y
    xy = (weight * dx * dy).sum()
    covariance = torch.stack([(weight * dx * dx).sum(), xy, xy, (weight * dy * dy).sum()])
    return float(picture.sum()), (float(x), float(y)), covariance.reshape(2, 2)


@pytest.mark.parametrize("distortion", [(), (-0.05, 0.01, 0.0, 0.0, 0.0)])
def test_the_true_disc_has_the_moments_of_the_rendered_one(distortion):
    scene = off_axis()
    scene = replace(scene, camera=replace(scene.camera, distortion=distortion))
    sharp = render_sharp(scene, supersampling=8)
    area, centre, covariance = moments(sharp.alpha)
    longer, shorter = sharp.disc.semi_axes
    assert longer > 1.1 * shorter  # no circle would do
    assert math.pi * longer * shorter == pytest.approx(area, rel=3e-3)
    assert sharp.disc.centre == pytest.approx(centre, abs=0.02)
    # a filled ellipse has variances of a quarter of its squared semi-axes
    axis = torch.tensor([math.cos(sharp.disc.angle), math.sin(sharp.disc.angle)]).double()
    turn = torch.stack([axis, torch.stack([-axis[1], axis[0]])])
    expected = turn.mT @ torch.diag(torch.tensor([longer, shorter]).double() ** 2 / 4) @ turn
    assert torch.allclose(covariance, expected, rtol=0.01, atol=0.3)
    assert sharp.clean_image.max() == 1


def test_the_rim_of_the_true_disc_is_half_covered():
    scene = benchmark_scene(width_px=80, length_widths=3, seed=1)
    sharp = render_sharp(scene, supersampling=8)
    angle = torch.arange(360).double() * (math.pi / 180)
    rim = sharp.disc.from_unit(torch.stack([angle.cos(), angle.sin()], dim=-1))
    size = torch.tensor([scene.camera.width - 1, scene.camera.height - 1])
    alpha = torch.nn.functional.grid_sample(
        sharp.alpha[None, None].double(),
        (2 * rim / size - 1)[None, None],
        align_corners=True,
    )
    assert float(alpha.mean()) == pytest.approx(0.5, abs=0.01)
    assert sum(sharp.disc.semi_axes) == pytest.approx(80, abs=1e-3)


def test_the_ball_rests_where_and_as_it_is_at_mid_exposure():
    ball = StripedBall(colours=(WHITE, BLACK), spin=SPIN)
    scene = off_axis(appearance=ball, background=flat_background(260, 200))
    sharp = render_sharp(scene)
    middle = torch.tensor([scene.exposure / 2], dtype=torch.float64)
    assert list(sharp.position) == scene.path.position(middle)[0].tolist()
    seen = []

    def watch(normal, time):
        seen.append(time)
        return ball(normal, time)

    watched = render_sharp(replace(scene, appearance=watch))
    assert seen == [scene.exposure / 2]
    assert torch.equal(watched.clean_image, sharp.clean_image)


def test_the_ball_can_rest_elsewhere():
    place = (0.05, 0.02, 0.5)
    sharp = render_sharp(off_axis(), position=place)
    assert sharp.position == place
    assert moments(sharp.alpha)[1] == pytest.approx(sharp.disc.centre, abs=0.05)
    with pytest.raises(ConfigError, match="never inside the picture"):
        render_sharp(off_axis(), position=(9.0, 0.0, 0.5))


def test_it_shares_light_lens_and_background_with_the_shot_but_no_noise():
    scene = off_axis(
        blur=0.7, noise=NoiseLevel(read=0.02), background=flat_background(260, 200, (0.2, 0.3, 0.4))
    )
    shot, sharp = render_shot(scene, seed=3), render_sharp(scene, seed=3)
    clear = (shot.alpha == 0) & (sharp.alpha == 0)
    clear = torch.nn.functional.max_pool2d((~clear).float()[None], 13, 1, 6)[0] == 0
    assert torch.allclose(
        sharp.clean_image[:, clear], shot.clean_background[:, clear], rtol=0, atol=1e-6
    )
    noises = [
        (picture.rgb[0] - clean)[:, clear].flatten().numpy()
        for picture, clean in (
            (shot.image, shot.clean_image),
            (shot.background, shot.clean_background),
            (sharp.image, sharp.clean_image),
        )
    ]
    correlation = np.corrcoef(noises)
    assert abs(correlation - np.eye(3)).max() < 0.02  # 60 000 samples: 0.004 expected
    assert np.std(noises[2]) == pytest.approx(0.02, rel=0.02)
    again = render_sharp(scene, seed=3)
    assert torch.equal(again.image.rgb, sharp.image.rgb)
    assert again.image.exposure.tolist() == [scene.exposure]
