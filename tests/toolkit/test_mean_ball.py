import pytest
import torch

from toolkit.ball import Disc, SharpBall
from toolkit.mean_ball import mean_ball

DISC = Disc(centre=(30.0, 28.0), semi_axes=(20.5, 20.25), angle=0.5, std=0.02)
OTHER = Disc(centre=(40.0, 28.0), semi_axes=(30.5, 30.25), angle=0.5, std=0.02)


def ball(rgb, disc=DISC, **more):
    return SharpBall(disc=disc, rgb=rgb, **more)


def plane(size, level=0.5):
    """Light that rises evenly, the same on a grid of any size."""
    line = torch.linspace(-1, 1, size)
    return level + 0.2 * line[None, :, None] + 0.1 * line + torch.zeros(3, size, size)


def test_one_picture_stays_as_it_is():
    one = ball(plane(9))
    assert mean_ball([one]) is one


def test_mean_on_the_finest_grid():
    found = mean_ball([ball(plane(9, 0.4)), ball(plane(17, 0.6), OTHER, clipped=0.01)])
    assert found.rgb.shape == (3, 17, 17)
    assert torch.allclose(found.rgb, plane(17, 0.5))
    assert found.disc == DISC
    assert found.clipped == 0.01


def test_spread_is_that_of_a_mean():
    generator = torch.Generator().manual_seed(0)
    count, noise = 5, 0.03
    balls = [ball(0.5 + noise * torch.randn(3, 65, 65, generator=generator)) for _ in range(count)]
    found = mean_ball(balls)
    assert found.others.shape == (count, 3, 65, 65)
    told = float((found.others - found.rgb).square().mean().sqrt())
    assert told == pytest.approx(noise / count**0.5, rel=0.02)
    assert float((found.rgb - 0.5).square().mean().sqrt()) == pytest.approx(told, rel=0.02)


def test_what_each_picture_tells_of_itself_is_kept():
    generator = torch.Generator().manual_seed(0)
    balls = [
        ball(plane(9), others=plane(9) + 0.03 * torch.randn(8, 3, 9, 9, generator=generator))
        for _ in range(4)
    ]
    found = mean_ball(balls)
    assert found.others.shape == (12, 3, 9, 9)  # four that do not scatter, and eight draws
    drawn = (found.others[4:] - found.rgb).square().mean().sqrt()
    assert float(drawn) == pytest.approx(0.03 / 2, rel=0.1)
    mixed = mean_ball([balls[0], ball(plane(9))])
    assert mixed.others.shape == (2, 3, 9, 9)
