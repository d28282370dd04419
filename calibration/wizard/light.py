"""The wizard's fourth step: how stored brightness becomes light."""

from pathlib import Path

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.memory import key_of
from calibration.wizard.named_files import split_words
from calibration.wizard.photos import PHOTOS
from calibration.wizard.questions import Question, Words
from calibration.wizard.scene import BACKGROUND
from toolkit.errors import ConfigError, ImageError
from toolkit.imaging.kinds import kind_of

STEP = "response"
UNKNOWN = "unknown"
LINEAR = "linear"


def _spec(words: Words) -> str:
    """Check that a response is "unknown", a known curve, or a file that can be read."""
    from toolkit.response import load_response

    text = " ".join(words).strip()
    if text.lower() == UNKNOWN:
        return UNKNOWN
    if not text:
        raise ConfigError("no response was named; unknown is an answer too")
    load_response(text)
    return text


RESPONSE = Question(
    name="response",
    flag="--response linear|srgb|NAME|F|unknown",
    text="Response: linear (RAW), srgb, the name of a log curve, a response.toml, or unknown",
    parse=_spec,
    default=(UNKNOWN,),
    split=split_words,
    is_path=True,
)


def choose_response(desk: Desk) -> Outcome:
    """Settle the response: RAW is linear; else it is named, read, or left open.

    Raises:
        ConfigError: when it is no known curve and no file.
    """
    if not desk.asker.knows(RESPONSE.name) and _is_raw(desk):
        desk.asker.answers[RESPONSE.name] = (LINEAR,)
    spec = desk.ask(RESPONSE)
    key = key_of({"response": spec}, [Path(spec)])
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    return desk.done(STEP, key, told=[_told(spec)])


def _is_raw(desk: Desk) -> bool:
    """Whether the pictures named so far are RAW, all of them."""
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
            " measure it from a series of exposures with `toolkit response`"
        )
    return spec
