"""wizard.toml: what was answered and what was made, so that a second run does nothing twice."""

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from toolkit.errors import ConfigError
from toolkit.files import check_keys, read_toml, sha256, write_text
from toolkit.toml_text import to_toml

FILE_NAME = "wizard.toml"
ANSWERS = "answers"
_KEYS: dict[str, type | tuple[type, ...]] = {
    "key": str,
    "told": list,
    "outputs": list,
    "hashes": list,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """One step that is done: from what, and what it wrote and told."""

    key: str  # hash of its answers and of the contents of the files it read
    outputs: Mapping[str, str] = field(default_factory=dict)  # sha256 by path from the folder
    told: tuple[str, ...] = ()


@dataclass(slots=True, kw_only=True)
class Memory:
    """What earlier runs in a folder left, by step."""

    folder: Path
    answers: dict[str, tuple[str, ...]] = field(default_factory=dict)
    steps: dict[str, Record] = field(default_factory=dict)

    def is_done(self, step: str, key: str) -> bool:
        """Whether a step was done from the same answers and contents, its files as it left them."""
        record = self.steps.get(step)
        return record is not None and record.key == key and self.is_untouched(step)

    def is_untouched(self, step: str) -> bool:
        """Whether all files that a step wrote are there as it left them."""
        outputs = self.steps[step].outputs
        return all(fingerprint(self.folder / name) == told for name, told in outputs.items())

    def is_own(self, path: Path) -> bool:
        """Whether a file is as one of the steps wrote it; then it may be written again."""
        name, now = self.name_of(path), fingerprint(path)
        return any(record.outputs.get(name) == now for record in self.steps.values())

    def note(
        self, step: str, key: str, *, outputs: Iterable[Path] = (), told: Iterable[str] = ()
    ) -> None:
        """Remember that a step is done, at once and on disk."""
        made = {self.name_of(path): fingerprint(path) for path in outputs}
        self.steps[step] = Record(key=key, outputs=made, told=tuple(told))
        self.save()

    def forget(self, step: str) -> None:
        """Have a step done again, whatever it was done from."""
        if step in self.steps:
            self.steps[step] = Record(
                key="", outputs=self.steps[step].outputs, told=self.steps[step].told
            )

    def keep_answers(self, names: Iterable[str], answers: Mapping[str, tuple[str, ...]]) -> None:
        """Remember the answers of a step that worked out; those no longer given are forgotten."""
        for name in names:
            self.answers.pop(name, None)
            if name in answers:
                self.answers[name] = answers[name]
        self.save()

    def name_of(self, path: Path) -> str:
        """Give a path as seen from the folder."""
        return seen_from(self.folder, path)

    def save(self) -> None:
        """Write wizard.toml, whole or not at all; not where it says all of this already.

        Raises:
            EnvironmentFault: when the folder cannot be written.
        """
        answers = {name: list(words) for name, words in sorted(self.answers.items())}
        steps = {
            name: {
                "key": record.key,
                "told": list(record.told),
                "outputs": list(record.outputs),
                "hashes": list(record.outputs.values()),
            }
            for name, record in self.steps.items()
        }
        write_if_changed(self.folder / FILE_NAME, to_toml("wizard", {ANSWERS: answers} | steps))


def read_memory(folder: Path, steps: Iterable[str]) -> Memory:
    """Read what earlier runs in a folder left; nothing where there was none.

    Raises:
        ConfigError: when wizard.toml is damaged or of another version.
    """
    path = folder / FILE_NAME
    if not path.exists():
        return Memory(folder=folder)
    table = read_toml(path, "wizard")
    check_keys(str(path), table, dict.fromkeys([ANSWERS, *steps], dict))
    answers = {
        name: tuple(_texts(path, ANSWERS, name, words))
        for name, words in table.pop(ANSWERS, {}).items()
    }
    return Memory(
        folder=folder,
        answers=answers,
        steps={name: _record(path, name, section) for name, section in table.items()},
    )


def key_of(answers: Mapping[str, object], files: Iterable[Path] = ()) -> str:
    """Hash answers and the contents of files; the files' names do not count, their order does."""
    digest = hashlib.sha256()
    for name, value in sorted(answers.items()):
        digest.update(f"{name}={value!r}\0".encode("utf-8", "surrogateescape"))
    for path in files:
        digest.update(fingerprint(path).encode() + b"\0")
    return digest.hexdigest()


def seen_from(folder: Path, place: Path) -> str:
    """Write a path, or a pattern of paths, as seen from a folder, with slashes on every system."""
    try:
        return Path(os.path.relpath(place.absolute(), folder.absolute())).as_posix()
    except ValueError:  # another drive
        return place.absolute().as_posix()


def fingerprint(path: Path) -> str:
    """Hash a file's contents; empty where it cannot be read."""
    try:
        return sha256(path)
    except OSError:
        return ""


def write_if_changed(path: Path, text: str) -> bool:
    """Write a text file unless it holds this text already; tell whether it was written."""
    try:
        if path.read_bytes() == text.encode("utf-8"):
            return False
    except OSError:
        pass  # nothing is there, or it cannot be read: writing says what is wrong
    write_text(path, text)
    return True


def _record(path: Path, name: str, section: Mapping[str, Any]) -> Record:
    check_keys(f"{path} [{name}]", section, _KEYS)
    texts = {
        key: _texts(path, name, key, section.get(key, [])) for key in ("told", "outputs", "hashes")
    }
    if len(texts["outputs"]) != len(texts["hashes"]):
        raise ConfigError(f"{path} [{name}] is damaged; delete the file and begin anew")
    return Record(
        key=section.get("key", ""),
        outputs=dict(zip(texts["outputs"], texts["hashes"], strict=True)),
        told=tuple(texts["told"]),
    )


def _texts(path: Path, section: str, key: str, values: Any) -> list[str]:
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise ConfigError(
            f"{path} [{section}]: '{key}' is no list of texts; delete the file and begin anew"
        )
    return values
