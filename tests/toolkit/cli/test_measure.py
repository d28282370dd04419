import json
from pathlib import Path

import cv2
import pytest

import toolkit.shot
from toolkit import Measurement, StreakError
from toolkit.cli.main import main


@pytest.fixture
def words(folder: Path) -> list[str]:
    """A command line on which nothing is missing."""
    shot, empty = str(folder / "shot.png"), str(folder / "empty.png")
    line = ["measure", shot, "--background", empty]
    return [*line, "--radius", "0.036", "--ball-colour", "0.5,0.6,0.7"]


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """Put a pipeline that measures nothing in place of the real one; gives what it was handed."""
    seen: dict[str, object] = {}

    def stand_in(image, background, **rest):
        seen.update(rest)
        return Measurement(stage="contours", speed_m_s=7.25)

    monkeypatch.setattr(toolkit.shot, "measure", stand_in)
    return seen


@pytest.fixture
def refusing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(image, background, **rest):
        raise StreakError("no streak was found; check the background")

    monkeypatch.setattr(toolkit.shot, "measure", refuse)


def test_flags_reach_the_measurement(words, seen, capsys):
    more = ["--exposure", "0.02", "--radius-std", "0.001", "--roi", "1,2,30,20"]
    assert main([*words, *more, "--set", "colour=1,1,1"]) == 0
    assert (seen["ball_radius"], seen["ball_radius_std"]) == (0.036, 0.001)
    assert (seen["exposure"], seen["roi"]) == (0.02, (1, 2, 30, 20))
    assert seen["estimator"].colour == (1.0, 1.0, 1.0)
    out, err = capsys.readouterr()
    assert "7.25 m/s" in out
    assert err == ""


def test_json_is_one_object_alone_on_stdout(words, seen, capsys):
    assert main([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["speed_m_s"] == 7.25
    assert json.loads(out)["estimator"] == "uniform"
    assert err == ""


def test_files_are_written(words, seen, folder, capsys):
    out, overlay = folder / "m.json", folder / "o.png"
    assert main([*words, "--out", str(out), "--overlay", str(overlay)]) == 0
    assert Measurement.from_json(out.read_text()).speed_m_s == 7.25
    assert cv2.imread(str(overlay)).shape == (30, 40, 3)


def test_refusal_is_5_with_a_json_object_and_no_overlay(words, refusing, folder, capsys):
    out, overlay = folder / "m.json", folder / "o.png"
    assert main([*words, "--json", "--out", str(out), "--overlay", str(overlay)]) == 5
    printed, err = capsys.readouterr()
    assert json.loads(printed)["status"] == "refused"
    assert json.loads(printed)["reason"].startswith("no streak was found")
    assert out.read_text() == printed
    assert not overlay.exists()
    assert err == "toolkit: no streak was found; check the background\n"


def test_refusal_without_json_prints_nothing_on_stdout(words, refusing, capsys):
    assert main(words) == 5
    assert capsys.readouterr().out == ""


def test_missing_inputs_are_one_line_and_2(folder, capsys):
    (folder / "camera.toml").unlink()
    assert main(["measure", str(folder / "shot.png"), "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    for flag in ("--camera", "--background", "--radius", "--ball-colour"):
        assert flag in err


@pytest.mark.parametrize(
    ("more", "code", "text"),
    [
        (["--set", "colour"], 2, "--set is 'colour'; FIELD=VALUE is needed"),
        (["--roi", "1,2,3"], 2, "--roi is '1,2,3'; 4 values"),
        (["--ball-colour", "red"], 2, "--ball-colour is 'red'; 3 values"),
        (["--overlay", "o.jpg"], 2, "must end in .png"),
        (["--overlay", "no/o.png"], 2, "there is no folder no; make it"),
        (["--frame", "3"], 2, "frame"),
        (["--estimator", "shiny"], 2, "no estimator 'shiny'"),
        (["--background", "none.png"], 3, "none.png"),
    ],
)
def test_other_mistakes(words, seen, more, code, text, capsys):
    assert main([*words, *more]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert text in err
    assert err.count("\n") == 1


def test_input_is_never_overwritten(words, seen, folder, capsys):
    before = (folder / "empty.png").read_bytes()
    assert main([*words, "--overlay", str(folder / "empty.png")]) == 2
    assert "an input; choose another name" in capsys.readouterr().err
    assert (folder / "empty.png").read_bytes() == before


def test_folder_that_cannot_be_written_is_7(words, seen, folder, capsys):
    target = folder / "taken"
    target.mkdir()
    assert main([*words, "--out", str(target)]) == 7
    assert "cannot be written" in capsys.readouterr().err
