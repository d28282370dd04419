import json

import numpy as np
import pytest

from toolkit.cli.main import main
from toolkit.imaging import write_png16
from toolkit.synthetic.boards import board_poses, render_board

OLDER = "an older page\n"


@pytest.fixture(scope="module")
def boards(tmp_path_factory, camera):
    """Four rendered photos of a board, and one that shows none."""
    folder = tmp_path_factory.mktemp("boards")
    for number, pose in enumerate(board_poses(4, camera, (9, 6), 0.03)):
        shot = render_board(camera, (9, 6), 0.03, pose, seed=number)
        write_png16(folder / f"{number}.png", shot.image.rgb[0].clamp(0, 1).numpy())
    write_png16(folder / "sky.png", np.tile(np.linspace(0.2, 0.5, 640), (3, 480, 1)))
    return folder


@pytest.fixture
def run(boards, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return lambda *words: main(["calibrate", "--images", str(boards / "*.png"), *words])


def test_the_command_writes_the_page_beside_the_camera(run, tmp_path):
    assert run("--report", "page.html", "--response", "srgb") == 0
    page = (tmp_path / "page.html").read_text()
    assert "sky.png" in page
    assert "The response" in page
    assert "4 of 5 used" in page
    assert (tmp_path / "camera.toml").exists()


def test_json_carries_what_the_page_shows(run, capsys):
    assert run("--json") == 0
    told = json.loads(capsys.readouterr().out)
    errors = np.array(told["residuals"]["error_px"])
    assert errors.shape == np.array(told["residuals"]["place_px"]).shape == (4 * 54, 2)
    assert np.sqrt((errors**2).sum(-1).mean()) == pytest.approx(told["rms_px"], abs=0.002)
    assert np.array(told["grid"]).shape == (5, 5)
    assert np.array(told["projection_std_px"], dtype=float).ndim == 2
    for key in ("model_scores", "gates", "advice", "halves", "views"):
        assert key in told


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--report", "page.pdf"], "its name must end in .html"),
        (["--report", "gone/page.html"], "there is no folder gone; make it"),
        (["--report", "c.html", "--out", "c.html"], "choose another name"),
        (["--response", "srgb"], "add --report F.html"),
        (["--report", "page.html", "--response", "srgbb"], "did you mean"),
    ],
)
def test_wrong_usage_is_told_before_the_work(run, tmp_path, capsys, words, message):
    assert run(*words) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_refusal_leaves_an_older_page_alone(run, tmp_path):
    (tmp_path / "page.html").write_text(OLDER)
    assert run("--report", "page.html", "--board", "8x7") == 5
    assert (tmp_path / "page.html").read_text() == OLDER
