"""The wizard's second step: which photos of the board there are, or a camera file instead."""

from pathlib import Path

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.memory import fingerprint, key_of
from calibration.wizard.named_files import find_file, find_pictures, split_words
from calibration.wizard.questions import Question
from toolkit.errors import CalibrationError, ImageError
from toolkit.imaging.kinds import kind_of

STEP = "photos"
CAMERA_NAME = "camera.toml"
FEWEST = 3
HOW_TO = (
    "Take 10 to 20 photos of the board with the camera of the shots: same zoom, same focus, same",
    "kind of file (RAW where you can). Tilt it by 20 to 45 degrees, left, right, up and down, and",
    "bring it into every corner of the picture. Hold it still: a blurred photo is left out.",
    "To take them first, stop here with Ctrl-C: `toolkit wizard` goes on where you left.",
)

PHOTOS = Question(
    name="images",
    flag="--images PHOTO...",
    text="Photos of the board (a folder, a pattern, or names)",
    parse=find_pictures,
    split=split_words,
    is_path=True,
)
CAMERA = Question(
    name="camera",
    flag="--camera F",
    text="The camera file",
    parse=find_file,
    split=split_words,
    is_path=True,
)


def choose_photos(desk: Desk) -> Outcome:
    """Find the photos, and see that they are pictures, before any work is done on them.

    Raises:
        ConfigError: when nobody says which they are.
        CalibrationError: when there are too few different ones.
        ImageError: when none is a picture.
    """
    camera = known_camera(desk)
    if camera is not None:
        return Outcome(status="skipped", told=(f"{camera} is used; no photos are needed",))
    if not desk.asker.knows(PHOTOS.name):
        for line in HOW_TO:
            desk.tell(line)
    photos = desk.ask(PHOTOS)
    key = key_of({}, photos)
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    return desk.done(STEP, key, told=_look_at(photos))


def known_camera(desk: Desk) -> Path | None:
    """Give the camera file that is used instead of photos; None where photos are to be used.

    A camera.toml that the wizard did not write, lying in its folder, is proposed.
    """
    asker = desk.asker
    if asker.knows(CAMERA.name):
        return desk.ask(CAMERA)
    own = desk.folder / CAMERA_NAME
    if asker.knows(PHOTOS.name) or not own.exists() or desk.memory.is_own(own):
        return None
    if PHOTOS.name in asker.refused:
        return None
    if not desk.confirm(f"{own} is there already; use it?", default=True):
        return None
    asker.answers[CAMERA.name] = (CAMERA_NAME,)
    return own


def _look_at(photos: tuple[Path, ...]) -> list[str]:
    """Say how many photos there are, and which are none."""
    troubles, first_of = [], dict[str, Path]()
    for path in photos:
        digest = fingerprint(path)
        try:
            kind = kind_of(path)
            if kind == "video":
                raise ImageError(f"{path} is a video; save frames of it as PNG")
        except ImageError as error:
            troubles.append(str(error))
            continue
        if digest in first_of:
            troubles.append(f"{path} is the same photo as {first_of[digest]}")
        first_of.setdefault(digest, path)
    if not first_of:
        raise ImageError(f"none of {len(photos)} files is a photo: {troubles[0]}")
    if len(first_of) < FEWEST:
        because = f" ({'; '.join(troubles)})" if troubles else ""
        raise CalibrationError(
            f"{len(first_of)} different photos are too few{because}; take 10 or more, the board"
            " tilted in different directions"
        )
    return [f"{len(first_of)} photos", *(f"left out: {trouble}" for trouble in troubles)]
