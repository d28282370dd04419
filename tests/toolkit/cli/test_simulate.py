import json
import subprocess
import sys
from typing import get_args

import pytest

from toolkit.camera_file import read_camera
from toolkit.cli.main import main
from toolkit.cli.simulate import Preset, parse_size
from toolkit.errors import ConfigError
from toolkit.imaging import read_image
from toolkit.rig import read_rig
from toolkit.synthetic import PRESETS


def simulate(out, *words):
    return main(["simulate", "--out", str(out), "--size", "240x160", *words])


@pytest.mark.parametrize("preset", PRESETS)
def test_a_folder_holds_all_that_a_measurement_needs(tmp_path, capsys, preset):
    out = tmp_path / "new" / "shot"
    assert simulate(out, "--preset", preset, "--seed", "3") == 0
    stdout, stderr = capsys.readouterr()
    assert f"toolkit measure {out}/shot.dng" in stdout
    assert stderr == ""
    names = {"shot.dng", "background.dng", "camera.toml", "rig.toml", "truth.json"}
    if preset in ("shaded", "striped"):
        names |= {"ball.dng", "ball.toml"}
    assert {path.name for path in out.iterdir()} == names
    truth = json.loads((out / "truth.json").read_text())
    assert truth["seed"] == 3
    assert read_image(out / "shot.dng").exposure.tolist() == pytest.approx([truth["exposure_s"]])
    assert read_camera(out / "camera.toml").fx == truth["camera"]["fx"]


def test_boards_take_the_place_of_the_camera_and_each_differs(tmp_path, capsys):
    assert simulate(tmp_path, "--boards", "2") == 0
    assert "toolkit calibrate --images" in capsys.readouterr().out
    assert not (tmp_path / "camera.toml").exists()
    first, second = ((tmp_path / f"boards/board_0{i}.dng").read_bytes() for i in (0, 1))
    assert first != second


def test_a_rolling_shutter_is_rendered_and_told_to_the_measurement(tmp_path):
    assert simulate(tmp_path / "global", "--format", "png") == 0
    assert simulate(tmp_path / "rolling", "--format", "png", "--readout", "0.01") == 0
    assert read_rig(tmp_path / "rolling" / "rig.toml").readout == 0.01
    assert json.loads((tmp_path / "rolling" / "truth.json").read_text())["readout_s"] == 0.01
    shots = [(tmp_path / kind / "shot.png").read_bytes() for kind in ("global", "rolling")]
    assert shots[0] != shots[1]


def test_a_seed_repeats_every_byte(tmp_path):
    for name in ("a", "b"):
        assert simulate(tmp_path / name, "--format", "png", "--seed", "5", "--gain", "1e-4") == 0
    for file in ("shot.png", "background.png", "truth.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_noise_is_what_was_asked_for(tmp_path):
    assert simulate(tmp_path, "--noise", "0", "--format", "png") == 0
    quiet = read_image(tmp_path / "background.png").rgb
    assert simulate(tmp_path, "--noise", "0.02", "--format", "png") == 0
    noisy = read_image(tmp_path / "background.png").rgb
    assert float((noisy - quiet).std()) == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--size", "wide"], "--size is wide; WIDTHxHEIGHT is needed"),
        (["--size", "90x300"], "--size is 90x300"),
        (["--size", "90000x90000"], "at most 64000000 px"),
        (["--boards", "-1"], "--boards is -1"),
        (["--seed", "-4"], "--seed is -4"),
        (["--noise", "nan"], "must be finite"),
        (["--noise", "2"], "must lie in 0..1"),
        (["--readout", "-1"], "--readout is -1 s; a number from 0 to 10 is needed"),
        (["--readout", "nan"], "--readout is nan s"),
        (["--preset", "spiral"], "spiral"),
    ],
)
def test_impossible_requests_are_refused_before_anything_is_written(
    tmp_path, capsys, words, complaint
):
    assert main(["simulate", "--out", str(tmp_path / "out"), *words]) == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_with_other_files_is_refused(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text("mine")
    assert simulate(tmp_path) == 2
    assert "holds files that are no simulation" in capsys.readouterr().err
    assert (tmp_path / "rig.toml").read_text() == "mine"


def test_size_is_width_by_height():
    assert parse_size("3000x2000") == (3000, 2000)
    with pytest.raises(ConfigError, match="--size is 3000"):
        parse_size("3000")


def test_the_command_offers_exactly_the_presets_there_are():
    assert get_args(Preset) == tuple(PRESETS)


def test_the_module_is_light():
    check = "import sys, toolkit.cli.simulate; print('torch' in sys.modules, 'cv2' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
