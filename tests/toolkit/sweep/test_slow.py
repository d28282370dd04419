import math

import pytest
import torch

from toolkit import Camera
from toolkit.sweep.rays import RayGrid
from toolkit.sweep.slow import count_instants, slow_opacity
from toolkit.synthetic import PlainBall, Scene, StraightPath, render_shot

RADIUS, BLUR = 0.05, 0.7
SPREAD = BLUR**2 + 1 / 12
CAMERA = Camera.centred(72, 64, 700.0)


def arc_of(velocity, distance_R=50.0, bend=(0.0, 0.0, 0.0)):
    """A path whose middle lies a little off the axis; velocities in ball radii an exposure."""
    middle = torch.tensor([0.7, -0.4, distance_R], dtype=torch.float64)
    rows = [middle, torch.tensor(velocity).double(), torch.tensor(bend).double()]
    return RADIUS * torch.stack(rows)


def rays_of(camera):
    y, x = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    place = torch.stack([x.flatten(), y.flatten()], dim=-1).double()
    return RayGrid.over(camera, place.amin(0), place.amax(0)).rays(place)


RAYS = rays_of(CAMERA)


def slow(arc, spread=SPREAD, instants=24):
    half = torch.full_like(RAYS.unit[0], 0.5)
    return slow_opacity(arc, RAYS, -half, half, spread, RADIUS, instants)


def sharp_mean(arc):
    """The mean of many sharp images [N]: a white ball before black."""
    first, velocity = arc[0] - arc[1] / 2, arc[1]
    scene = Scene(
        camera=CAMERA,
        path=StraightPath(start=tuple(first.tolist()), start_velocity=tuple(velocity.tolist())),
        ball_radius=RADIUS,
        exposure=1.0,
        appearance=PlainBall(colour=(1.0, 1.0, 1.0)),
        background=torch.zeros(3, CAMERA.height, CAMERA.width),
        blur=BLUR,
    )
    return render_shot(scene, step=0.03, supersampling=5).clean_image[0].double().flatten()


@pytest.mark.parametrize(
    "velocity", [(0.0, 0.0, 0.0), (0.1, 0.05, 0.0), (0.0, 0.0, 9.0), (0.2, -0.1, -6.0)], ids=str
)
def test_the_opacity_is_the_mean_of_sharp_images(velocity):
    arc = arc_of(velocity)
    alpha, _, _ = slow(arc)
    error = alpha - sharp_mean(arc)
    # a pixel's own square is taken for a round spot of its variance
    assert error.abs().max() < 4e-3
    assert error.square().mean().sqrt() < 3e-4


def test_it_is_even_in_the_velocity():
    ahead, back = (slow(arc_of(v))[0] for v in ((0.2, -0.1, 3.0), (-0.2, 0.1, -3.0)))
    assert torch.allclose(ahead, back, atol=1e-12)


def test_derivatives_agree_with_differences(differences):
    arc = arc_of((0.15, 0.05, 2.0), bend=(0.05, -0.1, 0.3))
    _, J, J_spread = slow(arc)
    step = torch.full((9,), 1e-3 * RADIUS, dtype=torch.float64)
    expected = differences(lambda x: slow(x.reshape(3, 3))[0], arc.flatten(), step).mT
    for rows in range(0, 9, 3):
        found, wanted = J[rows : rows + 3], expected[rows : rows + 3]
        assert (found - wanted).norm() < 0.03 * wanted.norm()
    wider, narrower = (slow(arc, SPREAD * k)[0] for k in (1.01, 0.99))
    expected = (wider - narrower) / (0.02 * SPREAD)
    assert (J_spread - expected).norm() < 0.03 * expected.norm()


def test_only_a_ball_that_hardly_moves_in_the_picture_is_slow():
    spread = SPREAD**0.5 / CAMERA.fx
    still, little, across = (
        count_instants(arc_of((speed, 0.0, 0.0)), -0.5, 0.5, spread, RADIUS)
        for speed in (0.0, 0.2, 4.0)
    )
    assert 0 < still < little
    assert across == 0
    # in a short part of the exposure it hardly moves either
    assert count_instants(arc_of((4.0, 0.0, 0.0)), 0.0, 0.05, spread, RADIUS) > 0
    ahead = arc_of((0.0, 0.0, 0.0))[0] / RADIUS
    coming = tuple((-20 * ahead / ahead.norm()).tolist())
    assert count_instants(arc_of(coming), -0.5, 0.5, spread, RADIUS) > still


def test_more_instants_change_nothing():
    spread = SPREAD**0.5 / CAMERA.fx
    for velocity in ((0.25, 0.0, 0.0), (0.0, 0.1, 8.0)):
        arc = arc_of(velocity)
        count = count_instants(arc, -0.5, 0.5, spread, RADIUS)
        assert count > 0
        few, many = slow(arc, instants=count)[0], slow(arc, instants=150)[0]
        assert (few - many).abs().max() < 1e-4


def test_a_ball_that_comes_straight_on_shows_its_growth():
    """Its rim is lit by as much as it was there: half way, half of the exposure."""
    arc = torch.tensor([[0.0, 0.0, 50.0], [0.0, 0.0, -10.0], [0.0, 0.0, 0.0]]) * RADIUS
    alpha, _, _ = slow(arc.double(), instants=60)
    picture = alpha.reshape(CAMERA.height, CAMERA.width)
    sizes = [CAMERA.fx / math.sqrt(d * d - 1) for d in (55.0, 50.0, 45.0)]
    total = float(picture.sum())
    # of 1 / (d^2 - 1) the mean over the path
    mean = math.pi * CAMERA.fx**2 / 10 * (math.atanh(1 / 45) - math.atanh(1 / 55))
    assert total == pytest.approx(mean, rel=1e-3)
    assert picture.max() == pytest.approx(1, abs=1e-6)
    row = picture[int(CAMERA.cy)]
    width = float((row > 0.5).sum())
    assert 2 * sizes[0] < width < 2 * sizes[2]
