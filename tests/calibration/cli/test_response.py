import json

import cv2
import numpy as np
import pytest

from calibration.cli.response import parse_times
from toolkit.cli.main import main
from toolkit.errors import ConfigError
from toolkit.imaging import write_dng
from toolkit.response import load_response

OLDER = "an older response\n"
TIMES = "1/8,1/4,1/2,1,2,4,8"


@pytest.fixture
def out(tmp_path):
    """A response.toml that a failure must leave alone."""
    path = tmp_path / "response.toml"
    path.write_text(OLDER)
    return path


@pytest.fixture
def photos(tmp_path):
    """Grey photos of a smooth scene through a power law."""
    rng = np.random.default_rng(0)
    smooth = cv2.resize(rng.normal(size=(6, 8)), (160, 120), interpolation=cv2.INTER_CUBIC)
    light = 2 ** (2.7 * smooth / smooth.std() - 3)
    folder = tmp_path / "bracket [1]"
    folder.mkdir()
    for index, time in enumerate(parse_times(TIMES)):
        stored = np.minimum(light * time, 1) ** (1 / 2.2) + rng.normal(0, 1 / 255, light.shape)
        picture = np.clip(np.rint(255 * stored), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"p{index}.png"), picture)
    return sorted(folder.glob("*.png"))


def run(out, *words):
    return main(["response", *map(str, words), "--out", str(out)])


def test_a_bracket_becomes_a_response(photos, out, capsys):
    assert run(out, "--images", *photos, "--times", TIMES) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "7 photos from 0.125 to 8 s" in said.out
    assert f"wrote {out}" in said.out
    curve = load_response(out).curves[0]
    found = curve(np.array([0.25, 0.5, 0.75])) / curve(np.array(0.9))
    np.testing.assert_allclose(found, (np.array([0.25, 0.5, 0.75]) / 0.9) ** 2.2, rtol=0.01)
    assert curve.modes is not None


def test_json_holds_one_object(photos, out, capsys):
    assert run(out, "--images", *photos, "--times", TIMES, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "ok"
    assert found["times_s"] == parse_times(TIMES)
    assert len(found["channels"]["g"]["brightness"]) == 256
    assert found["warnings"] == []


@pytest.mark.parametrize(
    ("count", "times", "code", "text"),
    [
        (7, None, 2, "states no exposure time"),
        (7, "1,2", 2, "2 values for 7 photos"),
        (7, "1,2,3,x,5,6,7", 2, "'x' is no time"),
        (7, ",".join(["1"] * 7), 5, "equally long"),
        (7, "8,4,2,1,1/2,1/4,1/8", 4, "darker"),
        (1, "1/8", 5, "one photo tells nothing"),
        (0, None, 2, "no photos"),
    ],
)
def test_failures_say_why_and_leave_the_old_file(photos, out, capsys, count, times, code, text):
    given = [] if times is None else ["--times", times]
    named = ["--images", *photos[:count]] if count else []
    assert run(out, *named, *given, "--json") == code
    said = capsys.readouterr()
    assert text in said.err
    assert said.err.count("\n") == 1
    assert out.read_text() == OLDER
    assert ("refused" in said.out) == (code == 5)


def test_a_photo_is_not_overwritten(photos, capsys):
    assert run(photos[0], "--images", *photos, "--times", TIMES) == 2
    assert "an input; choose another name" in capsys.readouterr().err


def test_names_are_listed(capsys):
    assert main(["response", "--names"]) == 0
    assert "S-Log3" in capsys.readouterr().out.splitlines()


def test_noise_of_repeated_photos(tmp_path, capsys):
    rng = np.random.default_rng(0)
    ramp = np.linspace(100, 3000, 200) * np.ones((200, 1))
    words = ["response", "--noise", "--images"]
    for index in range(2):
        noisy = np.rint(ramp + rng.normal(size=ramp.shape) * np.sqrt(ramp)).astype(np.uint16)
        words.append(str(tmp_path / f"{index}.dng"))
        write_dng(tmp_path / f"{index}.dng", noisy, white=4095, exposure_s=0.01)
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["gain"][1] == pytest.approx(1 / 4095, rel=0.1)
    assert main(words) == 0
    assert "electrons at white" in capsys.readouterr().out
    assert main([*words, "--times", "1,2"]) == 2


def test_times_are_read():
    assert parse_times("1/4, 0.5 ,2s") == [0.25, 0.5, 2.0]
    assert parse_times(None) is None
    for wrong in ("", "1/0", "a", "1//2"):
        with pytest.raises(ConfigError, match="is no time"):
            parse_times(wrong)
