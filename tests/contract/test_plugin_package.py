"""The example of a plugin: its own tests, and its way from the command line, as if installed."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from toolkit.synthetic import LitBall, PlainBall
from toolkit.synthetic.folder import write_shot
from toolkit.testing import make_sample

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "examples" / "plugin_package"
PROJECT = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
GROUP = "toolkit.alpha_estimators"
CLI = "import sys; from toolkit.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What pip would write beside an editable install: the entry points."""
    site = tmp_path_factory.mktemp("site")
    info = site / f"{PROJECT['name'].replace('-', '_')}-{PROJECT['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {PROJECT['name']}\nVersion: {PROJECT['version']}\n"
    )
    points = PROJECT["entry-points"][GROUP]
    lines = [f"[{GROUP}]", *(f"{name} = {target}" for name, target in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return site


def run(site: Path, *words: str, code: int = 0) -> str:
    path = os.pathsep.join(map(str, (site, PACKAGE / "src", ROOT)))
    done = subprocess.run(
        [sys.executable, "-W", "error", *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=PACKAGE,
        env={**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


def test_its_own_tests_pass(site):
    assert " passed" in run(site, "-m", "pytest", "-q", "-p", "no:cacheprovider")


def test_it_is_listed_and_explained(site):
    assert "chroma-key toolkit-chroma-key 0.1.0" in " ".join(
        run(site, "-c", CLI, "plugins", "list").split()
    )
    shown = run(site, "-c", CLI, "plugins", "show", "chroma-key")
    assert "Colour of the screen: red, green or blue." in shown
    assert "--set screen=VALUE" in shown


def test_it_measures_from_the_command_line(site, tmp_path):
    appearance = LitBall(pattern=PlainBall(colour=(0.8, 0.8, 0.8)))
    shot = make_sample(appearance, background_colour=(0.1, 0.5, 0.15)).shot
    write_shot(tmp_path, shot, format="png")
    words = ["measure", str(tmp_path / "shot.png"), "--estimator", "chroma-key", "--json"]
    found = json.loads(run(site, "-c", CLI, *words, "--set", "screen=green"))
    assert found["estimator"] == "chroma-key"
    assert found["speed_m_s"] == pytest.approx(float(shot.velocity.norm()), rel=0.03)
    # a blue key finds no screen: refused with a reason, and still one JSON object
    refused = json.loads(run(site, "-c", CLI, *words, "--set", "screen=blue", code=5))
    assert refused["status"] == "refused"
