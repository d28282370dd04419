import shutil
from dataclasses import dataclass, field

import pytest

from calibration.wizard.desk import Desk
from calibration.wizard.memory import read_memory
from calibration.wizard.questions import Asker
from calibration.wizard.run import NAMES, run_wizard
from toolkit.cli.main import main


@dataclass
class Script:
    """A person who types lines that were written before, and remembers what was said."""

    lines: list[str]
    heard: list[str] = field(default_factory=list)

    def answer(self, text, default):
        self.heard.append(text)
        if not self.lines:
            raise EOFError(f"nothing is left to answer: {text}")
        return self.lines.pop(0) or default

    def tell(self, text):
        self.heard.append(text)


@pytest.fixture(scope="session")
def simulated(tmp_path_factory):
    """A simulated folder: six photos of a board, a background and a shot."""
    folder = tmp_path_factory.mktemp("wizard") / "sim"
    words = ["simulate", "--out", str(folder), "--boards", "6", "--size", "480x360"]
    assert main([*words, "--quiet"]) == 0
    return folder


@pytest.fixture
def scene(simulated, tmp_path, monkeypatch):
    """An own copy of the simulated pictures without a rig, as the working folder."""
    own = tmp_path / "scene [1]"
    copy_pictures(simulated, own)
    monkeypatch.chdir(own)
    return own


@pytest.fixture
def make_desk():
    """Make a desk over a folder, with a script for the person or nobody there."""
    return _desk


def _desk(folder, *lines, given=None, alone=False, **settings):
    memory = read_memory(folder, NAMES)
    asker = Asker(
        folder=folder,
        given=given or {},
        answers=dict(memory.answers),
        person=None if alone else Script(list(lines)),
    )
    return Desk(folder=folder, asker=asker, memory=memory, **settings)


def copy_pictures(source, folder):
    folder.mkdir()
    shutil.copytree(source / "boards", folder / "boards")
    for name in ("background.dng", "shot.dng"):
        shutil.copy(source / name, folder / name)


@pytest.fixture(scope="session")
def finished(simulated, tmp_path_factory):
    """A folder in which flags alone made a rig, and how the steps ended."""
    folder = tmp_path_factory.mktemp("finished") / "scene [1]"
    copy_pictures(simulated, folder)
    given = {
        "images": (str(folder / "boards"),),
        "background": (str(folder / "background.dng"),),
        "radius": ("50 mm",),
    }
    return folder, run_wizard(_desk(folder, given=given, alone=True))


@pytest.fixture
def done(finished, tmp_path, monkeypatch):
    """An own copy of that folder; nothing in it depends on where it lies."""
    own = tmp_path / "scene [1]"
    shutil.copytree(finished[0], own)
    monkeypatch.chdir(own)
    return own
