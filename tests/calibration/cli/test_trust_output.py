import json

import pytest

from toolkit.camera_file import read_camera
from toolkit.cli.main import main


def run(photos, tmp_path, *words):
    out = tmp_path / "camera.toml"
    code = main(["calibrate", "--images", *map(str, photos.paths), "--out", str(out), *words])
    return code, out


def test_json_says_how_far_the_lens_can_be_trusted(photos, tmp_path, capsys):
    code, out = run(photos, tmp_path, "--json", "--bootstrap", "20")
    assert code == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["model_scores"]) >= 6
    (taken,) = [score for score in result["model_scores"] if score["is_taken"]]
    assert taken["held_out_px"] == result["held_out_px"]
    assert sum(map(sum, result["grid"])) == 54 * 6
    assert set(result["tilts"]) == {"left", "right", "up", "down"}
    assert {gate["code"] for gate in result["gates"]} >= {"few_views", "poor_coverage"}
    assert len(result["projection_std_px"]) == 7
    assert len(result["bootstrap_ratio"]) == 4
    assert result["advice"].split()[1:3] == ["more", "views:"]
    assert "model_scores" in out.read_text()


def test_the_text_names_the_lens_and_advises_on_more_photos(photos, tmp_path, capsys):
    code, _ = run(photos, tmp_path)
    text = capsys.readouterr().out
    assert code == 0
    assert "lens pinhole 4, flat board: held-out" in text
    assert "advice: two more views: board" in text
    assert "ok: the focal length is known to" in text


def test_a_model_can_be_forced(photos, tmp_path):
    code, out = run(photos, tmp_path, "--model", "fisheye", "--quiet")
    assert code == 0
    camera = read_camera(out)
    assert camera.model == "fisheye"
    assert camera.covariance.shape == (8, 8)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--model", "spherical"), "spherical"),
        (("--bootstrap", "3"), "3 bootstrap draws are too few; 0 or at least 20"),
    ],
)
def test_what_cannot_be_is_exit_2(photos, tmp_path, capsys, words, message):
    code, out = run(photos, tmp_path, *words)
    assert code == 2
    assert message in capsys.readouterr().err
    assert not out.exists()
