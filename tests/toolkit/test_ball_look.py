import math

import pytest
import torch

from toolkit.ball_look import look_at_ball, look_at_disc
from toolkit.synthetic import LambertBall, StripedBall
from toolkit.synthetic.render import record

LAMP = (0.5, 0.2, -0.8)
LEMON, RED = (0.9, 0.8, 0.03), (0.95, 0.04, 0.03)


def matt(colour):
    return LambertBall(colour=colour)


def frontal(colour):
    return LambertBall(colour=colour, light=LAMP, ambient=0.4)


def shiny(colour):
    return LambertBall(colour=colour, light=LAMP, ambient=0.4, highlight=0.06)


def striped(colour):
    return StripedBall(colours=(LEMON, RED), stripes=3, pole=(0.9, 0.4, -0.2))


def grid(size: int) -> torch.Tensor:
    line = torch.linspace(-1, 1, size, dtype=torch.float64)
    y, x = torch.meshgrid(line, line, indexing="ij")
    return torch.stack([x, y], dim=-1)


@pytest.mark.parametrize(("radius_px", "size"), [(25, 65), (40, 81), (90, 129)])
def test_grid_of_a_patterned_ball_follows_the_disc(sharp_ball, radius_px, size):
    sharp, empty = sharp_ball(striped, radius_px=radius_px)
    ball = look_at_ball(sharp.image, empty)
    assert ball.rgb.shape == (3, size, size)
    assert ball.rgb.dtype == torch.float32
    assert ball.clipped == 0


def test_plain_ball_is_plain_up_to_and_beyond_the_rim(sharp_ball):
    sharp, empty = sharp_ball(None, radius_px=40)
    ball = look_at_ball(sharp.image, empty)
    x, y = (round(c) for c in sharp.disc.centre)
    colour = sharp.clean_image[:, y, x].reshape(3, 1, 1)
    assert float((ball.rgb - colour).abs().max()) < 0.12  # noise of 1 %, extended
    assert float((ball.rgb - colour).mean().abs()) < 0.002


def error_of(ball, sharp, look) -> tuple[torch.Tensor, torch.Tensor]:
    """Give rho [N, N] and the error of a distant ball's light [N, N, 3], by its true normals."""
    place = grid(ball.rgb.shape[-1])
    rho = torch.linalg.vector_norm(place, dim=-1)
    facing = (1 - rho**2).clamp_min(0).sqrt()
    normal = torch.cat([place, -facing[..., None]], dim=-1)
    true = look((1.0, 1.0, 1.0))(normal.reshape(-1, 3), 0.0).reshape(*place.shape[:-1], 3)
    x, y = (round(c) for c in sharp.disc.centre)
    at_centre = sharp.clean_image[:, y, x].double()
    middle = true[len(true) // 2, len(true) // 2]
    return rho, ball.rgb.double().movedim(0, -1) - true / middle * at_centre


def rms(error: torch.Tensor) -> float:
    return float(error.pow(2).mean().sqrt())


@pytest.mark.parametrize("look", [matt, frontal, shiny])
@pytest.mark.parametrize(("radius_px", "worst"), [(20, 0.025), (25, 0.02), (40, 0.015), (50, 0.01)])
def test_light_is_that_of_the_ball_up_to_its_rim(sharp_ball, look, radius_px, worst):
    sharp, empty = sharp_ball(look, radius_px=radius_px, distance_R=200)
    rho, error = error_of(look_at_ball(sharp.image, empty), sharp, look)
    assert rms(error[rho < 0.9]) < 0.015
    rim = (rho >= 0.9) & (rho < 0.995)
    assert rms(error[rim]) < worst
    assert abs(float(error[rim].mean())) < 0.6 * worst


@pytest.mark.parametrize("side", [1, -1])
def test_neither_the_lit_rim_nor_the_dark_one_is_biased(sharp_ball, side):
    mean = []
    for seed in range(3):
        sharp, empty = sharp_ball(frontal, radius_px=35, distance_R=200, seed=seed)
        rho, error = error_of(look_at_ball(sharp.image, empty), sharp, frontal)
        towards = grid(len(rho)) @ torch.tensor(LAMP[:2]).double() / math.hypot(*LAMP[:2])
        here = (rho >= 0.96) & (rho < 0.995) & (side * towards > 0.5)
        mean.append(float(error[here].mean()))
    assert abs(sum(mean) / 3) < 0.008


def test_stripes_stay_apart_at_the_rim(sharp_ball):
    sharp, empty = sharp_ball(striped, radius_px=45, distance_R=200)
    ball = look_at_ball(sharp.image, empty)
    rim = torch.linalg.vector_norm(grid(ball.rgb.shape[-1]), dim=-1).sub(0.97).abs() < 0.02
    light = ball.rgb[:, rim].mT.double()
    colours = torch.tensor([LEMON, RED], dtype=torch.float64)
    off = torch.linalg.vector_norm(light[:, None] - colours, dim=-1).amin(1)
    assert float((off < 0.1).double().mean()) > 0.8


@pytest.mark.parametrize("left", [0.1, 0.5, 0.8])
def test_shadow_beside_the_ball_leaves_its_rim_alone(sharp_ball, left):
    """Darken the background below the ball, which the picture without it does not show."""
    sharp, empty = sharp_ball(frontal, radius_px=40, distance_R=200)
    found = look_at_ball(sharp.image, empty)
    rows, columns = torch.meshgrid(*map(torch.arange, sharp.alpha.shape), indexing="ij")
    is_below = found.disc.to_unit(torch.stack([columns, rows], dim=-1).double())[..., 1] > 0.5
    lost = is_below * (1 - sharp.alpha) * (1 - left) * empty.rgb[0]
    ball = look_at_disc(record(sharp.image.rgb[0] - lost, 0.02), empty, found.disc)
    rho, error = error_of(ball, sharp, frontal)
    rim = (rho >= 0.96) & (rho < 0.995) & (grid(len(rho))[..., 1] > 0.6)
    assert abs(float(error[rim].mean())) < 0.015
    assert rms(error[rim]) < 0.025


def test_averaging_in_large_pictures_takes_noise_away(sharp_ball):
    spread = []
    for radius_px in (30, 90):
        sharp, empty = sharp_ball(None, radius_px=radius_px)
        ball = look_at_ball(sharp.image, empty)
        inside = torch.linalg.vector_norm(grid(ball.rgb.shape[-1]), dim=-1) < 0.8
        spread.append(float(ball.rgb[:, inside].std(dim=1).mean()))
    assert spread[0] < 0.01
    assert spread[1] < 0.8 * 0.01


def test_stored_disc_gives_the_same_ball(sharp_ball):
    sharp, empty = sharp_ball(matt)
    found = look_at_ball(sharp.image, empty)
    again = look_at_disc(sharp.image, empty, found.disc)
    assert torch.allclose(found.rgb, again.rgb, atol=2e-3)


def test_highlight_of_a_few_pixels_is_marked(sharp_ball):
    sharp, empty = sharp_ball(matt, radius_px=40)
    light = sharp.image.rgb[0].clone()
    x, y = (round(c) for c in sharp.disc.centre)
    light[:, y - 5 : y, x - 12 : x - 7] = 1.0
    ball = look_at_ball(record(light, 0.02), empty)
    assert ball.clipped == pytest.approx(25 / (3.1416 * 40**2), rel=0.05)
