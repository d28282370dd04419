import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("toolkit", "calibration", "plugins")
HEAVY = {"torch", "cv2", "kornia", "rawpy", "av", "colour", "numpy", "scipy"}


def sources(package: str) -> list[Path]:
    return sorted([*(ROOT / package).rglob("*.py"), *(ROOT / package).rglob("*.pyi")])


def imported(path: Path) -> Iterator[str]:
    """Every module a file imports, at its top or inside its functions."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")


def top_level(path: Path) -> Iterator[str]:
    """Modules imported by the mere import of a file."""
    for node in ast.parse(path.read_bytes()).body:
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "."


def is_in(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("toolkit", ("calibration", "plugins")),
        ("calibration", ("plugins",)),
        ("plugins", ("calibration",)),
    ],
)
def test_imports_form_a_star(package, forbidden):
    files = sources(package)
    assert files
    wrong = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in files
        for module in imported(path)
        if any(is_in(module, other) for other in forbidden)
    ]
    assert wrong == []


def test_plugins_use_the_public_names_only():
    wrong = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in sources("plugins")
        for module in imported(path)
        if is_in(module, "toolkit") and module != "toolkit"
    ]
    assert wrong == []


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_are_absolute(package):
    relative = [m for path in sources(package) for m in imported(path) if m.startswith(".")]
    assert relative == []


@pytest.mark.parametrize("folder", ["toolkit/cli", "calibration/cli"])
def test_command_modules_are_light(folder):
    heavy = [
        f"{path.name} imports {module}"
        for path in (ROOT / folder).glob("*.py")
        for module in top_level(path)
        if module.partition(".")[0] in HEAVY
    ]
    assert heavy == []


def loaded_after(code: str) -> set[str]:
    text = f"import sys\n{code}\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return {name.partition(".")[0] for name in done.stderr.split()}


@pytest.mark.parametrize(
    "code",
    [
        "import toolkit",
        "from toolkit.cli.main import main; main(['--help'])",
        "from toolkit import registry; assert registry.installed()",
    ],
)
def test_heavy_packages_stay_unloaded(code):
    loaded = loaded_after(code)
    assert "toolkit" in loaded
    assert loaded & (HEAVY | {"plugins"}) == set()


def test_public_name_is_loaded_when_used():
    assert "torch" in loaded_after("import toolkit; toolkit.Camera")
