import json
import subprocess
import sys
from pathlib import Path

import pytest

from calibration.cli.calibrate import parse_board, photos_named
from toolkit.camera_file import read_camera
from toolkit.cli.main import main
from toolkit.errors import ConfigError

OLDER = "an older camera\n"


@pytest.fixture
def out(tmp_path):
    """A camera.toml that a failure must leave alone."""
    path = tmp_path / "camera.toml"
    path.write_text(OLDER)
    return path


def run(out, *words):
    return main(["calibrate", *map(str, words), "--out", str(out)])


def test_words_of_an_expanded_glob_need_no_other_flag(
    photos, tmp_path, monkeypatch, capsys, camera
):
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", "--images", *map(str, photos.paths)]) == 0
    written = read_camera(tmp_path / "camera.toml")
    assert written.fx == pytest.approx(camera.fx, rel=2e-3)
    assert written.covariance.shape == (8, 8)
    text = capsys.readouterr()
    assert "board 9x6, 6 of 6 photos used" in text.out
    assert "wrote camera.toml" in text.out
    assert str(photos.paths[3]) in text.out  # its folder's brackets survive
    assert text.err == ""


def test_a_quoted_glob_and_every_option_work(photos, out, capsys, monkeypatch):
    monkeypatch.chdir(photos.paths[0].parent)
    words = ["--images", "view[0-5].png", "--board", "6x9", "--square", "0.03", "--json"]
    assert run(out, *words) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["schema"] == "toolkit.calibration/1"
    assert result["status"] == "ok"
    assert result["board"] == [9, 6]
    assert result["pose_unit"] == "metre"
    assert result["camera"]["fx"] == read_camera(out).fx
    assert 0.01 < result["std"]["fx"] < 2
    assert [view["status"] for view in result["views"]] == ["used"] * 6
    assert {view["corners"] for view in result["views"]} == {54}
    depth = result["views"][0]["T_cam_board"][2][3]
    assert depth == pytest.approx(photos.poses[0][2, 3], rel=0.01)
    assert [caution["code"] for caution in result["warnings"]] == ["board_swapped", "few_views"]


def test_options_may_stand_before_between_and_behind_the_photos(photos, out):
    first, *rest = map(str, photos.paths[:4])
    words = ["--board", "9x6", "--images", first, rest[0], "--quiet", *rest[1:]]
    assert run(out, *words) == 0
    assert read_camera(out).width == 640


def test_files_that_failed_are_named_and_the_rest_is_used(photos, out, tmp_path, capsys):
    text = tmp_path / "notes[bold].jpg"
    text.write_text("no picture")
    assert (
        run(out, "--images", *photos.paths[:4], text, tmp_path / "gone.jpg", photos.paths[1]) == 0
    )
    printed = capsys.readouterr().out
    assert "notes[bold].jpg" in printed
    assert "gone.jpg: left out: cannot be read (No such file or directory)" in printed
    assert "the same file as" in printed
    assert "4 of 7 photos used" in printed
    assert "warning: only 4 views were used" in printed
    assert 'images = ["view0.png", "view1.png", "view2.png", "view3.png"]' in out.read_text()


def test_no_readable_photo_is_exit_3(out, tmp_path, capsys):
    (tmp_path / "a.jpg").write_text("text")
    assert run(out, "--images", tmp_path / "a.jpg", tmp_path / "gone.jpg", "--json") == 3
    text = capsys.readouterr()
    assert text.out == ""
    assert "a.jpg" in text.err
    assert "gone.jpg" in text.err
    assert out.read_text() == OLDER


def test_a_refusal_is_exit_5_and_one_json_object(photos, out, capsys):
    assert run(out, "--images", photos.paths[0], photos.paths[0], "--json") == 5
    text = capsys.readouterr()
    refusal = json.loads(text.out)
    assert refusal["status"] == "refused"
    assert refusal["reason"].startswith("1 different usable view")
    assert [view["status"] for view in refusal["views"]] == ["used", "left out"]
    assert text.err.splitlines()[-1] == f"toolkit: {refusal['reason']}"
    assert out.read_text() == OLDER


def test_a_wrong_board_is_refused_with_each_photo_named(photos, out, capsys):
    assert run(out, "--images", *photos.paths, "--board", "8x7") == 5
    text = capsys.readouterr()
    assert text.out == ""
    for path in photos.paths:
        assert text.err.count(str(path)) == 1
    assert text.err.count("no board of 8x7 inner corners found") == len(photos.paths)
    assert out.read_text() == OLDER


def test_a_few_failures_are_one_line(tmp_path, monkeypatch, capsys):
    """The folder's name is a word of the reason, and is named all the same."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").mkdir()
    assert main(["calibrate", "--images", "a", "gone.jpg", "--out", "c.toml"]) == 3
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "a: cannot be read (Is a directory); gone.jpg: cannot be read" in err


def test_a_photo_is_never_overwritten(photos, capsys):
    before = photos.paths[0].read_bytes()
    assert run(photos.paths[0], "--images", *photos.paths) == 2
    assert "an input; choose another name" in capsys.readouterr().err
    assert photos.paths[0].read_bytes() == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--images", "a.png", "--board", "9by6"],
            "--board '9by6' is no size; count inner corners",
        ),
        (["--images", "a.png", "--square", "-1"], "square is -1.0 m"),
        (["--images", "nothing*.png"], "nothing*.png: no file matches"),
        ([], "no photos were given; use --images chess/*.jpg"),
    ],
)
def test_wrong_usage_is_exit_2(out, capsys, words, message):
    assert run(out, *words) == 2
    assert message in capsys.readouterr().err
    assert out.read_text() == OLDER


def test_a_missing_folder_is_noticed_before_the_work(photos, tmp_path, capsys):
    assert run(tmp_path / "gone" / "camera.toml", "--images", photos.paths[0]) == 2
    assert "there is no folder" in capsys.readouterr().err


@pytest.mark.parametrize(("text", "size"), [("9x6", (9, 6)), (" 6X9 ", (6, 9)), ("10×7", (10, 7))])
def test_board_sizes_are_read(text, size):
    assert parse_board(text) == size


@pytest.mark.parametrize(
    "text", ["", "9", "9x", "x6", "9x2", "9x6x3", "-9x6", "900x6", "9.0x6", "٩x6"]
)
def test_other_texts_are_no_board(text):
    with pytest.raises(ConfigError, match="is no size; count inner corners"):
        parse_board(text)


def test_a_file_whose_name_looks_like_a_pattern_is_taken_as_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a[1].png", "a1.png", "b1.png"):
        Path(name).touch()
    assert photos_named(["a[1].png"]) == [Path("a[1].png")]
    assert photos_named(["?1.png", "gone.png"]) == [
        Path("a1.png"),
        Path("b1.png"),
        Path("gone.png"),
    ]


def test_help_is_light():
    code = (
        "import sys; import calibration.cli.calibrate;"
        "print([m for m in ('torch', 'cv2', 'numpy', 'rich.progress') if m in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_control_characters_of_a_name_do_not_reach_the_terminal(photos, out, tmp_path, capsys):
    odd = tmp_path / "a\x1b[31m\nb.png"
    odd.write_text("no picture")
    assert run(out, "--images", *photos.paths[:3], odd) == 0
    printed = capsys.readouterr().out
    assert "a?[31m?b.png" in printed
    assert "\x1b" not in printed
