import json
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest

import toolkit.shot
from toolkit import Measurement, StreakError
from toolkit.cli.main import main
from toolkit.cli.measure import Stage
from toolkit.imaging import write_png16
from toolkit.pipeline import STAGES


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
    more += ["--readout", "0.005", "--stage", "profiles"]
    assert main([*words, *more, "--set", "colour=1,1,1"]) == 0
    assert (seen["ball_radius"], seen["ball_radius_std"]) == (0.036, 0.001)
    assert (seen["exposure"], seen["roi"]) == (0.02, (1, 2, 30, 20))
    assert (seen["readout"], seen["stage"]) == (0.005, "profiles")
    assert seen["estimator"].colour == (1.0, 1.0, 1.0)
    out, err = capsys.readouterr()
    assert "7.25 m/s" in out
    assert err == ""


def test_every_stage_can_be_named(words, seen):
    assert get_args(Stage) == STAGES
    for stage in STAGES:
        assert main([*words, "--stage", stage]) == 0
        assert seen["stage"] == stage


def test_readout_without_an_exposure_time_is_one_line_and_2(words, seen, folder, capsys):
    write_png16(folder / "shot.png", np.linspace(0.2, 0.4, 3600).reshape(3, 30, 40))
    assert main([*words, "--readout", "0.01"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "give --exposure, or --readout 0" in err
    assert main([*words, "--readout", "0"]) == 0


def test_each_stage_prints_and_draws_its_own(tmp_path, capsys):
    folder = tmp_path / "shot"
    quick = ["--size", "600x400", "--format", "png", "--noise", "0.003", "--readout", "0.01"]
    assert main(["simulate", "--out", str(folder), *quick]) == 0
    seen = {}
    for stage in STAGES:
        capsys.readouterr()
        overlay = tmp_path / f"{stage}.png"
        words = ["measure", str(folder / "shot.png"), "--stage", stage, "--overlay", str(overlay)]
        assert main([*words, "--json"]) == 0
        seen[stage] = Measurement.from_json(capsys.readouterr().out)
        assert seen[stage].stage == stage
        assert (cv2.imread(str(overlay)) != cv2.imread(str(folder / "shot.png"))).any()
    residuals = tmp_path / "residuals.png"
    words = ["measure", str(folder / "shot.png"), "--residuals", str(residuals)]
    assert main([*words, "--stage", "contours"]) == 2
    assert "leaves no residuals to draw" in capsys.readouterr().err
    assert not residuals.exists()
    assert main(words) == 0
    assert cv2.imread(str(residuals)).size
    text = capsys.readouterr().out
    assert "stage sweep" in text
    assert "settled by readout, odds" in text
    assert "bound      at best x" in text
    assert seen["profiles"].position_m is None
    assert seen["contours"].bound is None
    assert seen["contours"].sign.ambiguous
    truth = json.loads((folder / "truth.json").read_text())
    exact = seen["sweep"]
    assert not exact.sign.ambiguous
    assert exact.time_s == pytest.approx(truth["time_s"], rel=0.01)
    assert exact.speed_m_s == pytest.approx(truth["speed_m_s"], abs=4 * exact.speed_std_m_s)


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
    for flag in ("--camera", "--background", "--radius"):
        assert flag in err


@pytest.mark.parametrize(
    ("more", "code", "text"),
    [
        (["--set", "colour"], 2, "--set is 'colour'; FIELD=VALUE is needed"),
        (["--roi", "1,2,3"], 2, "--roi is '1,2,3'; 4 values"),
        (["--ball-colour", "red"], 2, "--ball-colour is 'red'; 3 values"),
        (["--overlay", "o.jpg"], 2, "must end in .png"),
        (["--residuals", "r.jpg"], 2, "--residuals is r.jpg; its name must end in .png"),
        (["--residuals", "o.png", "--out", "./o.png"], 2, "as --out is; choose another name"),
        (["--overlay", "no/o.png"], 2, "there is no folder no; make it"),
        (["--overlay", "o.png", "--out", "./o.png"], 2, "as --out is; choose another name"),
        (["--ball-colour", "0.1,0.2,0.3"], 2, "2 ball colours are given, but estimator 'uniform'"),
        (["--ball-colour", "0.1,0.2"], 2, "--ball-colour is '0.1,0.2'; 3 values"),
        (["--radius", "0"], 2, "the ball's radius is 0 m; a number from 1e-06 to 10000 m"),
        (["--radius", "-1"], 2, "the ball's radius is -1 m"),
        (["--radius", "nan"], 2, "the ball's radius is nan m"),
        (["--radius", "1e300"], 2, "the ball's radius is 1e+300 m"),
        (["--radius", "ball"], 2, "--radius"),
        (["--radius-std", "nan"], 2, "deviation of the ball's radius is nan m"),
        (["--exposure", "nan"], 2, "the exposure time is nan s; a number from 1e-09 to 100000 s"),
        (["--exposure", "1e-300"], 2, "the exposure time is 1e-300 s"),
        (["--readout", "-0.01"], 2, "the readout time is -0.01 s; a number from 0 to 100000 s"),
        (["--readout", "nan"], 2, "the readout time is nan s"),
        (["--readout", "slow"], 2, "--readout"),
        (["--stage", "edges"], 2, "'edges' is not one of 'profiles', 'contours', 'sweep'"),
        (["--roi", "30,0,20,20"], 2, "is not inside the picture of 40x30"),
        (["--set", "shine=1"], 2, "has no field 'shine'; its fields are: colour"),
        (["--response", "shiny"], 2, "response 'shiny' is neither a file nor a known curve"),
        (["--camera", "none.toml"], 2, "none.toml does not exist"),
        (["--rig", "none.toml"], 2, "none.toml does not exist"),
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


@pytest.mark.parametrize(
    ("flag", "name"),
    [("--overlay", "shot.png"), ("--overlay", "empty.png")]
    + [("--out", f"{name}.toml") for name in ("rig", "camera", "curve")],
)
def test_files_that_the_rig_names_are_inputs_too(seen, folder, flag, name, capsys):
    (folder / "rig.toml").write_text(
        'schema = "toolkit.rig/1"\n[ball]\nradius_m = 0.03\ncolours = [[0.1, 0.2, 0.3]]\n'
        '[background]\nimages = ["empty.png"]\n[response]\nfile = "curve.toml"\n'
    )
    channel = "brightness = [0.0, 1.0]\nexposure = [0.0, 1.0]\nstd = [0.0, 0.0]\n"
    curve = "".join(f"[channels.{letter}]\n{channel}" for letter in "rgb")
    (folder / "curve.toml").write_text('schema = "toolkit.response/1"\n' + curve)
    before = (folder / name).read_bytes()
    assert main(["measure", str(folder / "shot.png"), flag, str(folder / name)]) == 2
    assert "an input; choose another name" in capsys.readouterr().err
    assert (folder / name).read_bytes() == before


@pytest.mark.parametrize(
    ("name", "code", "text"),
    [
        ("none.png", 3, "none.png does not exist"),
        ("", 3, "is a folder; give the path of a picture"),
        ("text.png", 3, "text.png is a text file"),
        ("cut.png", 3, "cut.png is cut or damaged"),
        ("large.png", 4, "the background"),
    ],
)
def test_shots_that_cannot_be_used_leave_old_results(words, seen, folder, name, code, text, capsys):
    (folder / "text.png").write_text("no picture")
    (folder / "cut.png").write_bytes((folder / "shot.png").read_bytes()[:-100])
    large = np.linspace(0.2, 0.3, 3 * 60 * 80).reshape(3, 60, 80)
    write_png16(folder / "large.png", large)
    old = folder / "m.json"
    old.write_text("old")
    words[1] = str(folder / name)
    assert main([*words, "--camera", str(folder / "camera.toml"), "--out", str(old)]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert text in err
    assert err.count("\n") == 1
    assert old.read_text() == "old"


def test_folder_that_cannot_be_written_is_7(words, seen, folder, capsys):
    target = folder / "taken"
    target.mkdir()
    assert main([*words, "--out", str(target)]) == 7
    assert "cannot be written" in capsys.readouterr().err
