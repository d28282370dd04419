import math

import numpy as np
import pytest
import torch
from sweep_balls import KINDS, by_turn, know_exactly, paint, see_sharply, turn
from sweep_scenes import draw_scene, render

from toolkit.synthetic import mean_colour, render_sharp

SEED = 5


@pytest.fixture(scope="module")
def shaded():
    return render(paint(KINDS["shaded"], draw_scene(SEED), SEED), SEED)


@pytest.mark.parametrize("name", KINDS)
def test_balls_stand_out_and_a_seed_paints_one_ball(name):
    scene = paint(KINDS[name], draw_scene(SEED), SEED)
    mean = torch.tensor(mean_colour(scene.appearance, scene.exposure, 40))
    assert (scene.background - mean[:, None, None]).norm(dim=0).min() >= 0.4
    assert scene.appearance == paint(KINDS[name], draw_scene(SEED), SEED).appearance


@pytest.mark.parametrize("seed", [0, 1, 5])
def test_the_background_lies_off_the_plane_of_the_pigments(seed):
    scene = paint(KINDS["striped"], draw_scene(seed), seed)
    normal = np.cross(*scene.appearance.colours)
    off = np.einsum("c,chw->hw", normal / np.linalg.norm(normal), scene.background)
    assert np.abs(off).min() > 0.149


def test_the_light_told_is_that_of_the_picture(shaded):
    look = know_exactly(shaded, SEED).ball
    sharp = render_sharp(shaded.scene, seed=SEED)
    node = torch.tensor([[0.0, 0.0], [0.6, 0.2], [-0.5, -0.5], [0.1, 0.7]], dtype=torch.float64)
    column, row = ((node + 1) * 64).round().long().mT
    place = torch.stack([column, row], dim=-1) / 64 - 1.0
    x, y = look.disc.from_unit(place.double()).round().long().mT
    seen = sharp.clean_image[:, y, x]
    assert torch.allclose(look.rgb[:, row, column], seen, atol=0.02)
    assert float(look.rgb.max() - look.rgb.min()) > 0.1


def test_a_sharp_picture_gives_the_same_look(shaded):
    seen, told = see_sharply(shaded, SEED).ball, know_exactly(shaded, SEED).ball
    assert seen.disc.semi_axes == pytest.approx(told.disc.semi_axes, abs=0.3)
    assert float(seen.rgb.mean()) == pytest.approx(float(told.rgb.mean()), abs=0.03)


def test_a_ball_that_crosses_the_view_turns_by_half_of_that(shaded):
    scene = shaded.scene
    start, end = (
        np.array(scene.path.start) + t * np.array(scene.path.start_velocity) for t in (0.0, 0.02)
    )
    angle = math.acos(start @ end / np.linalg.norm(start) / np.linalg.norm(end))
    assert turn(shaded) == pytest.approx(math.degrees(angle) / 2)


def test_errors_are_told_apart_by_the_turn():
    bound = [1.0, 1.0, 1.0, 1.0]
    row = {"refused": None, "turn_deg": 2.0, "error": [2.0, 0, 0, 0], "bound": bound}
    text = by_turn([row, row | {"turn_deg": 12.0}, row | {"refused": "why"}]).splitlines()
    assert [line.split()[0] for line in text[1:]] == ["0", "8"]
    assert text[1].split()[-4:] == ["2.000", "0.000", "0.000", "0.000"]
    assert "1 shots" in text[1]
