"""The wizard's third step: the camera from the photos, with a report that shows what is weak."""

from pathlib import Path
from typing import TYPE_CHECKING

from calibration.board import BoardRequest
from calibration.wizard.board_step import BOARD_KIND
from calibration.wizard.desk import Desk, GoBackError, Outcome
from calibration.wizard.memory import key_of
from calibration.wizard.photos import CAMERA_NAME, PHOTOS, known_camera
from calibration.wizard.photos import STEP as PHOTOS_STEP
from calibration.wizard.quantities import parse_length
from calibration.wizard.questions import Question, Words, one_of, optional
from toolkit.camera_file import read_camera

if TYPE_CHECKING:
    from calibration.intrinsics import Calibration
    from calibration.view import View

STEP = "lens"
REPORT_NAME = "calibration.html"


def _board(words: Words) -> tuple[int, int] | None:
    from calibration.cli.calibrate import parse_board

    return optional(parse_board)(words)


BOARD = Question(
    name="board",
    flag="--board CxR",
    text="Inner corners of the board, e.g. 9x6 (of ChArUco: squares); none: the photos tell",
    parse=_board,
    default=("none",),
)
SQUARE = Question(
    name="square",
    flag="--square M",
    text="Side of a square, e.g. 25 mm; none: not known, nor needed for a measurement",
    parse=optional(parse_length),
    default=("none",),
)
MODEL = Question(
    name="model",
    flag="--model auto|pinhole|rational|fisheye",
    text="The lens: auto, pinhole, rational or fisheye",
    parse=one_of("auto", "pinhole", "rational", "fisheye"),
    default=("auto",),
)


def calibrate_lens(desk: Desk) -> Outcome:
    """Calibrate from the photos, or read the camera file that is used instead.

    Raises:
        CalibrationError: when the photos do not tell the lens well; the text says what to add.
        ImageError: when none can be read.
        ConfigError: when camera.toml is somebody else's.
    """
    camera = known_camera(desk)
    if camera is not None:
        lens = read_camera(camera)
        known = f"{lens.width}x{lens.height} px, {lens.model}, fx {lens.fx:.1f} px"
        return Outcome(status="skipped", told=(known,))
    from calibration.intrinsics import write_calibration
    from calibration.report.collect import write_report

    photos, square = desk.ask(PHOTOS), desk.ask_if_needed(SQUARE)
    size, kind = desk.ask_if_needed(BOARD), desk.ask_if_needed(BOARD_KIND)
    model = desk.ask_if_needed(MODEL) or "auto"
    key = key_of({"board": size, "kind": kind, "square": square, "model": model}, photos)
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    out, page = desk.folder / CAMERA_NAME, desk.folder / REPORT_NAME
    desk.check_writable(out, instead=f"use it: --camera {out}")
    desk.check_writable(page)
    request = BoardRequest(kind=kind, size=size, square_m=square)
    result = _calibrate(desk, photos, request, model)
    write_calibration(out, result)
    write_report(page, result, square=square)
    told = [*_told(result), f"wrote {out}, and {page} to look at in a browser"]
    outcome = desk.done(STEP, key, told=told, outputs=(out, page))
    _offer_more_photos(desk, result, outcome)
    return outcome


def camera_path(desk: Desk) -> Path:
    """Give the camera file, once it is there."""
    return known_camera(desk) or desk.folder / CAMERA_NAME


def _calibrate(
    desk: Desk, photos: tuple[Path, ...], request: BoardRequest, model: str
) -> "Calibration":
    from calibration.corners import search_boards
    from calibration.intrinsics import calibrate_views, check_request

    check_request(photos, request.size, request.square_m, model)
    with desk.progress("reading photos", len(photos)) as on_photo:
        found = search_boards(photos, board=request, on_photo=on_photo)
    return calibrate_views(
        found.views, square=request.square_m, model=model, cautions=found.cautions
    )


def _told(result: "Calibration") -> list[str]:
    """Say how good the camera is, which photos were left out and why, and what would help."""
    left_out = [view for view in result.views if not view.is_used]
    camera = result.camera
    advice = [f"it would help: {result.advice_text}"] if result.advice else []
    return [
        f"{len(result.used)} of {len(result.views)} photos used, {camera.model}, fx {camera.fx:.1f}"
        f" px, the corners within {result.rms_px:.2f} px (RMS)",
        *(f"left out: {_named(view)}" for view in left_out),
        *(f"caution: {caution.message}" for caution in result.warnings),
        *advice,
    ]


def _named(view: "View") -> str:
    """Name a photo with its reason, where that does not name it."""
    name = str(view.path)
    return view.reason if view.reason.startswith(name) else f"{name}: {view.reason}"


def _offer_more_photos(desk: Desk, result: "Calibration", outcome: Outcome) -> None:
    """Let the person add photos where the camera is good enough, but could be surer."""
    if not result.warnings or desk.takes_doubtful or not desk.has_person:
        return
    for line in outcome.told:
        desk.tell(f"  {line}")
    if desk.confirm("Go on with this camera? no: take or name more photos", default=True):
        return
    desk.asker.refuse(PHOTOS.name)
    raise GoBackError(PHOTOS_STEP)
