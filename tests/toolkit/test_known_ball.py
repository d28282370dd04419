from dataclasses import replace
from pathlib import Path

import pytest

from toolkit import CalibrationError, ConfigError, ImageError
from toolkit.ball import Disc
from toolkit.ball_file import BallFile, SharpSource, write_ball
from toolkit.ball_look import look_at_ball
from toolkit.cli.main import main
from toolkit.imaging import write_png16
from toolkit.known_ball import know_ball
from toolkit.rig import Rig
from toolkit.synthetic import PlainBall, StripedBall

RED, BLUE, GREEN = (0.7, 0.2, 0.1), (0.1, 0.2, 0.6), (0.1, 0.7, 0.2)
NORMAL = (0.6, 0.0, 0.8)


def ball_file(folder: Path, **changes: object) -> Path:
    learnt = {"radius": 0.03, "colours": (RED, BLUE), "plane_normal": NORMAL, "kind": "plane"}
    write_ball(folder / "ball.toml", BallFile(**{**learnt, **changes}))
    return folder / "ball.toml"


@pytest.fixture
def pictures(sharp_ball, tmp_path):
    """Write sharp.png and bg.png, and a ball.toml that knows them."""
    sharp, empty = sharp_ball(None)
    for name, picture in (("sharp", sharp.image), ("bg", empty)):
        write_png16(tmp_path / f"{name}.png", picture.rgb[0].double().numpy().clip(0))
    found = look_at_ball(sharp.image, empty)
    source = SharpSource(
        image=tmp_path / "sharp.png", background=(tmp_path / "bg.png",), disc=found.disc
    )
    ball_file(tmp_path, sharp=source)
    return tmp_path


def test_file_gives_radius_colours_and_plane(tmp_path):
    ball = know_ball(Rig(ball=ball_file(tmp_path)))
    assert ball.radius == 0.03
    assert ball.facts(("colours", "plane_normal")) == {
        "colours": (RED, BLUE),
        "plane_normal": NORMAL,
    }
    assert ball.names == {"colours", "plane_normal"}
    assert ball.files(("ball",)) == (tmp_path / "ball.toml",)


def test_a_standard_deviation_belongs_to_its_own_radius(tmp_path):
    path = ball_file(tmp_path, radius_std=0.0003)
    assert know_ball(Rig(ball=path)).radius_std == 0.0003
    assert know_ball(Rig(ball=path, ball_radius=0.05)).radius_std is None
    assert know_ball(Rig(ball=path, ball_radius=0.05, ball_radius_std=0.001)).radius_std == 0.001
    assert know_ball(Rig(ball=path, ball_radius_std=0.001)).radius_std == 0.001


def test_one_colour_serves_as_the_colour(tmp_path):
    ball = know_ball(Rig(ball=ball_file(tmp_path, colours=(RED,), plane_normal=None)))
    assert ball.facts(("colour", "ball")) == {"colour": RED}


def test_what_is_said_beats_the_file(tmp_path):
    path = ball_file(tmp_path)
    one = know_ball(Rig(ball=path, ball_radius=0.05, ball_colours=(GREEN,)))
    assert one.radius == 0.05
    assert one.facts(("colour", "colours")) == {"colour": GREEN, "colours": (GREEN,)}
    two = know_ball(Rig(ball=path, ball_colours=(GREEN, RED)))
    # the plane of two other colours is not that of the file
    assert two.facts(("colours", "plane_normal")) == {"colours": (GREEN, RED)}


def test_nothing_is_known_of_nothing():
    ball = know_ball(Rig())
    assert (ball.radius, ball.names, ball.files(("ball",))) == (None, frozenset(), ())


def test_pictures_are_opened_only_for_a_field(tmp_path):
    gone = SharpSource(
        image=tmp_path / "gone.png",
        background=(tmp_path / "gone.png",),
        disc=Disc(centre=(30.0, 30.0), semi_axes=(20.0, 20.0), angle=0.0, std=0.1),
    )
    ball = know_ball(Rig(ball=ball_file(tmp_path, sharp=gone)))
    assert "ball" in ball.names
    assert ball.facts(("colours",)) == {"colours": (RED, BLUE)}
    # nobody but the ball file has named that picture
    with pytest.raises(ImageError, match=r"ball\.toml: \S*gone\.png does not exist"):
        ball.facts(("ball",))


def test_file_and_picture_show_the_same_ball(pictures):
    from_file = know_ball(Rig(ball=pictures / "ball.toml"))
    shown = know_ball(
        Rig(
            ball_image=pictures / "sharp.png",
            background=(pictures / "bg.png",),
            response="linear",
        )
    )
    assert from_file.files(("ball",))[1:] == (pictures / "sharp.png", pictures / "bg.png")
    assert shown.files(("ball",)) == (pictures / "sharp.png",)
    first, second = (ball.facts(("ball",))["ball"] for ball in (from_file, shown))
    assert first.disc.centre == pytest.approx(second.disc.centre, abs=0.02)
    assert float((first.rgb - second.rgb).abs().mean()) < 1e-3


def test_bad_picture_is_named(pictures):
    shown = Rig(
        ball_image=pictures / "bg.png", background=(pictures / "bg.png",), response="linear"
    )
    with pytest.raises(CalibrationError, match=r"bg\.png: no ball found"):
        know_ball(shown).facts(("ball",))


def test_a_picture_that_is_not_there_is_told_though_nobody_looks(tmp_path):
    with pytest.raises(ImageError, match=r"gone\.png does not exist"):
        know_ball(Rig(ball_image=tmp_path / "gone.png", ball_colours=(RED,)))


def test_damaged_file_is_a_configuration_error(tmp_path):
    (tmp_path / "ball.toml").write_text("radius_m = 3")
    with pytest.raises(ConfigError, match=r"toolkit\.ball/1"):
        know_ball(Rig(ball=tmp_path / "ball.toml"))


def test_measure_says_why_a_sharp_picture_is_refused(pictures, capsys):
    from toolkit import Camera
    from toolkit.camera_file import write_camera

    camera = Camera(width=183, height=183, fx=400, fy=400, cx=91, cy=91)
    write_camera(pictures / "camera.toml", camera, rms_px=0.1, views=9, images=["a.png"])
    empty = str(pictures / "bg.png")
    line = ["measure", str(pictures / "sharp.png"), "--background", empty, "--radius", "0.05"]
    more = ["--estimator", "known-shading", "--ball-image", empty, "--response", "linear"]
    assert main([*line, *more, "--json"]) == 5
    out, err = capsys.readouterr()
    assert '"refused"' in out
    assert "no ball found" in err
    assert main([*line, "--estimator", "known-shading"]) == 2
    assert "--ball-image F, or --ball F.toml" in capsys.readouterr().err


def written(folder, sharp, empty):
    for name, picture in (("sharp", sharp.image), ("bg", empty)):
        write_png16(folder / f"{name}.png", picture.rgb[0].double().numpy().clip(0))
    return Rig(ball_image=folder / "sharp.png", background=(folder / "bg.png",))


def test_a_sharp_picture_alone_teaches_the_plane_of_two_pigments(sharp_ball, tmp_path):
    pigments = ((0.8, 0.1, 0.05), (0.1, 0.2, 0.8))
    said = written(tmp_path, *sharp_ball(lambda _: StripedBall(colours=pigments)))
    ball = know_ball(said)
    (normal,) = ball.facts(("colours", "plane_normal")).values()
    for pigment in pigments:
        assert sum(n * c for n, c in zip(normal, pigment, strict=True)) == pytest.approx(
            0, abs=0.01
        )
    assert ball.files(("plane_normal",)) == (tmp_path / "sharp.png",)


def test_a_sharp_picture_alone_teaches_the_colour_of_a_plain_ball(sharp_ball, tmp_path):
    colour = (0.8, 0.3, 0.1)
    ball = know_ball(written(tmp_path, *sharp_ball(lambda _: PlainBall(colour=colour))))
    assert ball.facts(("colour",))["colour"] == pytest.approx(colour, abs=0.01)


def test_a_colour_that_is_named_is_not_learnt(sharp_ball, tmp_path):
    said = written(tmp_path, *sharp_ball(None))
    ball = know_ball(replace(said, ball_colours=(GREEN,)))
    assert ball.facts(("colour", "plane_normal")) == {"colour": GREEN}
    assert ball.files(("colour",)) == ()
