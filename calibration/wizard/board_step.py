"""The wizard's first step: a board to photograph, printed where there is none."""

from typing import Literal

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.memory import key_of
from calibration.wizard.photos import PHOTOS, known_camera
from calibration.wizard.questions import Question, Words, one_of, yes_or_no

STEP = "board"
BOARD_NAME = "board.pdf"
SIZES = {"checker": (9, 6), "charuco": (6, 4)}
"""Inner corners that fit any of the papers well."""
PAPERS = ("a4", "letter", "a3")

BoardKind = Literal["checker", "charuco"]


def _kind(words: Words) -> BoardKind:
    return "charuco" if one_of("checker", "charuco")(words) == "charuco" else "checker"


MAKE = Question(
    name="make_board",
    flag="--make-board",
    text="Write a board to print? yes, or no: there is one (yes/no)",
    parse=yes_or_no,
    default=("no",),
)
BOARD_KIND = Question(
    name="board_kind",
    flag="--kind checker|charuco",
    text="Its kind: checker, or charuco, of which a part in view is enough",
    parse=_kind,
    default=("checker",),
)
PAPER = Question(
    name="paper",
    flag="--paper a4|letter|a3",
    text="The paper: a4, letter or a3",
    parse=one_of(*PAPERS),
    default=("a4",),
)


def make_board(desk: Desk) -> Outcome:
    """Write a board to print, where there is neither one nor photos of one.

    Raises:
        ConfigError: when board.pdf is somebody else's.
        EnvironmentFault: when it cannot be written.
    """
    asker = desk.asker
    if not asker.knows(MAKE.name) and (asker.knows(PHOTOS.name) or known_camera(desk) is not None):
        return Outcome(status="skipped", told=("there are photos of one, or a camera file",))
    if not desk.ask(MAKE):
        return Outcome(status="skipped", told=("there is one",))
    kind, paper = desk.ask(BOARD_KIND), desk.ask(PAPER)
    key = key_of({"kind": kind, "paper": paper})
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    from calibration.board import Board
    from calibration.board_page import write_board

    out = desk.folder / BOARD_NAME
    desk.check_writable(out)
    columns, rows = SIZES[kind]
    made = write_board(out, Board(kind=kind, columns=columns, rows=rows), paper=paper)
    told = (
        f"wrote {out}: {made}, squares of {1000 * (made.square_m or 0):g} mm, on {paper}",
        "print it at 100 %, hold a ruler against its 100 mm bar, and glue it on something flat",
    )
    return desk.done(STEP, key, told=told, outputs=(out,))
