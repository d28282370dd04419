"""What commands share: files that words name, where results may go, progress, clean text."""

import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from toolkit.errors import ConfigError


def expand(flag: str, words: Sequence[str]) -> list[Path]:
    """Give the files that words name; a word that is no file but a pattern stands for its matches.

    Args:
        flag: the option that was given, for messages.
        words: paths and patterns.

    Raises:
        ConfigError: when a pattern matches nothing.
    """
    from glob import glob, has_magic

    paths: list[Path] = []
    for word in words:
        is_pattern = has_magic(word) and not Path(word).exists()
        matches = sorted(glob(word, recursive=True)) if is_pattern else [word]
        if not matches:
            raise ConfigError(f"{flag} {word}: no file matches; check the folder and the ending")
        paths += map(Path, matches)
    return paths


def check_ending(flag: str, path: Path | None, *endings: str) -> None:
    """Refuse a result whose name does not end as its format does, `.png` for one.

    Raises:
        ConfigError: then.
    """
    if path is not None and path.suffix.lower() not in endings:
        raise ConfigError(f"{flag} is {path}; its name must end in {' or '.join(endings)}")


def check_outputs(results: Mapping[str, Path | None], inputs: Iterable[Path]) -> None:
    """Refuse results that would replace an input or each other, or have no folder to go to.

    Args:
        results: by the option that names each; None where it was not given.
        inputs: files that are read.

    Raises:
        ConfigError: then.
    """
    taken = dict.fromkeys((path.resolve() for path in inputs), "an input")
    for flag, path in results.items():
        if path is None:
            continue
        if path.resolve() in taken:
            raise ConfigError(f"{flag} is {path}, {taken[path.resolve()]}; choose another name")
        if not path.absolute().parent.is_dir():
            raise ConfigError(f"{flag} is {path}, but there is no folder {path.parent}; make it")
        taken[path.resolve()] = f"as {flag} is"


def is_quiet() -> bool:
    """Whether the user asked to hear of nothing but the result."""
    return not logging.getLogger("toolkit").isEnabledFor(logging.INFO)


@contextmanager
def progress(text: str, count: int) -> Iterator[Callable[[Path], None]]:
    """Show a bar on stderr, on a terminal that was not asked to be quiet; call it for each file."""
    if is_quiet() or not sys.stderr.isatty():
        yield lambda path: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=count)
        yield lambda path: bar.advance(task)


def printable(text: str) -> str:
    """Keep control characters and undecodable bytes of file names from the terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)
