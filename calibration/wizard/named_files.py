"""Pictures as people name them: a folder, a pattern, quoted names, or dropped on a terminal."""

import os
import shlex
from collections.abc import Sequence
from difflib import get_close_matches
from glob import glob, has_magic
from pathlib import Path

from toolkit.errors import ConfigError
from toolkit.imaging.kinds import RAW_NAMES

PICTURES = RAW_NAMES | {".jpg", ".jpeg", ".png", ".tif", ".tiff"}
MOST_LISTED = 4


def split_words(line: str) -> tuple[str, ...]:
    """Take a typed line apart as a shell would, quotes and escaped blanks included.

    A line that is one existing file is one word, whatever blanks its name holds.
    """
    line = line.strip()
    if Path(line).expanduser().exists():
        return (line,)
    if os.name == "nt":  # backslashes are folders there
        return tuple(word.strip("\"'") for word in shlex.split(line, posix=False))
    try:
        return tuple(shlex.split(line))
    except ValueError:  # a quote that is not closed, or an apostrophe
        return tuple(line.split())


def find_pictures(words: Sequence[str]) -> tuple[Path, ...]:
    """Give the pictures that words name: a folder or a pattern stands for many.

    Raises:
        ConfigError: naming the word that stands for nothing, and what lies where it points.
    """
    found: list[Path] = []
    for word in words:
        found += _find(Path(word).expanduser())
    if not found:
        raise ConfigError("no picture was named; name a folder, a pattern such as chess/*.jpg")
    return tuple(dict.fromkeys(found))


def find_file(words: Sequence[str]) -> Path:
    """Give the one file that words name.

    Raises:
        ConfigError: when it is none, or several.
    """
    if len(words) != 1:
        raise ConfigError(f"{len(words)} files were named; name one")
    path = Path(words[0]).expanduser()
    if path.is_dir():
        raise ConfigError(f"{path} is a folder; name a file in it{_contents(path)}")
    if not path.exists():
        raise ConfigError(_absent(path))
    return path


def _find(path: Path) -> list[Path]:
    if path.is_dir():
        inside = [p for p in sorted(path.iterdir()) if p.suffix.lower() in PICTURES]
        if not inside:
            raise ConfigError(f"{path} holds no pictures{_contents(path)}; name another folder")
        return inside
    if path.exists():
        return [path]
    if has_magic(str(path)):
        matches = sorted(Path(name) for name in glob(str(path), recursive=True))
        if matches:
            return matches
    raise ConfigError(_absent(path))


def _absent(path: Path) -> str:
    """Say that nothing is there, and what is there instead."""
    folder = path.parent
    if not folder.is_dir():
        return f"{path}: there is no folder {folder}; you are in {Path.cwd()}"
    if has_magic(path.name):
        return f"{path}: no file matches{_contents(folder)}"
    near = get_close_matches(path.name, _names(folder), n=1, cutoff=0.6)
    hint = f"; did you mean {folder / near[0]}?" if near else _contents(folder)
    return f"{path} does not exist{hint}"


def _contents(folder: Path) -> str:
    """List some of a folder's files, or say that there are none."""
    names = _names(folder)
    if not names:
        return f"; {folder.resolve()} is empty"
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return f"; {folder.resolve()} holds {', '.join(names[:MOST_LISTED])}{more}"


def _names(folder: Path) -> list[str]:
    try:
        return sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    except OSError:  # not ours to read: then nothing can be suggested
        return []
