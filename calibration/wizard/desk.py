"""What every step of the wizard works with: the folder, the answers, the memory of earlier runs."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

from calibration.wizard.memory import Memory
from calibration.wizard.questions import Asker, Question, yes_or_no
from toolkit.errors import ConfigError

T = TypeVar("T")
Progress = Callable[[str, int], AbstractContextManager[Callable[[Path], None]]]
"""Shows a bar over so many photos while its block runs."""


def no_progress(text: str, count: int) -> AbstractContextManager[Callable[[Path], None]]:
    """Show nothing."""
    return nullcontext(lambda path: None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How a step ended, and what the person should know of it."""

    status: Literal["done", "kept", "skipped"]  # kept: done before, from the same inputs
    told: tuple[str, ...] = ()


class GoBackError(Exception):
    """The person wants to answer an earlier step again."""

    def __init__(self, step: str):
        super().__init__(step)
        self.step = step


@dataclass(slots=True, kw_only=True)
class Desk:
    """All that the steps share."""

    folder: Path
    asker: Asker
    memory: Memory
    progress: Progress = no_progress
    tell: Callable[[str], None] = lambda text: None
    may_replace: bool = False  # files that the wizard did not write
    takes_doubtful: bool = False  # goes on with a camera that has cautions, unasked
    _allowed: set[Path] = field(default_factory=set)

    @property
    def has_person(self) -> bool:
        """Whether somebody is there to answer."""
        return self.asker.person is not None

    def ask(self, question: Question[T]) -> T:
        """Give the answer of a question; see `Asker.ask`."""
        return self.asker.ask(question)

    def ask_if_needed(self, question: Question[T]) -> T | None:
        """Give the answer of what tells itself mostly: asked only after a failure, or by a flag."""
        name = question.name
        is_needed = self.asker.knows(name) or name in self.asker.refused
        return self.ask(question) if is_needed else None

    def confirm(self, text: str, *, default: bool) -> bool:
        """Ask the person something that is not remembered; `default` where nobody is there."""
        person = self.asker.person
        while person is not None:
            try:
                return yes_or_no((person.answer(f"{text} (yes/no)", "yes" if default else "no"),))
            except ConfigError as error:
                person.tell(f"! {error}")
        return default

    def kept(self, step: str) -> Outcome:
        """Give the outcome of a step that was done before."""
        return Outcome(status="kept", told=self.memory.steps[step].told)

    def done(
        self,
        step: str,
        key: str,
        *,
        told: Sequence[str],
        outputs: Sequence[Path] = (),
    ) -> Outcome:
        """Remember that a step is done, and give its outcome."""
        self.memory.note(step, key, outputs=outputs, told=told)
        return Outcome(status="done", told=tuple(told))

    def check_writable(self, path: Path, *, instead: str = "") -> None:
        """See to it that a file may be written: it is new, the wizard's own, or may be replaced.

        Raises:
            ConfigError: when it is somebody else's and may not; `instead` says how to use it.
        """
        is_free = not path.exists() or self.may_replace or path in self._allowed
        if is_free or self.memory.is_own(path):
            return
        text = f"{path} is there already, and the wizard did not write it"
        if self.confirm(f"{text}; replace it?", default=False):
            self._allowed.add(path)
            return
        either = f", or {instead}" if instead else ""
        raise ConfigError(f"{text}; move it away, add --replace{either}")


def answers_of(desk: Desk, *names: str) -> Mapping[str, tuple[str, ...]]:
    """Give the answers of some questions as they were written, those that there are."""
    return {name: desk.asker.answers[name] for name in names if name in desk.asker.answers}
