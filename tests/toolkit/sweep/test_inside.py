from dataclasses import replace

import numpy as np
import pytest
import torch

from toolkit.sweep.fit import fit_sweep, outline
from toolkit.sweep.inside import far_from_rims
from toolkit.sweep.paths import PARABOLA, STRAIGHT, BouncePath
from toolkit.sweep.squares import Squares
from toolkit.synthetic import BouncingPath, ParabolicPath

SIDE = 3
STREAK = {"width_px": 60, "length_widths": 3.0}


def bounced(scene):
    """Aside and down, and from the middle of the exposure on up again."""
    unit = scene.ball_radius / scene.exposure
    x, y, z = scene.path.position(torch.tensor([scene.exposure / 2]))[0].tolist()
    fall = 3 * scene.ball_radius
    path = BouncingPath(
        start=(x - fall, y - fall, z),
        start_velocity=(6 * unit, 6 * unit, 0.0),
        contact_height=y,
        acceleration=(0.0, 0.0, 0.0),
        restitution=1.0,
    )
    return replace(scene, path=path)


def thrown(scene):
    """Up and down again, a little aside: the ball comes back over its own way."""
    unit = scene.ball_radius / scene.exposure
    x, y, z = scene.path.position(torch.tensor([scene.exposure / 2]))[0].tolist()
    path = ParabolicPath(
        start=(x - 3 * scene.ball_radius, y + 3 * scene.ball_radius, z),
        start_velocity=(6 * unit, -24 * unit, 0.0),
        acceleration=(0.0, 48 * unit / scene.exposure, 0.0),
    )
    return replace(scene, path=path)


FLIGHTS = {
    "straight": (None, STRAIGHT),
    "bounced": (bounced, BouncePath((0.0,))),
    "thrown": (thrown, PARABOLA),
}


@pytest.fixture(scope="module", params=FLIGHTS)
def flight(request, streak):
    change, path = FLIGHTS[request.param]
    return streak(change=change, **STREAK), path


def squares_of(seen):
    height, width = seen.shot.alpha.shape
    mask = np.ones((height // SIDE, width // SIDE), np.uint8)
    return Squares.of(mask, SIDE, (height, width))


def far(seen, path, squares, margin=SIDE / 2**0.5 + 1):
    rays = seen.frame().rays(squares)
    return far_from_rims(seen.model(path), seen.truth(path), rays, margin)


def unevenness(seen, squares):
    """By how much the opacity that was rendered leaves its plane within each square, at most."""
    (alpha,) = squares.pick(seen.shot.alpha[None].double())
    steps = torch.arange(SIDE, dtype=torch.float64)
    design = torch.cartesian_prod(steps, steps, torch.ones(1).double())
    plane = design @ torch.linalg.lstsq(design, alpha[0]).solution
    return (alpha[0] - plane).abs().amax(0), alpha[0].amax(0)


def test_the_opacity_is_even_where_no_rim_is_near(flight):
    seen, path = flight
    squares = squares_of(seen)
    is_far = far(seen, path, squares)
    uneven, most = unevenness(seen, squares)
    assert uneven[is_far].max() < 0.15 * uneven.max()
    assert most[is_far].min() > 0
    assert is_far.sum() > 0.1 * (most > 0).sum()


def test_a_ball_far_away_before_a_long_lens_is_told_as_well(streak):
    """A thousand times as far before a lens a thousand times as long: the same picture."""
    seen = streak(**STREAK)
    time, points = torch.linspace(-0.5, 0.5, 65, dtype=torch.float64), seen.points()
    away = points * torch.tensor([1.0, 1.0, 1000.0], dtype=torch.float64)
    camera = seen.scene.camera
    camera = replace(camera, fx=1000 * camera.fx, fy=1000 * camera.fy)
    squares, model = squares_of(seen), replace(seen.model(), camera=camera)
    x = torch.cat([STRAIGHT.through(time, away), seen.truth()[STRAIGHT.size :]])
    rays = replace(seen.frame(), camera=camera).rays(squares)
    is_far = far_from_rims(model, x, rays, 3.0)
    assert (is_far == far(seen, STRAIGHT, squares, 3.0)).double().mean() > 0.99
    assert is_far.sum() > 100


def test_squares_there_tell_as_much_as_their_pixels(flight):
    """On the picture without noise: the same motion, and hardly less known of it."""
    seen, path = flight
    clean, model, start = seen.clean(), seen.model(path), seen.truth(path)
    by_pixels = fit_sweep(model, start, clean.frame())
    by_squares = fit_sweep(model, start, clean.frame(), contrast=1.0)
    assert len(by_squares.pixels) < 0.95 * len(by_pixels.pixels)
    assert {each.side for each in by_squares.pixels.squares} == {1, SIDE}
    std = by_pixels.path_covariance.diagonal().sqrt()
    step, _ = by_squares.seen.step()
    k = path.size
    # from where single pixels end, squares ask for next to no step
    apart = by_squares.parameters + step - by_pixels.parameters - by_pixels.seen.step()[0]
    assert (apart[:k].abs() < 0.03 * std).all()
    assert (by_squares.path_covariance.diagonal().sqrt() < 1.01 * std).all()


def test_a_ground_as_uneven_as_the_ball_differs_from_it_keeps_its_pixels(streak):
    seen = streak(**STREAK)
    whole = seen.frame()
    few = fit_sweep(seen.model(), seen.truth(), whole, contrast=1.0).pixels
    checks = torch.arange(whole.ground.shape[-1]) % 2
    rough = replace(whole, ground=whole.ground + 0.6 * checks)
    path_px, half_width = outline(seen.model(), seen.truth())
    assert len(few.squares[1]) > 100
    assert len(rough.even_squares(path_px, half_width, SIDE, 1.0)) == 0
    hidden = replace(whole, usable=torch.zeros_like(whole.usable))
    assert len(hidden.even_squares(path_px, half_width, SIDE, 1.0)) == 0
