"""The wizard's fourth step: how stored brightness becomes light."""

from pathlib import Path
from typing import TYPE_CHECKING

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.memory import key_of
from calibration.wizard.named_files import find_pictures, split_words
from calibration.wizard.photos import PHOTOS
from calibration.wizard.questions import Question, Words, optional
from toolkit.errors import ConfigError, ImageError
from toolkit.imaging.kinds import kind_of

if TYPE_CHECKING:
    from calibration.response_curve import MeasuredResponse

STEP = "response"
RESPONSE_NAME = "response.toml"
UNKNOWN, LINEAR, MEASURE = "unknown", "linear", "bracket"
HOW_TO = (
    "Photos of one still scene that holds dark and bright things, from a tripod, at one aperture",
    "and ISO: five or more exposure times, each about twice the last, from too dark to too bright.",
)


def _spec(words: Words) -> str:
    """Check that a response is a word of ours, a known curve, or a file that can be read."""
    from toolkit.response import load_response

    text = " ".join(words).strip()
    if text.lower() in (UNKNOWN, MEASURE):
        return text.lower()
    if not text:
        raise ConfigError("no response was named; unknown is an answer too")
    load_response(text)
    return text


def _times(words: Words) -> list[float] | None:
    from calibration.cli.response import parse_times

    return optional(parse_times)(words)


RESPONSE = Question(
    name="response",
    flag="--response linear|srgb|NAME|F|unknown",
    text="Response: linear (RAW), srgb, a log curve's name, a response.toml, bracket (measure it "
    "from photos), or unknown",
    parse=_spec,
    default=(UNKNOWN,),
    split=split_words,
    is_path=True,
)


BRACKET = Question(
    name="bracket",
    flag="--bracket PHOTO...",
    text="Photos of one still scene at different exposure times",
    parse=find_pictures,
    split=split_words,
    is_path=True,
)
TIMES = Question(
    name="times",
    flag="--times T1,T2,..",
    text="Their exposure times in seconds, e.g. 1/60,1/30,1/15; none: the files tell",
    parse=_times,
    default=("none",),
)


def choose_response(desk: Desk) -> Outcome:
    """Settle the response: RAW is linear; else it is named, read, measured, or left open.

    Raises:
        ConfigError: when it is no known curve and no file, or response.toml is somebody else's.
        CalibrationError: when a bracket does not determine it; the text says what to add.
    """
    if is_measured(desk):
        return _measure(desk)
    asker = desk.asker
    is_open = not asker.knows(RESPONSE.name) and RESPONSE.name not in asker.refused
    if is_open and _is_raw(desk):
        asker.answers[RESPONSE.name] = (LINEAR,)
    spec = desk.ask(RESPONSE)
    if spec == MEASURE:
        return _measure(desk)
    key = key_of({"response": spec}, [Path(spec)])
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    return desk.done(STEP, key, told=[_told(spec)])


def is_measured(desk: Desk) -> bool:
    """Whether the response is measured from photos."""
    asker = desk.asker
    if BRACKET.name in asker.given:
        return True
    return asker.knows(RESPONSE.name) and desk.ask(RESPONSE) == MEASURE


def response_of(desk: Desk) -> str | None:
    """Give the response as `read_image` takes it; None where it is not known."""
    if is_measured(desk):
        return str(desk.folder / RESPONSE_NAME)
    spec = desk.ask(RESPONSE)
    return None if spec == UNKNOWN else spec


def _measure(desk: Desk) -> Outcome:
    desk.asker.answers[RESPONSE.name] = (MEASURE,)
    if not desk.asker.knows(BRACKET.name):
        for line in HOW_TO:
            desk.tell(line)
    photos, times = desk.ask(BRACKET), desk.ask_if_needed(TIMES)
    key = key_of({"times": times}, photos)
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    from calibration.response_curve import measure_response
    from toolkit.response import write_response

    out = desk.folder / RESPONSE_NAME
    desk.check_writable(out, instead=f"use it: --response {out}")
    with desk.progress("reading photos", len(photos)) as on_photo:
        result = measure_response(photos, times, on_photo=on_photo)
    names = [path.name for path in result.bracket.paths]
    write_response(out, result.curves, {"images": names, "times_s": result.bracket.times.tolist()})
    return desk.done(STEP, key, told=_measured(result), outputs=(out,))


def _measured(result: "MeasuredResponse") -> list[str]:
    bracket = result.bracket
    return [
        f"measured from {len(bracket.paths)} photos, {bracket.times.min():.3g} to "
        f"{bracket.times.max():.3g} s; it departs from linear by {result.bend:.0%} at most",
        *(f"caution: {caution.message}" for caution in result.warnings),
    ]


def _is_raw(desk: Desk) -> bool:
    """Whether the pictures named so far are RAW, all of them."""
    from calibration.wizard.scene import BACKGROUND

    named = [q for q in (PHOTOS, BACKGROUND) if desk.asker.knows(q.name)]
    try:
        return bool(named) and all(kind_of(p) == "raw" for q in named for p in desk.ask(q))
    except (ImageError, ConfigError):  # their own steps say what is wrong with them
        return False


def _told(spec: str) -> str:
    if spec == LINEAR:
        return "linear: stored values are proportional to light, as in RAW"
    if spec == UNKNOWN:
        return (
            "unknown: 8-bit pictures will be taken for sRGB, which can shift results; shoot RAW, or"
            " measure it: toolkit wizard --bracket PHOTO..."
        )
    return spec
