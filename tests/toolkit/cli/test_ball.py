import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from toolkit.ball_file import read_ball
from toolkit.camera_file import write_camera
from toolkit.cli.main import main
from toolkit.imaging import write_png16
from toolkit.synthetic import LambertBall, LitBall, StripedBall, benchmark_scene


def striped(colour):
    return LitBall(pattern=StripedBall(colours=(colour, (0.1, 0.2, 0.6)), pole=(0.5, 0.8, 0.3)))


def write(path: Path, light: torch.Tensor) -> Path:
    write_png16(path, light.double().numpy().clip(0, 1))
    return path


@pytest.fixture
def words(sharp_ball, tmp_path):
    """A command line on which nothing is missing."""
    sharp, empty = sharp_ball(striped)
    image = write(tmp_path / "sharp.png", sharp.image.rgb[0])
    background = write(tmp_path / "bg.png", empty.rgb[0])
    line = ["ball", "--image", str(image), "--background", str(background)]
    return [*line, "--out", str(tmp_path / "ball.toml")]


def test_table_and_file(words, sharp_ball, tmp_path, capsys):
    overlay = tmp_path / "o.png"
    more = ["--radius", "0.05", "--response", "linear", "--overlay", str(overlay)]
    assert main([*words, *more]) == 0
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()] == [
        *("disc", "scale", "mean", "pigment", "pigment", "plane", "off", "wrote")
    ]
    assert err == ""
    ball = read_ball(tmp_path / "ball.toml")
    assert (ball.radius, ball.kind, len(ball.colours)) == (0.05, "plane", 2)
    assert ball.sharp.image.resolve() == tmp_path / "sharp.png"
    assert ball.sharp.response == "linear"
    assert ball.sharp.disc.centre == pytest.approx(sharp_ball(striped)[0].disc.centre, abs=0.3)
    assert ball.sharp.look().rgb.shape[0] == 3
    drawn = cv2.imread(str(overlay))
    x, y = (round(c) for c in ball.sharp.disc.centre)
    rim = drawn[y, round(x + ball.sharp.disc.semi_axes[0])].astype(int)
    assert np.abs(rim[::-1] - (240, 228, 66)).max() < 60  # the outline's yellow


def test_one_colour_is_said_to_be_no_plane(sharp_ball, tmp_path, capsys):
    sharp, empty = sharp_ball(None)
    image = write(tmp_path / "i.png", sharp.image.rgb[0])
    background = write(tmp_path / "b.png", empty.rgb[0])
    out = tmp_path / "ball.toml"
    line = ["ball", "--image", str(image), "--background", str(background), "--out", str(out)]
    assert main(line) == 0
    assert "two pigments cannot be told" in capsys.readouterr().out
    assert (read_ball(out).plane_normal, len(read_ball(out).colours)) == (None, 1)


def test_a_response_that_is_only_assumed_is_said(words, capsys):
    assert main(words) == 0
    assert "assumed" not in capsys.readouterr().out  # the pictures name theirs
    for path in (words[2], words[4]):
        cv2.imwrite(path, cv2.imread(path))  # 8 bits, and no word about their light
    assert main(words) == 0
    assert "caution    the response 'srgb' is only assumed" in capsys.readouterr().out


def test_missing_inputs_are_named_at_once(capsys):
    assert main(["ball"]) == 2
    err = capsys.readouterr().err
    assert "--image F" in err
    assert "--background F" in err
    assert err.count("\n") == 1


def spoilt(words: list[str], change) -> list[str]:
    """Change the sharp picture's light [3, H, W]."""
    from toolkit import read_image

    path = Path(words[2])
    write(path, change(read_image(path, response="linear").rgb[0]))
    return words


def with_a_hand(light):
    light = light.clone()
    light[:, 50:120, 120:] = 0.9
    return light


def cut(light):
    return light[:, :, 45:]


def test_damaged_picture_is_3(words, tmp_path, capsys):
    Path(words[2]).write_bytes(b"no picture")
    assert main(words) == 3
    assert "sharp.png" in capsys.readouterr().err
    assert not (tmp_path / "ball.toml").exists()


@pytest.mark.parametrize(
    ("change", "code", "reason"),
    [(cut, 4, "same camera and settings"), (with_a_hand, 5, "more than a ball")],
)
def test_bad_pictures_have_a_reason_and_a_code(words, tmp_path, capsys, change, code, reason):
    assert main(spoilt(words, change)) == code
    out, err = capsys.readouterr()
    assert reason in err
    assert (out, err.count("\n")) == ("", 1)
    assert not (tmp_path / "ball.toml").exists()


def test_clipped_ball_is_5(words, sharp_ball, tmp_path, capsys):
    alpha = sharp_ball(striped)[0].alpha
    spoilt(words, lambda light: torch.where(alpha > 0.3, 3 * light, light))
    assert main(words) == 5
    assert "met white" in capsys.readouterr().err


def test_empty_picture_is_5(words, capsys):
    words[2] = words[4]
    assert main(words) == 5
    assert "no ball found" in capsys.readouterr().err


def test_cut_ball_is_5(words, sharp_ball, tmp_path, capsys):
    from toolkit import read_image

    left = round(sharp_ball(striped)[0].disc.centre[0])
    for place in (words[2], words[4]):
        light = read_image(place, response="linear").rgb[0]
        write(Path(place), light[:, :, left:])
    assert main(words) == 5
    assert "border" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (["--radius", "0"], "--radius is 0 m"),
        (["--radius", "nan"], "--radius is nan m"),
        (["--overlay", "x.jpg"], "must end in .png"),
        (["--overlay", "none/x.png"], "there is no folder"),
        (["--response", "srbg"], "srbg"),
    ],
)
def test_bad_usage_is_2(words, tmp_path, capsys, monkeypatch, more, reason):
    monkeypatch.chdir(tmp_path)
    assert main([*words, *more]) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "ball.toml").exists()


def test_inputs_are_never_replaced(words, capsys):
    words[-1] = words[2]
    assert main(words) == 2
    assert "an input" in capsys.readouterr().err


@pytest.fixture
def three(sharp_ball, tmp_path):
    """Three pictures of a matt ball, each over a background of its own, the last in other light."""
    line = ["ball"]
    for seed, level in ((0, 1.0), (1, 1.0), (2, 0.8)):
        sharp, empty = sharp_ball(matt, seed=seed)
        light = sharp.image.rgb[0]
        light = torch.where(sharp.alpha > 0.01, level * light, light)
        line += ["--image", str(write(tmp_path / f"s{seed}.png", light))]
        line += ["--background", str(write(tmp_path / f"b{seed}.png", empty.rgb[0]))]
    return [*line, "--out", str(tmp_path / "ball.toml")]


def matt(colour):
    return LambertBall(colour=(0.67, 0.49, 0.11))


def test_several_pictures_are_told_one_by_one(three, tmp_path, capsys):
    assert main([*three, "--radius", "0.05", "--radius-std", "0.0001"]) == 0
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()] == [
        *(3 * ["picture", "disc", "scale"]),
        *("mean", "line", "off", "shading", "left", "wrote"),
    ]
    assert "shading    mean of 2 pictures" in out
    assert "s2.png, of colours: is 0.80 times as bright as the others" in out
    assert err == ""
    ball = read_ball(tmp_path / "ball.toml")
    assert (ball.radius, ball.radius_std, len(ball.also)) == (0.05, 0.0001, 1)


def test_json_is_one_object(three, capsys):
    assert main([*three, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["status"], told["kind"], len(told["pictures"])) == ("ok", "line", 3)
    names = {Path(path).name for path in told["shading"]["pictures"]}
    assert names == {"s0.png", "s1.png"}
    assert 0 <= told["shading"]["std_share"] < 0.01
    (left_out,) = told["left_out"]
    assert (Path(left_out["path"]).name, left_out["of"]) == ("s2.png", "colours")
    assert told["radius_m"] is None
    assert len(told["colours"]) == len(told["colours_std"]) == 1


def test_a_refusal_is_json_too(words, capsys):
    words[2] = words[4]
    assert main([*words, "--json"]) == 5
    out, err = capsys.readouterr()
    assert json.loads(out)["status"] == "refused"
    assert "no ball found" in json.loads(out)["reason"]
    assert err.count("\n") == 1


def test_size_by_the_lens_is_told(words, tmp_path, capsys):
    scene = benchmark_scene(width_px=60, length_widths=1, distance_R=15)
    write_camera(tmp_path / "camera.toml", scene.camera)
    lens = [*words, "--camera", str(tmp_path / "camera.toml")]
    assert main(lens) == 0
    assert "scale      0.066" in capsys.readouterr().out
    assert main([*lens, "--radius", "0.05"]) == 0
    assert "distance   0.7" in capsys.readouterr().out
    assert main([*lens, "--distance", "0.75", "--distance-std", "0.002"]) == 0
    out = capsys.readouterr().out
    assert "mm by 1 picture, distances taken for known within 2 mm" in out
    assert "caution    the camera file tells no covariance" in out
    ball = read_ball(tmp_path / "ball.toml")
    assert abs(ball.radius - 0.05) < 2 * ball.radius_std


def test_failure_leaves_the_older_file(words, tmp_path, capsys):
    (tmp_path / "ball.toml").write_text("older\n")
    assert main([*words, "--distance", "0.7"]) == 2
    assert "give --camera F" in capsys.readouterr().err
    assert (tmp_path / "ball.toml").read_text() == "older\n"


def test_patterns_in_quotes_name_several(three, tmp_path, capsys):
    line = ["ball", "--image", str(tmp_path / "s[01].png")]
    line += ["--background", str(tmp_path / "b[01].png"), "--out", str(tmp_path / "ball.toml")]
    assert main(line) == 0
    assert capsys.readouterr().out.count("picture  ") == 2
    assert main([*line[:2], str(tmp_path / "t*.png"), *line[3:]]) == 2
    assert "no file matches" in capsys.readouterr().err
    assert main([*line, "unquoted.png"]) == 2
    assert "put a pattern in quotes" in capsys.readouterr().err
