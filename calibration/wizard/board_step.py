"""The wizard's first step: a board to photograph, printed where there is none."""

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.photos import PHOTOS, known_camera
from calibration.wizard.questions import Question, yes_or_no

STEP = "board"

MAKE = Question(
    name="make_board",
    flag="--make-board",
    text="Write a board to print? yes, or no: there is one (yes/no)",
    parse=yes_or_no,
    default=("no",),
)


def make_board(desk: Desk) -> Outcome:
    """Write a board to print, where there is neither one nor photos of one."""
    if not desk.asker.knows(MAKE.name) and (
        desk.asker.knows(PHOTOS.name) or known_camera(desk) is not None
    ):
        return Outcome(status="skipped", told=("there are photos of one, or a camera file",))
    if not desk.ask(MAKE):
        return Outcome(status="skipped", told=("there is one",))
    return Outcome(status="skipped", told=("write one with `toolkit board`",))
