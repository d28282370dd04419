from dataclasses import replace

import pytest
import torch

from plugins.known_shading import KnownShading
from plugins.two_colour import TwoColour
from plugins.uniform import Uniform
from toolkit import LinearImage, StreakError, select_estimator
from toolkit.ball_look import look_at_ball
from toolkit.selection import score_estimator
from toolkit.synthetic import (
    LambertBall,
    StripedBall,
    benchmark_scene,
    render_sharp,
    render_shot,
)

RED, BLUE = (0.8, 0.1, 0.06), (0.06, 0.1, 0.8)
SCENE = benchmark_scene(width_px=60, length_widths=4, seed=1, tilt=0.2)
COLOUR = SCENE.appearance.colour


def shot_of(appearance):
    return render_shot(replace(SCENE, appearance=appearance), seed=1)


@pytest.fixture(scope="module")
def plain():
    return render_shot(SCENE, seed=1)


@pytest.fixture(scope="module")
def shaded():
    return shot_of(LambertBall(colour=COLOUR))


@pytest.fixture(scope="module")
def striped():
    spin = (1900.0, 800.0, 400.0)
    return shot_of(StripedBall(colours=(RED, BLUE), pole=(0.3, 1.0, 0.2), spin=spin))


def candidates(shot):
    ball = look_at_ball(render_sharp(shot.scene, seed=9).image, shot.background)
    mean = ball.rgb.mean((1, 2)).tolist()
    return {
        "uniform": Uniform(colour=tuple(mean)),
        "known-shading": KnownShading(ball=ball),
        "two-colour": TwoColour(colours=(RED, BLUE)),
    }


def test_a_good_prediction_scores_about_one(plain):
    score, edge_std = score_estimator(
        plain.image, plain.background, Uniform(colour=COLOUR), SCENE.camera
    )
    assert score == pytest.approx(0.95, abs=0.2)
    assert 0.1 < edge_std < 1


def test_a_wrong_colour_scores_worse(plain):
    right, _ = score_estimator(plain.image, plain.background, Uniform(colour=COLOUR), SCENE.camera)
    wrong = tuple(0.6 * channel for channel in COLOUR)
    score, _ = score_estimator(plain.image, plain.background, Uniform(colour=wrong), SCENE.camera)
    assert score > 1.1 * right


def test_the_sharp_picture_is_chosen_for_a_shaded_ball(shaded):
    chosen = select_estimator(
        shaded.image, shaded.background, list(candidates(shaded).items()), SCENE.camera
    )
    assert chosen.name == "known-shading"
    assert isinstance(chosen.estimator, KnownShading)
    scores = {c.estimator: c.score for c in chosen.candidates}
    assert scores["uniform"] > 1.3 * scores["known-shading"]


def test_the_plane_is_chosen_for_a_spinning_pattern(striped):
    chosen = select_estimator(
        striped.image, striped.background, list(candidates(striped).items()), SCENE.camera
    )
    assert chosen.name == "two-colour"
    assert {c.estimator for c in chosen.candidates} == {"uniform", "known-shading", "two-colour"}


def test_what_fails_is_listed_last_with_its_reason(plain):
    tried = [("two-colour", TwoColour(colours=(RED, BLUE))), ("uniform", Uniform(colour=COLOUR))]
    in_plane = TwoColour(colours=((0.3, 0.31, 0.32), COLOUR))
    chosen = select_estimator(
        plain.image, plain.background, [("two", in_plane), *tried[1:]], SCENE.camera
    )
    assert chosen.name == "uniform"
    assert chosen.candidates[-1].estimator == "two"
    assert chosen.candidates[-1].score is None
    assert chosen.candidates[-1].reason


def test_nothing_suitable_is_refused_with_every_reason(plain):
    nothing = replace(plain.image, rgb=plain.background.rgb + 0.01 * torch.randn(1, 3, 1, 1))
    with pytest.raises(StreakError, match=r"none of the estimators .* uniform: "):
        select_estimator(
            nothing, plain.background, [("uniform", Uniform(colour=COLOUR))], SCENE.camera
        )


@pytest.mark.parametrize("pattern", [((0, 1), (1, 2)), ((1, 0), (2, 1)), ((1, 2), (0, 1))])
def test_a_mosaic_of_any_layout_is_scored(striped, pattern):
    raw = [
        LinearImage(
            mosaic=mosaicked(picture.rgb, pattern), pattern=pattern, clipped=picture.clipped
        )
        for picture in (striped.image, striped.background)
    ]
    estimator = TwoColour(colours=(RED, BLUE))
    score, _ = score_estimator(*raw, estimator, SCENE.camera)
    assert 0.2 < score < 2


def mosaicked(rgb, pattern):
    """Keep of every pixel the channel that a mosaic measures."""
    height, width = rgb.shape[-2:]
    channel = torch.tensor(pattern)[torch.arange(height)[:, None] % 2, torch.arange(width) % 2]
    return rgb.gather(1, channel[None, None])
