import math

import numpy as np
import pytest
import torch

from toolkit import CalibrationError
from toolkit.ball_colours import fit_plane, learn_colours
from toolkit.disc import view_ball
from toolkit.synthetic import LambertBall, LitBall, PanelledBall, StripedBall

RED, BLUE = (0.7, 0.2, 0.1), (0.1, 0.25, 0.6)
NOISE = 0.01


def pixels(*parts: tuple[tuple[float, float, float], int], noise: float = NOISE, seed: int = 0):
    """Shades of colours, with noise and its variance."""
    generator = np.random.default_rng(seed)
    light = np.concatenate(
        [generator.uniform(0.3, 1, (count, 1)) * np.array(colour) for colour, count in parts]
    )
    light = light + noise * generator.standard_normal(light.shape)
    return torch.from_numpy(light), torch.full(light.shape, noise**2, dtype=torch.float64)


def true_normal(first, second) -> np.ndarray:
    across = np.cross(first, second)
    return across / np.linalg.norm(across)


def angle(first, second) -> float:
    """Between two lines, radian."""
    cosine = abs(np.dot(first, second)) / np.linalg.norm(first) / np.linalg.norm(second)
    return math.acos(min(1.0, cosine))


def test_two_pigments_span_a_plane():
    colours = fit_plane(*pixels((RED, 600), (BLUE, 400)))
    assert colours.kind == "plane"
    assert angle(colours.normal, true_normal(RED, BLUE)) < 0.003
    assert math.hypot(*colours.normal) == pytest.approx(1)
    found = sorted(colours.pigments)
    assert angle(found[0], BLUE) < math.radians(2)
    assert angle(found[1], RED) < math.radians(2)
    assert colours.off < 0.01


def test_mean_is_that_of_the_pixels():
    light, variance = pixels((RED, 100), (BLUE, 300))
    assert fit_plane(light, variance).mean == pytest.approx(light.mean(0).tolist())


def test_uncertainty_is_honest():
    true = true_normal(RED, BLUE)
    found = [fit_plane(*pixels((RED, 300), (BLUE, 300), seed=seed)) for seed in range(40)]
    seen = math.sqrt(np.mean([angle(one.normal, true) ** 2 for one in found]))
    said = math.sqrt(np.mean([one.normal_std**2 for one in found]))
    assert 0.7 < seen / said < 1.4


def test_third_colour_in_a_minority_is_left_out():
    colours = fit_plane(*pixels((RED, 600), (BLUE, 500), ((0.1, 0.7, 0.1), 120)))
    assert colours.kind == "plane"
    assert angle(colours.normal, true_normal(RED, BLUE)) < 0.01
    assert colours.off == pytest.approx(120 / 1220, abs=0.02)


def test_three_colours_lie_in_no_plane():
    colours = fit_plane(*pixels((RED, 400), (BLUE, 400), ((0.1, 0.7, 0.1), 400)))
    assert (colours.kind, colours.pigments, colours.normal) == ("solid", (), None)
    assert colours.off > 0.25


@pytest.mark.parametrize(
    "parts",
    [
        ((RED, 500),),
        (((0.8, 0.8, 0.8), 300), ((0.02, 0.02, 0.02), 300)),
        ((RED, 300), (tuple(1.02 * c for c in RED), 300)),
    ],
    ids=["one colour", "black and white", "nearly parallel"],
)
def test_one_hue_is_a_line(parts):
    colours = fit_plane(*pixels(*parts))
    assert colours.kind == "line"
    assert colours.pigments == (colours.mean,)
    assert colours.normal is None


def test_highlights_are_told_apart_from_pigments():
    light, variance = pixels((RED, 950))
    generator = np.random.default_rng(1)
    shine = torch.from_numpy(generator.uniform(0.1, 0.5, (50, 1)))
    shiny = fit_plane(torch.cat([light, light[:50] + shine]), torch.cat([variance, variance[:50]]))
    assert shiny.kind == "line"
    assert shiny.off == pytest.approx(0.05, abs=0.02)


def test_too_few_or_black_pixels_are_refused():
    light, variance = pixels((RED, 20))
    with pytest.raises(CalibrationError, match="20 of its pixels are well exposed"):
        fit_plane(light, variance)
    with pytest.raises(CalibrationError, match="so that the ball is bright"):
        fit_plane(*pixels(((0.001, 0.001, 0.001), 500)))
    with pytest.raises(CalibrationError, match="0 of its pixels"):
        fit_plane(torch.zeros(0, 3).double(), torch.zeros(0, 3).double())


def striped(colour):
    return LitBall(pattern=StripedBall(colours=(colour, BLUE), pole=(0.5, 0.8, 0.3)))


def football(colour):
    return LitBall(pattern=PanelledBall(colours=((0.8, 0.8, 0.8), (0.03, 0.03, 0.03))))


def matt(colour):
    return LambertBall(colour=colour)


def test_striped_ball_in_a_picture(sharp_ball):
    sharp, empty = sharp_ball(striped, radius_px=40)
    colours = learn_colours([view_ball(sharp.image, empty)])
    assert colours.kind == "plane"
    rows, columns = torch.meshgrid(*(torch.arange(n) for n in sharp.alpha.shape), indexing="ij")
    place = sharp.disc.to_unit(torch.stack([columns, rows], dim=-1).double())
    clean = sharp.clean_image[:, place.norm(dim=-1) < 0.9].mT.double()
    # all true colours lie in the plane found
    share = (clean @ torch.tensor(colours.normal).double()).abs() / clean.norm(dim=-1)
    assert float(share.max()) < 0.01
    assert min(angle(pigment, BLUE) for pigment in colours.pigments) < math.radians(2)


@pytest.mark.parametrize("look", [matt, football])
def test_ball_of_one_hue_in_a_picture(sharp_ball, look):
    sharp, empty = sharp_ball(look, radius_px=40)
    assert learn_colours([view_ball(sharp.image, empty)]).kind == "line"


def blue(colour):
    return LambertBall(colour=BLUE)


def test_several_pictures_are_learnt_together(sharp_ball):
    """Each shows one pigment; only both together span the plane."""
    balls = [sharp_ball(look, radius_px=40) for look in (matt, blue)]
    views = [view_ball(sharp.image, empty) for sharp, empty in balls]
    assert [learn_colours([view]).kind for view in views] == ["line", "line"]
    assert learn_colours(views).kind == "plane"
