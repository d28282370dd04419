"""The wizard's last step: one shot, measured with the rig alone."""

from pathlib import Path

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.memory import key_of
from calibration.wizard.named_files import find_file, split_words
from calibration.wizard.questions import Question, Words
from calibration.wizard.rig_step import rig_path
from toolkit.rig import read_rig
from toolkit.shot import load_shot, measure_shot

STEP = "check"


def _shot(words: Words) -> Path | None:
    return None if words in (("none",), ("",), ()) else find_file(words)


SHOT = Question(
    name="shot",
    flag="--shot F",
    text="A shot with a streak, to try the rig on; none: later",
    parse=_shot,
    default=("none",),
    split=split_words,
    is_path=True,
)


def check_shot(desk: Desk) -> Outcome:
    """Measure one shot as `toolkit measure SHOT` will.

    Raises:
        StreakError: when it cannot be measured with trust; the text says why.
        MismatchError: when it does not fit camera or background.
        ImageError: when it cannot be read.
    """
    shot = desk.ask(SHOT)
    if shot is None:
        return Outcome(status="skipped", told=("no shot was measured yet",))
    rig = rig_path(desk)
    key = key_of({}, [shot, rig, *_files_of(rig)])
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    from toolkit.report import summarise

    measurement = measure_shot(load_shot(shot, rig=rig))
    return desk.done(STEP, key, told=summarise(measurement).splitlines())


def _files_of(rig: Path) -> list[Path]:
    settings = read_rig(rig)
    named = (settings.camera, settings.ball, settings.response)
    return [*(path for path in named if isinstance(path, Path)), *settings.background]
