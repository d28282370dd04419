import math
from dataclasses import replace

import pytest
import torch

from toolkit.ball_agreement import learn_colours_together, same_light
from toolkit.ball_colours import fit_plane, learn_colours, share_off
from toolkit.disc import view_ball
from toolkit.synthetic import LambertBall, LitBall, StripedBall
from toolkit.synthetic.render import record

ORANGE, BLUE, GREEN = (0.67, 0.49, 0.11), (0.1, 0.2, 0.6), (0.1, 0.7, 0.1)


def matt(colour):
    return LambertBall(colour=ORANGE)


def blue(colour):
    return LambertBall(colour=BLUE)


def green(colour):
    return LambertBall(colour=GREEN)


def other_lamp(colour):
    return LambertBall(colour=ORANGE, light=(0.6, 0.5, -0.6))


def striped(colour):
    return LitBall(pattern=StripedBall(colours=(ORANGE, BLUE), pole=(0.5, 0.8, 0.3)))


def turned(colour):
    return LitBall(pattern=StripedBall(colours=(ORANGE, BLUE), pole=(0.9, -0.3, 0.3)))


@pytest.fixture(scope="module")
def look_at(sharp_ball):
    """Give a ball's view; each seed has a background and a noise of its own."""
    made = {}

    def view(look, seed=0, brightness=1.0):
        key = (look, seed, brightness)
        if key not in made:
            sharp, empty = sharp_ball(look, radius_px=25, seed=seed)
            image = sharp.image
            if brightness != 1:
                light = torch.where(sharp.alpha > 0.01, brightness * image.rgb[0], image.rgb[0])
                image = record(light, 0.02)
            made[key] = view_ball(image, empty)
        return made[key]

    return view


def test_one_picture_is_what_it_was(look_at):
    together = learn_colours_together([look_at(striped)])
    assert together.colours == learn_colours([look_at(striped)])
    assert together.contradicting == {}
    assert len(together.std) == 2


def test_more_pictures_tell_the_plane_better(look_at):
    one = learn_colours_together([look_at(striped)])
    four = learn_colours_together([look_at(striped, 0), look_at(turned, 0)] * 2)
    assert four.colours.kind == "plane"
    assert four.colours.normal_std < one.colours.normal_std
    assert four.contradicting == {}


def test_colour_std_is_the_spread_where_that_is_larger(look_at):
    views = [look_at(matt, 0, b) for b in (0.98, 1.0, 1.02)]
    together = learn_colours_together(views)
    assert together.colours.kind == "line"
    assert together.contradicting == {}
    (std,) = together.std
    mean = together.colours.mean
    assert std[0] / mean[0] == pytest.approx(0.02 / math.sqrt(3), rel=0.15)
    alone = learn_colours_together(views[:1])
    assert alone.std[0][0] < 0.2 * std[0]


@pytest.mark.parametrize("place", [0, 2, 3])
def test_a_picture_in_other_light_is_named_and_left_out(look_at, place):
    views = [look_at(matt, 0, b) for b in (0.99, 1.0, 1.01)]
    views.insert(place, look_at(matt, 0, 0.8))
    together = learn_colours_together(views)
    assert list(together.contradicting) == [place]
    assert "0.80 times as bright" in together.contradicting[place]
    good = learn_colours(views[:place] + views[place + 1 :])
    assert together.colours.mean == pytest.approx(good.mean)


def test_another_ball_is_named_and_left_out(look_at):
    views = [look_at(matt), look_at(matt), look_at(blue), look_at(matt)]
    together = learn_colours_together(views)
    assert list(together.contradicting) == [2]
    assert "another colour" in together.contradicting[2]
    assert together.colours.kind == "line"


def test_a_third_colour_among_striped_ones_is_named(look_at):
    views = [look_at(striped), look_at(green), look_at(turned)]
    together = learn_colours_together(views)
    assert list(together.contradicting) == [1]
    assert "beside the plane" in together.contradicting[1]
    assert together.colours.kind == "plane"


def test_a_turned_ball_is_no_contradiction(look_at):
    together = learn_colours_together([look_at(matt), look_at(matt), look_at(striped)])
    assert together.contradicting == {}
    assert together.colours.kind == "plane"


def test_of_two_none_is_left_out(look_at):
    together = learn_colours_together([look_at(matt), look_at(matt, 0, 0.8)])
    assert together.contradicting == {}
    (std,) = together.std
    assert std[0] / together.colours.mean[0] == pytest.approx(0.2 / 0.9 / 2, rel=0.1)


def test_pixels_off_what_is_spanned_are_counted():
    shade = torch.linspace(0.3, 1, 100).double()[:, None]
    red, blue_, green_ = (shade * torch.tensor(c).double() for c in ((0.7, 0.2, 0.1), BLUE, GREEN))
    variance = torch.full((100, 3), 1e-4).double()
    line = fit_plane(red, variance)
    assert share_off(line, red, variance) == 0
    assert share_off(line, torch.cat([red, blue_]), variance.repeat(2, 1)) == pytest.approx(0.5)
    plane = fit_plane(torch.cat([red, blue_]), variance.repeat(2, 1))
    assert share_off(plane, torch.cat([red, blue_]), variance.repeat(2, 1)) == 0
    assert share_off(plane, green_, variance) == 1
    assert share_off(replace(plane, kind="solid", normal=None), green_, variance) == 0


def test_pictures_in_the_same_light_are_found(look_at):
    views = [look_at(other_lamp), look_at(matt), look_at(matt, 1), look_at(matt, 0, 0.9)]
    light = same_light(views)
    assert sorted(light.alike) == [1, 2]
    assert set(light.others) == {0, 3}
    assert light.others[3] == pytest.approx(0.1, abs=0.02)
    assert light.others[0] > 0.1


def test_a_turned_pattern_is_another_shade(look_at):
    light = same_light([look_at(striped), look_at(turned), look_at(striped)])
    assert sorted(light.alike) == [0, 2]
    assert list(light.others) == [1]


def test_noise_alone_makes_no_difference(look_at):
    light = same_light([look_at(matt, seed) for seed in range(3)])
    assert (sorted(light.alike), light.others) == ([0, 1, 2], {})
    assert light.std < 0.003


def test_the_doubt_of_a_mean_shade_is_that_of_its_spread(look_at):
    light = same_light([look_at(matt, seed, 0.99 + 0.01 * seed) for seed in range(3)])
    assert len(light.alike) == 3
    assert light.std == pytest.approx(0.01 / math.sqrt(3), rel=0.15)
    assert same_light([look_at(matt)]).std == 0
