import ast
import os
import shutil
import stat
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from toolkit import ConfigError, EnvironmentFault, PluginError
from toolkit.cli.main import main
from toolkit.new_plugin import write_plugin

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_plugin("two-tone_9", tmp_path_factory.mktemp("new") / "mine")


def contents(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_the_package_is_complete(package):
    assert contents(package) == [
        "README.md",
        "pyproject.toml",
        "src/two_tone_9/__init__.py",
        "tests/test_two_tone_9.py",
    ]
    table = tomllib.loads((package / "pyproject.toml").read_text())
    assert table["project"]["entry-points"]["toolkit.alpha_estimators"] == {
        "two-tone_9": "two_tone_9:TwoTone9"
    }
    assert not any("$" in path.read_text() for path in package.rglob("*.*") if path.is_file())
    for path in package.rglob("*.py"):
        ast.parse(path.read_text())
    assert stat.S_IMODE(package.stat().st_mode) == 0o777 & ~current_umask()


def current_umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask


def test_it_passes_its_own_tests_at_once(package, tmp_path):
    """Install it as pip would, without a network, and run its tests and the command line."""
    site = tmp_path / "site"
    pip = "-m pip install --quiet --no-deps --no-build-isolation --no-index --target".split()
    copy = shutil.copytree(package, tmp_path / "copy")  # building leaves files behind
    done = subprocess.run(
        [sys.executable, *pip, str(site), str(copy)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    environment = {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}

    def run(*words: str) -> str:
        found = subprocess.run(
            [sys.executable, "-W", "error", *words],
            capture_output=True,
            text=True,
            check=False,
            cwd=package,
            env=environment,
        )
        assert found.returncode == 0, found.stdout + found.stderr
        return found.stdout

    assert "27 passed" in run("-m", "pytest", "-q", "-p", "no:cacheprovider")
    call = "import sys; from toolkit.cli.main import main; sys.exit(main(sys.argv[1:]))"
    listed = run("-c", call, "plugins", "list")
    assert "two-tone_9 toolkit-two-tone_9 0.1.0" in " ".join(listed.split())
    shown = run("-c", call, "plugins", "show", "two-tone_9")
    assert "How many times as bright as that colour the ball is." in shown


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Shiny", "does not match"),
        ("-x", "does not match"),
        ("a/b", "does not match"),
        ("../up", "does not match"),
        ("x" * 42, "does not match"),
        ("auto", "the name 'auto' is reserved"),
        ("shiny-", "must end in a letter or digit"),
        ("class", "Python has a module or word 'class' already"),
        ("random", "Python has a module or word 'random' already"),
        ("torch", "Python has a module or word 'torch' already"),
        ("two-colour", "of that name is installed already"),
    ],
)
def test_a_name_that_will_not_do_is_refused(tmp_path, name, reason):
    with pytest.raises(PluginError, match=reason):
        write_plugin(name, tmp_path / "mine")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("make", [Path.mkdir, Path.touch, lambda path: path.symlink_to("nowhere")])
def test_what_exists_is_left_alone(tmp_path, make):
    make(tmp_path / "mine")
    with pytest.raises(ConfigError, match="exists already"):
        write_plugin("shiny", tmp_path / "mine")
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_folder_in_no_folder_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="there is no folder"):
        write_plugin("shiny", tmp_path / "none" / "mine")


def test_nothing_half_written_stays_behind(tmp_path, monkeypatch):
    def fail(self, *words, **more):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(EnvironmentFault, match="No space left on device"):
        write_plugin("shiny", tmp_path / "mine")
    assert list(tmp_path.iterdir()) == []


def test_the_command_says_what_is_next(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["plugins", "new", "shiny"]) == 0
    assert "pip install -e shiny && toolkit plugins list" in capsys.readouterr().out
    assert (tmp_path / "shiny/src/shiny/__init__.py").is_file()
    assert main(["plugins", "new", "shiny"]) == 2
    assert main(["plugins", "new", "glossy", "--out", "other"]) == 0
    assert (tmp_path / "other/src/glossy/__init__.py").is_file()
    assert main(["plugins", "new", "Shiny!"]) == 2
