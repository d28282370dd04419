from dataclasses import replace

import pytest

from toolkit import ConfigError
from toolkit.ball_file import BallFile, write_ball
from toolkit.candidates import AUTO, make_candidates
from toolkit.imaging import write_png16
from toolkit.known_ball import know_ball
from toolkit.rig import Rig
from toolkit.synthetic import StripedBall

RED, NEARLY_RED, GREY = (0.7, 0.2, 0.1), (0.69, 0.2, 0.1), (0.5, 0.5, 0.5)


@pytest.fixture
def ball_of(tmp_path):
    """Write a ball.toml of a kind, and give what is known by it."""

    def make(kind, colours):
        write_ball(tmp_path / "ball.toml", BallFile(kind=kind, colours=colours))
        return Rig(ball=tmp_path / "ball.toml")

    return make


@pytest.mark.parametrize(
    ("kind", "colours", "reason"),
    [
        ("line", (GREY,), r"ball\.toml shows one colour and its shades, or black and white; use"),
        ("solid", (), r"ball\.toml shows more than two colours, or gloss; use known-shading"),
    ],
)
def test_a_ball_file_without_a_plane_says_why(ball_of, kind, colours, reason):
    ball = know_ball(ball_of(kind, colours))
    with pytest.raises(ConfigError, match=rf"two-colour cannot be used: .*{reason}"):
        make_candidates("two-colour", ball, {})
    unsuited = {one.estimator: one.reason for one in make_candidates(AUTO, ball, {}).unsuited}
    assert "ball.toml shows" in unsuited["two-colour"]


def test_a_black_and_white_ball_is_recognised_in_its_picture(sharp_ball, tmp_path):
    sharp, empty = sharp_ball(lambda _: StripedBall(colours=((0.05,) * 3, (0.8,) * 3)))
    for name, picture in (("sharp", sharp.image), ("bg", empty)):
        write_png16(tmp_path / f"{name}.png", picture.rgb[0].double().numpy().clip(0))
    ball = know_ball(Rig(ball_image=tmp_path / "sharp.png", background=(tmp_path / "bg.png",)))
    with pytest.raises(ConfigError, match=r"sharp\.png shows .* black and white"):
        make_candidates("two-colour", ball, {})


def test_what_else_is_wrong_is_said_as_it_is(ball_of):
    said = ball_of("line", (GREY,))
    with pytest.raises(ConfigError, match="nearly the same hue"):
        make_candidates("two-colour", know_ball(replace(said, ball_colours=(RED, NEARLY_RED))), {})
    with pytest.raises(ConfigError, match="needs the ball's two pigments"):
        make_candidates("two-colour", know_ball(Rig()), {})
    with pytest.raises(ConfigError, match="is not three finite numbers"):
        make_candidates("two-colour", know_ball(said), {"plane_normal": "0,0,0"})
