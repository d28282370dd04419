"""The wizard itself: one step after the other, each done once, the failing one asked again."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from calibration.wizard.ball_step import KIND, RADIUS, RADIUS_STD, SHARP, learn_ball
from calibration.wizard.board_step import BOARD_KIND, MAKE, PAPER, make_board
from calibration.wizard.check_shot import SHOT, check_shot
from calibration.wizard.desk import Desk, GoBackError, Outcome
from calibration.wizard.lens import BOARD, MODEL, SQUARE, calibrate_lens
from calibration.wizard.light import BRACKET, RESPONSE, TIMES, choose_response
from calibration.wizard.photos import CAMERA, CAMERA_NAME, PHOTOS, choose_photos
from calibration.wizard.questions import Question
from calibration.wizard.rig_step import write_rig
from calibration.wizard.scene import BACKGROUND, EXPOSURE, READOUT, choose_background
from toolkit.errors import ConfigError, EnvironmentFault, ToolkitError


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step: what does it, and what is asked again when it fails."""

    name: str
    title: str
    run: Callable[[Desk], Outcome]
    asks: tuple[Question[Any], ...] = ()  # again, those that were answered
    then: tuple[Question[Any], ...] = ()  # only after a failure, or by a flag
    back_to: str = ""  # an earlier step that has to be done again first


STEPS = (
    Step(
        name="board", title="A board to photograph", run=make_board, asks=(MAKE, BOARD_KIND, PAPER)
    ),
    Step(name="photos", title="Photos of the board", run=choose_photos, asks=(PHOTOS, CAMERA)),
    Step(
        name="lens",
        title="The camera's lens",
        run=calibrate_lens,
        asks=(PHOTOS, CAMERA, SQUARE, MODEL),
        then=(BOARD,),
        back_to="photos",
    ),
    Step(
        name="response",
        title="From brightness to light",
        run=choose_response,
        asks=(RESPONSE, BRACKET),
        then=(TIMES,),
    ),
    Step(
        name="background",
        title="The scene without the ball",
        run=choose_background,
        asks=(BACKGROUND, EXPOSURE, READOUT),
    ),
    Step(
        name="ball",
        title="The ball",
        run=learn_ball,
        asks=(RADIUS, RADIUS_STD, SHARP, KIND),
    ),
    Step(name="rig", title="What a measurement reads", run=write_rig),
    Step(name="check", title="A check shot", run=check_shot, asks=(SHOT,)),
)
NAMES = tuple(step.name for step in STEPS)


def run_wizard(
    desk: Desk, *, on_outcome: Callable[[Step, Outcome], None] = lambda step, outcome: None
) -> dict[str, Outcome]:
    """Lead through all steps.

    A step whose answers and files are as they were is not done again. Where somebody is there, a
    step that fails is explained and asked again; else its error ends the run, and what was done
    before stays.

    Args:
        desk: folder, answers and memory.
        on_outcome: called after each step.

    Returns:
        How each step ended, by its name.

    Raises:
        ConfigError: when nobody is there and answers are missing; all their flags are named.
        ToolkitError: of a step that failed, when nobody is there.
    """
    _check_flags(desk)
    if not desk.has_person:
        check_nothing_missing(desk)
    outcomes: dict[str, Outcome] = {}
    number = 0
    while number < len(STEPS):
        step = STEPS[number]
        desk.tell(f"[{number + 1}/{len(STEPS)}] {step.title}")
        try:
            outcomes[step.name] = step.run(desk)
        except GoBackError as wish:
            number = NAMES.index(wish.step)
            continue
        except ToolkitError as error:
            if not _can_be_mended(desk, step, error):
                raise
            number = NAMES.index(step.back_to or step.name)
            continue
        answered = [question.name for question in (*step.asks, *step.then)]
        desk.memory.keep_answers(answered, desk.asker.answers)
        on_outcome(step, outcomes[step.name])
        number += 1
    return outcomes


def check_nothing_missing(desk: Desk) -> None:
    """Raise `ConfigError` that names every flag without which the steps cannot be done."""
    asker = desk.asker
    has_camera = (
        asker.knows(PHOTOS.name) or asker.knows(CAMERA.name) or (desk.folder / CAMERA_NAME).exists()
    )
    missing = [
        *([] if has_camera else [f"photos of a board: {PHOTOS.flag} (or {CAMERA.flag})"]),
        *([] if asker.knows(BACKGROUND.name) else [f"the empty scene: {BACKGROUND.flag}"]),
        *([] if asker.knows(RADIUS.name) else [f"the ball's radius: {RADIUS.flag}"]),
    ]
    if missing:
        raise ConfigError(
            f"nobody is at a terminal to answer, and these are missing: {'; and '.join(missing)}"
        )


def _check_flags(desk: Desk) -> None:
    """Raise `ConfigError` for a flag that cannot be read, before any work is done."""
    for question in (q for step in STEPS for q in (*step.asks, *step.then)):
        if question.name in desk.asker.given:
            desk.ask(question)


def _can_be_mended(desk: Desk, step: Step, error: ToolkitError) -> bool:
    """Explain a failure to the person, and have the step's questions asked again."""
    person = desk.asker.person
    is_ours = isinstance(error, EnvironmentFault) or error.exit_code == 70
    if person is None or is_ours or not step.asks:
        return False
    person.tell(f"! {error}")
    person.tell("  Answer again, or stop with Ctrl-C: what is done is kept.")
    asker = desk.asker
    asker.refuse(*(q.name for q in step.asks if asker.knows(q.name)), *(q.name for q in step.then))
    return True
