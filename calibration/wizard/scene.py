"""The wizard's fifth step: pictures of the scene without the ball, and the time of exposure."""

from pathlib import Path
from typing import TYPE_CHECKING

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.light import response_of
from calibration.wizard.memory import key_of
from calibration.wizard.named_files import find_pictures, split_words
from calibration.wizard.quantities import parse_time
from calibration.wizard.questions import Question, optional
from toolkit.errors import MismatchError

if TYPE_CHECKING:
    from toolkit.types import LinearImage

STEP = "background"
HOW_TO = (
    "Take some pictures of the scene without the ball, from the tripod of the shots, with the same",
    "settings and in the same light; several of them lower the noise.",
)

BACKGROUND = Question(
    name="background",
    flag="--background F...",
    text="Pictures without the ball (a folder, a pattern, or names)",
    parse=find_pictures,
    split=split_words,
    is_path=True,
)
EXPOSURE = Question(
    name="exposure",
    flag="--exposure SECONDS",
    text="Exposure time of the shots, e.g. 1/100; none: unknown, and no speed is measured",
    parse=optional(parse_time),
    default=("none",),
)
READOUT = Question(
    name="readout",
    flag="--readout SECONDS",
    text="Rolling shutter: time from the first row to the last, e.g. 20 ms; 0: none, or unknown",
    parse=optional(parse_time),
    default=("0",),
)


def choose_background(desk: Desk) -> Outcome:
    """Read the background as a measurement will, and hold it against the camera.

    Raises:
        ConfigError: when nobody says which pictures.
        ImageError: when one cannot be read.
        MismatchError: when they differ among themselves, or do not fit the camera.
    """
    from calibration.wizard.lens import camera_path

    if not desk.asker.knows(BACKGROUND.name):
        for line in HOW_TO:
            desk.tell(line)
    pictures, camera = desk.ask(BACKGROUND), camera_path(desk)
    response = response_of(desk)
    curve = [Path(response)] if response and Path(response).is_file() else []
    files = [*pictures, camera, *curve]
    if desk.memory.is_done(STEP, key_of(_answers(desk), files)):
        return desk.kept(STEP)
    background = _read(pictures, camera, response)
    count = "1 picture" if len(pictures) == 1 else f"{len(pictures)} pictures"
    told = [f"{count} of {background.width}x{background.height} px", _exposure(desk, background)]
    desk.ask(READOUT)
    return desk.done(STEP, key_of(_answers(desk), files), told=told)


def _answers(desk: Desk) -> dict[str, object]:
    """What was answered so far; whether the exposure time is asked, the files decide."""
    times = {q.name: desk.asker.answers.get(q.name) for q in (EXPOSURE, READOUT)}
    return {"response": response_of(desk), **times}


def _exposure(desk: Desk, background: "LinearImage") -> str:
    """Ask for the exposure time where the files do not tell it, and say what is known."""
    if background.exposure is not None:
        return f"the files tell the exposure time: {float(background.exposure[0]):.4g} s"
    seconds = desk.ask(EXPOSURE)
    if seconds is None:
        return "the exposure time is not known: no speed will be measured; --exposure SECONDS"
    return f"exposure time {seconds:.4g} s"


def _read(pictures: tuple[Path, ...], camera: Path, response: str | None) -> "LinearImage":
    from toolkit.camera_file import fit_camera, read_camera
    from toolkit.imaging import read_background

    background = read_background(pictures, response=response)
    try:
        fit_camera(read_camera(camera), background)
    except MismatchError as error:
        raise MismatchError(f"{pictures[0]} does not fit {camera}: {error}") from None
    return background
