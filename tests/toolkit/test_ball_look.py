import pytest
import torch

from toolkit.ball_look import look_at_ball, look_at_disc
from toolkit.synthetic import LambertBall
from toolkit.synthetic.render import record


def matt(colour):
    return LambertBall(colour=colour)


def grid(size: int) -> torch.Tensor:
    line = torch.linspace(-1, 1, size, dtype=torch.float64)
    y, x = torch.meshgrid(line, line, indexing="ij")
    return torch.stack([x, y], dim=-1)


@pytest.mark.parametrize(("radius_px", "size"), [(25, 65), (40, 81), (90, 129)])
def test_grid_follows_the_disc(sharp_ball, radius_px, size):
    sharp, empty = sharp_ball(None, radius_px=radius_px)
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


def test_light_is_that_of_the_ball(sharp_ball):
    """Compare with Lambert's law at the normals of a distant ball, through the true disc."""
    sharp, empty = sharp_ball(matt, radius_px=40, distance_R=200)
    ball = look_at_ball(sharp.image, empty)
    place = grid(ball.rgb.shape[-1])
    rho = torch.linalg.vector_norm(place, dim=-1)
    facing = (1 - rho**2).clamp_min(0).sqrt()
    normal = torch.cat([place, -facing[..., None]], dim=-1)
    true = matt((1.0, 1.0, 1.0))(normal.reshape(-1, 3), 0.0).reshape(*place.shape[:-1], 3)
    x, y = (round(c) for c in sharp.disc.centre)
    at_centre = sharp.clean_image[:, y, x].double()
    middle = true[len(true) // 2, len(true) // 2]
    expected = (true / middle * at_centre).movedim(-1, 0)
    inner, rim = rho < 0.9, (rho >= 0.9) & (rho < 0.995)
    difference = ball.rgb.double() - expected
    assert float(difference[:, inner].pow(2).mean().sqrt()) < 0.015
    # where pixels are mixed with the background the light is extended from inside
    assert float(difference[:, rim].pow(2).mean().sqrt()) < 0.04
    assert abs(float(difference[:, rim].mean())) < 0.012


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
