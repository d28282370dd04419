import csv
import io
import subprocess
import sys
from pathlib import Path

import pytest

from toolkit.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
MAX_LINES = 50


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small simulated shot with boards and a calibrated camera."""
    folder = tmp_path_factory.mktemp("demo")
    assert (
        main([*"simulate --preset parabola --size 600x400 --boards 6 --out".split(), str(folder)])
        == 0
    )
    boards = [str(path) for path in sorted((folder / "boards").glob("*.dng"))]
    assert main(["calibrate", "--images", *boards, "--out", str(folder / "camera.toml")]) == 0
    return folder


def run(example: str, *words: str | Path) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(ROOT / "examples" / example), *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_calibrate(demo):
    boards = sorted((demo / "boards").glob("*.dng"))
    assert "focal length" in run("01_calibrate.py", *boards)


def test_measure(demo):
    out = run("02_measure.py", demo / "shot.dng")
    assert "position m" in out
    assert "speed m/s" in out


def test_trajectory(demo):
    rows = list(csv.DictReader(io.StringIO(run("03_trajectory.py", demo / "shot.dng"))))
    times = [float(row["time_s"]) for row in rows]
    assert len(rows) > 10
    assert times == sorted(times)
    assert all(2 < float(row["z_m"]) < 3 for row in rows)


def test_compare_with_truth(demo):
    shot, out = str(demo / "shot.dng"), str(demo / "measurement.json")
    assert main(["measure", shot, "--out", out]) == 0
    last = run("compare_with_truth.py", demo).splitlines()[-1]
    assert last.startswith("position is off by ")
    assert float(last.split()[4]) < 1.0  # ball radii, on a small noisy picture


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_examples_are_short(path):
    assert len(path.read_text().splitlines()) < MAX_LINES
