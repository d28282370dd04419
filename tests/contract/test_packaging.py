import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def packages_on_disk() -> list[str]:
    return sorted(
        ".".join(init.parent.relative_to(ROOT).parts)
        for top in ("toolkit", "calibration", "plugins")
        for init in (ROOT / top).rglob("__init__.py")
    )


def test_every_package_is_named_in_pyproject():
    assert sorted(PROJECT["tool"]["setuptools"]["packages"]) == packages_on_disk()


@pytest.mark.parametrize("group", sorted(PROJECT["project"]["entry-points"]))
def test_declared_entry_points_are_installed_and_load(group):
    declared = PROJECT["project"]["entry-points"][group]
    installed = {
        point.name: point
        for point in metadata.entry_points(group=group)
        if point.dist is not None and point.dist.name == PROJECT["project"]["name"]
    }
    assert {name: point.value for name, point in installed.items()} == declared
    assert all(callable(point.load()) for point in installed.values())


def test_console_script_is_main():
    (script,) = [p for p in metadata.entry_points(group="console_scripts") if p.name == "toolkit"]
    assert script.value == "toolkit.cli.main:main"


def test_every_dependency_has_its_reason():
    text = (ROOT / "docs" / "dependencies.md").read_text()
    for requirement in PROJECT["project"]["dependencies"]:
        name, _, floor = requirement.partition(">=")
        assert f"| {name} | {floor} |" in text


def test_constraints_pin_every_dependency():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.partition("==")[0] for line in lines if "==" in line}
    wanted = [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["dev"]]
    assert {requirement.partition(">=")[0] for requirement in wanted} <= pinned


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy, so that nothing is left behind among the sources."""
    copy, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("toolkit", "calibration", "plugins"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    # the environment's own setuptools builds it: no network is needed
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir"]
    subprocess.run([*command, str(out), str(copy)], check=True, capture_output=True)
    (path,) = out.glob("*.whl")
    return path


def test_wheel_runs_from_another_place(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    code = (
        "import toolkit, sys; print(toolkit.__file__); from toolkit.cli.main import main; "
        "sys.exit(main(['measure', '--help']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(tmp_path))
    assert "--ball-colour" in done.stdout


def test_wheel_holds_every_package_and_its_data(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    wanted = {f"{package.replace('.', '/')}/__init__.py" for package in packages_on_disk()}
    wanted |= {f"{top}/py.typed" for top in ("toolkit", "calibration", "plugins")}
    wanted |= {
        path.relative_to(ROOT).as_posix() for path in (ROOT / "toolkit/templates").rglob("*.in")
    }
    assert wanted | {"toolkit/__init__.pyi"} <= names
    tops = {name.partition("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {
        "toolkit",
        "calibration",
        "plugins",
    }
