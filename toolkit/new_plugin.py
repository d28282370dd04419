"""Writes a new package with an estimator that works, for its author to change."""

import keyword
import os
import shutil
import sys
import tempfile
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template

from toolkit import registry
from toolkit.errors import ConfigError, EnvironmentFault, PluginError

TEMPLATES = "templates/plugin"
PLACES = {
    "pyproject.toml.in": "pyproject.toml",
    "README.md.in": "README.md",
    "estimator.py.in": "src/$module/__init__.py",
    "test_estimator.py.in": "tests/test_$module.py",
}
"""Where each template goes."""


def write_plugin(name: str, folder: Path) -> Path:
    """Write a package that declares the estimator `name`, whole or not at all.

    Args:
        name: of the estimator.
        folder: to be made; it must not exist yet.

    Returns:
        The folder.

    Raises:
        PluginError: when the name is no name for an estimator, or is taken.
        ConfigError: when the folder exists, or cannot be made where it is wanted.
        EnvironmentFault: when the machine refuses.
    """
    words = {"name": name, "module": _module(name), "class_name": _class_name(name)}
    if os.path.lexists(folder):
        raise ConfigError(f"{folder} exists already; name a new folder with --out")
    if not folder.parent.is_dir():
        raise ConfigError(f"there is no folder {folder.parent}; make it, or name another --out")
    try:
        _write_whole(folder, words)
    except OSError as error:
        raise EnvironmentFault(
            f"{folder} cannot be written ({error.strerror}); choose another place or make room"
        ) from error
    return folder


def _write_whole(folder: Path, words: dict[str, str]) -> None:
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        for template, place in PLACES.items():
            text = (files("toolkit") / TEMPLATES / template).read_text(encoding="utf-8")
            path = temporary / Template(place).substitute(words)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(Template(text).substitute(words), encoding="utf-8")
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o777 & ~umask)
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _module(name: str) -> str:
    """Give the module's name for an estimator's.

    Raises:
        PluginError: when it would be no good name for either.
    """
    problem = registry.name_problem(name)
    if problem is None and not name[-1].isalnum():
        problem = "it must end in a letter or digit"
    module = name.replace("-", "_")
    if problem is None and (keyword.iskeyword(module) or _is_taken(module)):
        problem = f"Python has a module or word '{module}' already"
    if problem is None and name in {info.name for info in registry.installed()}:
        problem = "an estimator of that name is installed already"
    if problem is not None:
        raise PluginError(f"'{name}' cannot be a new estimator: {problem}; choose another name")
    return module


def _is_taken(module: str) -> bool:
    if module in sys.stdlib_module_names:
        return True
    spec = find_spec(module)
    return spec is not None and spec.origin is not None  # a mere folder has no origin


def _class_name(name: str) -> str:
    """Give the class's name for an estimator's: shiny-ball becomes ShinyBall."""
    return "".join(part.capitalize() for part in name.replace("-", "_").split("_"))
