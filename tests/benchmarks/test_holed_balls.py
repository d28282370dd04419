import math

import numpy as np
import pytest
import torch
from holed_balls import DARKER, SHARE, HoledBall, holed, without_holes
from sweep_scenes import draw_scene


def directions(count=200_000):
    return torch.nn.functional.normalize(
        torch.randn(count, 3, generator=torch.Generator().manual_seed(1)), dim=-1
    )


def ball(**changes):
    options = {"colour": (0.8, 0.6, 0.4), "share": 0.2, "hole_light": 0.1, "pole": (0.0, 0.0, 1.0)}
    return HoledBall(**(options | changes))


@pytest.mark.parametrize("share", SHARE)
def test_holes_cover_their_share_and_do_not_overlap(share):
    light = ball(share=share)(directions(), 0.0)[:, 0]
    assert float((light < 0.5).float().mean()) == pytest.approx(share, abs=0.004)
    assert sorted({round(float(value), 4) for value in light}) == [0.08, 0.8]


def test_holes_turn_with_the_ball():
    one = ball(spin=(0.0, 0.0, math.tau / 0.02))
    normal = directions(2000)
    assert torch.equal(one(normal, 0.02), one(normal, 0.0))
    # a sixth of a turn later what was at the sixth is here
    back = torch.tensor([[0.5, math.sqrt(0.75), 0], [-math.sqrt(0.75), 0.5, 0], [0, 0, 1]])
    later = one(normal, 0.02 / 6)
    assert float((later != one(normal @ back.mT, 0.0)).float().mean()) < 0.01
    assert float((later != one(normal, 0.0)).float().mean()) > 0.05


def test_a_scene_s_ball_is_lit_from_one_side_and_told_from_its_material():
    scene = draw_scene(5)
    made = holed(scene, np.random.default_rng(2))
    assert DARKER[0] <= 1 - made.ambient <= DARKER[1]
    plain = without_holes(made)
    normal = directions(5000)
    seen, material = made(normal, 0.0), plain(normal, 0.0)
    same = (seen == material).all(-1)
    assert 1 - SHARE[1] - 0.03 < float(same.float().mean()) < 1 - SHARE[0] + 0.03
    assert float(material.amin() / material.amax()) < 1
    assert (seen <= material).all()
