import math

import pytest
import torch

from toolkit.errors import ConfigError
from toolkit.synthetic import BouncingPath, CircularPath, ParabolicPath, StraightPath

STRAIGHT = StraightPath(start=(0.1, -0.2, 2.0), start_velocity=(3.0, 1.0, -0.5))
PARABOLA = ParabolicPath(start=(0.1, -0.2, 2.0), start_velocity=(3.0, -1.0, -0.5))
BOUNCE = BouncingPath(
    start=(0.0, -1.0, 3.0),
    start_velocity=(2.0, 0.5, 0.3),
    contact_height=0.2,
    restitution=0.7,
    tangential_loss=0.2,
)
CIRCLE = CircularPath(centre=(0.0, 0.1, 3.0), arm=(0.4, 0.1, 0.2), axis=(0.2, 0.3, 2.0), rate=7.0)


@pytest.mark.parametrize(
    "path", [STRAIGHT, PARABOLA, BOUNCE, CIRCLE], ids=lambda p: type(p).__name__
)
def test_velocity_is_the_derivative_of_position(path):
    time = torch.linspace(0.01, 0.9, 40, dtype=torch.float64)
    step = 1e-6
    slope = (path.position(time + step) - path.position(time - step)) / (2 * step)
    assert path.velocity(time).shape == (40, 3)
    assert torch.allclose(path.velocity(time), slope, atol=1e-8)


def test_a_straight_path_starts_where_it_says():
    assert STRAIGHT.position(torch.zeros(1))[0].tolist() == [0.1, -0.2, 2.0]


def test_gravity_pulls_down_which_is_positive_y():
    time = torch.tensor([0.0, 2.0])
    fall = ParabolicPath(start=(0.0, 0.0, 5.0), start_velocity=(0.0, 0.0, 0.0)).position(time)
    assert fall[1].tolist() == pytest.approx([0.0, 19.62, 5.0])


def test_the_bounce_happens_at_contact_height_and_takes_speed_away():
    instant = BOUNCE.bounce_time
    at_contact = BOUNCE.position(torch.tensor([instant], dtype=torch.float64))[0]
    assert at_contact[1] == pytest.approx(0.2, abs=1e-12)
    around = torch.tensor([instant - 1e-9, instant + 1e-9], dtype=torch.float64)
    before, after = BOUNCE.velocity(around).tolist()
    assert after == pytest.approx([0.8 * before[0], -0.7 * before[1], 0.8 * before[2]], abs=1e-6)
    jump = BOUNCE.position(around).diff(dim=0).abs().max()
    assert jump < 1e-7


def test_the_ball_never_sinks_below_contact_height_within_one_bounce():
    time = torch.linspace(0, BOUNCE.bounce_time + 0.3, 500, dtype=torch.float64)
    assert BOUNCE.position(time)[:, 1].max() <= 0.2 + 1e-9


def test_a_ball_without_gravity_that_rises_never_bounces():
    path = BouncingPath(
        start=(0.0, 0.0, 3.0),
        start_velocity=(1.0, -1.0, 0.0),
        acceleration=(0.0, 0.0, 0.0),
        contact_height=0.5,
    )
    assert math.isinf(path.bounce_time)
    assert path.position(torch.tensor([10.0]))[0].tolist() == [10.0, -10.0, 3.0]


def test_a_bounce_without_gravity_comes_at_constant_speed():
    path = BouncingPath(
        start=(0.0, 0.0, 3.0),
        start_velocity=(0.0, 2.0, 0.0),
        acceleration=(0.0, 0.0, 0.0),
        contact_height=0.5,
    )
    assert path.bounce_time == pytest.approx(0.25)


def test_a_swung_ball_keeps_its_distance_and_returns_after_a_turn():
    time = torch.linspace(0, 2 * math.pi / 7.0, 50, dtype=torch.float64)
    arm = CIRCLE.position(time) - torch.tensor(CIRCLE.centre, dtype=torch.float64)
    assert torch.allclose(arm.norm(dim=-1), arm[0].norm().expand(50))
    assert torch.allclose(arm[0], arm[-1])


def test_impossible_paths_are_refused():
    with pytest.raises(ConfigError, match=r"restitution 1\.2"):
        BouncingPath(start=(0, 0, 1), start_velocity=(0, 0, 0), contact_height=1.0, restitution=1.2)
    with pytest.raises(ConfigError, match="start it above the floor"):
        BouncingPath(start=(0, 2, 1), start_velocity=(0, 0, 0), contact_height=1.0)
    with pytest.raises(ConfigError, match="axis"):
        CircularPath(centre=(0, 0, 1), arm=(1, 0, 0), axis=(0, 0, 0), rate=1.0)
