"""Every question of the wizard: answered by a flag, by an earlier run, or by the person."""

from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from glob import has_magic
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from calibration.wizard.memory import seen_from
from toolkit.cli.terminal import printable
from toolkit.errors import ConfigError

T = TypeVar("T")
Words = tuple[str, ...]
"""An answer as it was written: the words of a flag, or of a typed line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question(Generic[T]):
    """What is asked, the flag that answers it, and how the answer is read."""

    name: str
    flag: str  # with its value, as the help writes it
    text: str  # what the person reads
    parse: Callable[[Words], T]  # raises ConfigError, which says what to write instead
    default: Words | None = None  # None: there is none, and an answer is needed
    split: Callable[[str], Words] = lambda line: (line.strip(),)  # a typed line into words
    is_path: bool = False  # words that name files are kept as seen from the wizard's folder


class Person(Protocol):
    """Who answers at the terminal."""

    def answer(self, text: str, default: str) -> str:
        """Ask one question and give the line typed, `default` for an empty one."""

    def tell(self, text: str) -> None:
        """Show a line."""


class Terminal:
    """The person in front of this process; stdout stays free for the result."""

    def answer(self, text: str, default: str) -> str:
        """Ask on stderr; an end of the input or Ctrl-C ends the program (typer.Abort)."""
        import typer

        shown = printable(f"{text} [{default}]" if default else text)
        return str(typer.prompt(shown, default=default, show_default=False, err=True))

    def tell(self, text: str) -> None:
        """Show a line on stderr, as plain text."""
        import typer

        typer.echo(printable(text), err=True)


@dataclass(slots=True, kw_only=True)
class Asker:
    """Answers questions: a flag first, then what was answered before, then the person.

    `answers` begins with those of earlier runs, and collects what is answered now.
    """

    folder: Path  # from which kept names of files are seen
    given: Mapping[str, Words]  # by flags
    answers: MutableMapping[str, Words]
    person: Person | None = None  # None: nobody is there, and nothing waits
    refused: set[str] = field(default_factory=set)  # answers that did not work out
    renewed: set[str] = field(default_factory=set)  # answers that took the place of a flag's

    def ask(self, question: Question[T]) -> T:
        """Give the answer of a question.

        Raises:
            ConfigError: when a flag's value is impossible, or nobody is there and neither a flag
                nor a default answers; the text names the flag.
        """
        name = question.name
        if name in self.given and name not in self.refused | self.renewed:
            value = _read(question, self.given[name])
            self._keep(question, self.given[name])
            return value
        if name in self.answers and name not in self.refused:
            try:
                return _read(question, self._kept(question))
            except ConfigError as error:  # a file that has gone since
                if self.person is None:
                    raise
                self.person.tell(f"! {error}")
        return self._ask_anew(question)

    def knows(self, name: str) -> bool:
        """Whether a question is answered already."""
        return name not in self.refused and (name in self.given or name in self.answers)

    def refuse(self, *names: str) -> None:
        """Have questions asked again, because what was answered did not work out."""
        self.refused.update(names)

    def _ask_anew(self, question: Question[T]) -> T:
        if self.person is not None:
            before = self._kept(question) if question.name in self.answers else None
            value, words = _converse(self.person, question, before or question.default)
        elif question.default is not None:
            value, words = question.parse(question.default), question.default
        else:
            raise ConfigError(f"{question.flag} is missing: {question.text}")
        self._keep(question, words)
        self.refused.discard(question.name)
        self.renewed.add(question.name)
        return value

    def _keep(self, question: Question[Any], words: Words) -> None:
        if question.is_path:
            words = tuple(_for_file(word, self.folder) for word in words)
        self.answers[question.name] = words

    def _kept(self, question: Question[Any]) -> Words:
        words = self.answers[question.name]
        if question.is_path:
            words = tuple(_from_file(word, self.folder) for word in words)
        return words


def _for_file(word: str, folder: Path) -> str:
    """Write the name of a file, or a pattern, as seen from a folder; other words stay.

    A name always holds a slash then, which tells it from a word such as srgb.
    """
    place = Path(word).expanduser()
    if not (has_magic(word) or place.exists()):
        return word
    seen = seen_from(folder, place)
    return seen if "/" in seen else f"./{seen}"


def _from_file(word: str, folder: Path) -> str:
    """Write what `_for_file` gave so that it is found from here."""
    return seen_from(Path(), folder / word) if "/" in word else word


def _converse(person: Person, question: Question[T], default: Words | None) -> tuple[T, Words]:
    """Ask until the answer can be read."""
    shown = " ".join(default or ())
    while True:
        line = person.answer(question.text, shown)
        words = default if default is not None and line == shown else question.split(line)
        try:
            if not line.strip() and default is None:
                raise ConfigError("an answer is needed; Ctrl-C stops, and what is done is kept")
            return question.parse(words), words
        except ConfigError as error:
            person.tell(f"! {error}")


def _read(question: Question[T], words: Words) -> T:
    try:
        return question.parse(words)
    except ConfigError as error:
        raise ConfigError(f"{_flag(question)}: {error}") from None


def _flag(question: Question[Any]) -> str:
    """Give the flag's name without its value."""
    return question.flag.split()[0]


def yes_or_no(words: Words) -> bool:
    """Read yes or no."""
    word = " ".join(words).strip().lower()
    if word in ("y", "yes", "true"):
        return True
    if word in ("n", "no", "false"):
        return False
    raise ConfigError(f"'{word}' is neither yes nor no")


def optional(parse: Callable[[str], T]) -> Callable[[Words], T | None]:
    """Read one word, where "none" or nothing says that it is not known or not wanted."""

    def read(words: Words) -> T | None:
        text = " ".join(words).strip()
        return None if text.lower() in ("", "none") else parse(text)

    return read


def one_of(*choices: str) -> Callable[[Words], str]:
    """Read one of a few words; its beginning is enough where no other begins alike."""

    def read(words: Words) -> str:
        text = " ".join(words).strip().lower()
        matches = [choice for choice in choices if text and choice.startswith(text)]
        if text in choices:
            return text
        if len(matches) == 1:
            return matches[0]
        raise ConfigError(f"'{text}' is none of {', '.join(choices)}")

    return read
