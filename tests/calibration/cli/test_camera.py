import json

import pytest
import torch

from toolkit.camera import Camera
from toolkit.camera_file import read_camera, write_camera
from toolkit.cli.main import main

COLMAP = "1 OPENCV 1920 1080 1500.5 1501.5 960 540 -0.1 0.02 0.001 -0.002\n"
OLDER = "an older camera\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cameras.txt").write_text(COLMAP)
    return tmp_path


def test_there_and_back(here, capsys):
    assert main(["camera", "import", "cameras.txt"]) == 0
    out = capsys.readouterr().out
    assert "colmap camera '1': 1920x1080 px, pinhole, fx 1500.50" in out
    assert "caution: the file tells no covariance" in out
    assert "wrote camera.toml" in out
    assert read_camera(here / "camera.toml").cx == 959.5
    assert main(["camera", "export", "camera.toml", "--format", "ros", "--out", "c.yaml"]) == 0
    assert main(["camera", "import", "c.yaml", "--out", "again.toml"]) == 0
    first, again = (read_camera(here / name) for name in ("camera.toml", "again.toml"))
    assert torch.equal(first.parameters, again.parameters[:8])


def test_json_is_one_object(here, capsys):
    assert main(["camera", "import", "cameras.txt", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["format"], told["name"], told["camera"]["cy"]) == ("colmap", "1", 539.5)
    assert len(told["cautions"]) == 1
    line = ["camera", "export", "camera.toml", "--format", "kalibr", "--out", "k.yaml", "--json"]
    assert main(line) == 0
    assert json.loads(capsys.readouterr().out)["cautions"] == []


def test_a_lens_that_does_not_fit_is_4_and_the_old_file_stays(here, capsys):
    camera = Camera(
        width=64, height=48, fx=50, fy=50, cx=31, cy=23, model="rational", distortion=(0.1,) * 8
    )
    write_camera(here / "camera.toml", camera)
    (here / "k.yaml").write_text(OLDER)
    line = ["camera", "export", "camera.toml", "--format", "kalibr", "--out", "k.yaml"]
    assert main(line) == 4
    err = capsys.readouterr().err
    assert "8 coefficients" in err
    assert err.count("\n") == 1
    assert (here / "k.yaml").read_text() == OLDER


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["import", "none.yml"], "none.yml does not exist"),
        (["import", "cameras.txt", "--camera", "2"], "there is no camera '2'"),
        (["import", "cameras.txt", "--format", "ros"], "no camera_info of ROS|'key: value'"),
        (["import", "cameras.txt", "--out", "none/c.toml"], "there is no folder"),
        (["import", "cameras.txt", "--out", "cameras.txt"], "an input; choose another name"),
        (["export", "camera.toml"], "--format opencv|ros|kalibr|colmap and --out FILE"),
        (["export", "none.toml", "--format", "ros", "--out", "c.yaml"], "none.toml does not exist"),
    ],
)
def test_bad_usage_is_2_and_the_old_file_stays(here, capsys, words, reason):
    (here / "camera.toml").write_text(OLDER)
    assert main(["camera", *words]) == 2
    out, err = capsys.readouterr()
    assert any(part in err for part in reason.split("|")) or reason in err
    assert (out, err.count("\n")) == ("", 1)
    assert (here / "camera.toml").read_text() == OLDER
    assert (here / "cameras.txt").read_text() == COLMAP
