import json

import pytest

from toolkit.cli.main import main


def test_a_board_is_written_and_the_next_command_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["board"]) == 0
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF-1.4")
    told = capsys.readouterr().out
    assert "wrote board.pdf: board of 9x6 inner corners, squares of 22 mm, on a4" in told
    assert "toolkit calibrate --images photos/*.jpg --board 9x6 --square 0.022" in told


def test_every_option_works(tmp_path, capsys):
    words = ["--kind", "charuco", "--size", "5x7", "--square", "0.03", "--marker", "0.02"]
    words += ["--dictionary", "DICT_6X6_250", "--paper", "letter", "--json"]
    assert main(["board", *words, "--out", str(tmp_path / "c.pdf")]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["schema"] == "toolkit.board/1"
    assert (made["kind"], made["size"], made["paper"]) == ("charuco", [5, 7], "letter")
    assert (made["square_m"], made["marker_m"]) == (0.03, 0.02)
    assert made["dictionary"] == "DICT_6X6_250"
    assert (tmp_path / "c.pdf").stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--out", "b.png"], 2, "--out is b.png; its name must end in .pdf"),
        (["--out", "gone/b.pdf"], 2, "there is no folder gone; make it"),
        (["--square", "0.04"], 2, "does not fit a4"),
        (["--marker", "0.01"], 2, "--marker and --dictionary belong to --kind charuco"),
        (["--size", "9by6"], 2, "'9by6' is no size"),
        (["--kind", "charuco", "--dictionary", "DICT_9"], 2, "DICT_9 is not known"),
    ],
)
def test_what_cannot_be_is_one_line_and_leaves_no_file(
    tmp_path, monkeypatch, capsys, words, code, message
):
    monkeypatch.chdir(tmp_path)
    assert main(["board", *words]) == code
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
