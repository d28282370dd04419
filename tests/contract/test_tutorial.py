"""The tutorial shows the code of the example, word for word, and commands that exist."""

import re
from pathlib import Path

import pytest

from toolkit.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "write-a-plugin.md").read_text()
PACKAGE = ROOT / "examples" / "plugin_package"
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", TEXT, flags=re.M | re.S)


def test_its_code_is_that_of_the_example():
    files = [
        (PACKAGE / name).read_text()
        for name in ("src/chroma_key/__init__.py", "tests/test_chroma_key.py")
    ]
    code = [block for kind, block in BLOCKS if kind == "python"]
    assert len(code) == 2
    for block, file in zip(code, files, strict=True):
        assert block in file


def test_its_entry_point_is_that_of_the_example():
    tables = [block for kind, block in BLOCKS if kind == "toml"]
    assert tables[0] in (PACKAGE / "pyproject.toml").read_text()


COMMANDS = sorted(set(re.findall(r"^toolkit (plugins \w+|\w+)", TEXT, flags=re.M)))


@pytest.mark.parametrize("command", COMMANDS)
def test_its_commands_exist_with_their_options(command, capsys):
    assert main([*command.split(), "--help"]) == 0
    known = capsys.readouterr().out
    for line in re.findall(rf"^toolkit {command}\b(.*)$", TEXT, flags=re.M):
        for option in re.findall(r"--[a-z-]+", line):
            assert option in known


def test_it_shows_commands():
    assert {"plugins new", "plugins check", "measure", "simulate"} <= set(COMMANDS)
