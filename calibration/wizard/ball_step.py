"""The wizard's sixth step: the ball's radius and, where there is one, sharp pictures of it."""

from pathlib import Path
from typing import TYPE_CHECKING

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.light import response_of
from calibration.wizard.memory import key_of
from calibration.wizard.named_files import find_pictures, split_words
from calibration.wizard.quantities import parse_length, parse_radius
from calibration.wizard.questions import Question, Words, one_of, optional
from calibration.wizard.scene import BACKGROUND
from toolkit.candidates import AUTO
from toolkit.errors import ConfigError

if TYPE_CHECKING:
    from toolkit.learn_ball import LearntBall, Told

STEP = "ball"
BALL_NAME = "ball.toml"
COLOURS = {
    "plane": "two pigments and their shades",
    "line": "one and its shades, or black and white",
    "solid": "more than two, or gloss",
}
"""In words, by the kind of `BallColours`."""
HOW_TO = (
    "Sharp pictures of the resting ball help where it is not of one colour, or unevenly lit. Take",
    "them in the light of the shots, before the same background, the whole ball in view.",
)


def _radius(words: Words) -> float:
    return parse_radius(" ".join(words))


def _pictures(words: Words) -> tuple[Path, ...]:
    return () if words in (("none",), ("",), ()) else find_pictures(words)


RADIUS = Question(
    name="radius",
    flag="--radius METRES",
    text="The ball's radius, half its diameter, e.g. 0.036 or 36 mm",
    parse=_radius,
)
RADIUS_STD = Question(
    name="radius_std",
    flag="--radius-std METRES",
    text="How sure is that: its standard deviation, e.g. 0.2 mm; none: not known",
    parse=optional(parse_length),
    default=("none",),
)
SHARP = Question(
    name="ball_image",
    flag="--ball-image F...",
    text="Sharp pictures of the resting ball; none: there are none",
    parse=_pictures,
    default=("none",),
    split=split_words,
    is_path=True,
)
KINDS = ("plain", "shaded", "two-colour", "unsure")
ESTIMATORS = {"plain": "uniform", "shaded": "known-shading", "two-colour": "two-colour"}
KIND = Question(
    name="kind_of_ball",
    flag="--kind-of-ball " + "|".join(KINDS),
    text="The ball: plain (one colour, evenly lit), shaded, two-colour, or unsure",
    parse=one_of(*KINDS),
    default=("unsure",),
)


def learn_ball(desk: Desk) -> Outcome:
    """Ask for the radius, and learn the ball's looks from sharp pictures into ball.toml.

    Raises:
        ConfigError: when nobody tells the radius, or ball.toml is somebody else's.
        CalibrationError: when no sharp picture shows a ball that can be used.
        ImageError: when a picture cannot be read.
    """
    radius, std = desk.ask(RADIUS), desk.ask(RADIUS_STD) or None
    if std is not None and std >= radius:
        raise ConfigError(f"a radius of {radius:g} m cannot be unsure by {std:g} m; give it again")
    if not desk.asker.knows(SHARP.name):
        for line in HOW_TO:
            desk.tell(line)
    sharp = desk.ask(SHARP)
    told = [f"radius {1000 * radius:g} mm" + (f" +/- {1000 * std:g} mm" if std else "")]
    if sharp:
        from toolkit.learn_ball import Told

        return _learn_looks(desk, sharp, Told(radius=radius, radius_std=std), told)
    key = key_of({"radius": radius, "std": std})
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    return desk.done(STEP, key, told=told)


def has_looks(desk: Desk) -> bool:
    """Whether ball.toml was made from sharp pictures."""
    return desk.asker.knows(SHARP.name) and bool(desk.ask(SHARP))


def estimator_of(desk: Desk) -> str | None:
    """Give the estimator that suits the ball; None leaves the choice to `measure`."""
    if not has_looks(desk):
        return None
    return ESTIMATORS.get(desk.ask(KIND), AUTO)


def _learn_looks(desk: Desk, sharp: tuple[Path, ...], known: "Told", told: list[str]) -> Outcome:
    pictures, response, kind = desk.ask(BACKGROUND), response_of(desk), desk.ask(KIND)
    curve = Path(response) if response and Path(response).is_file() else None
    answers = {"radius": known.radius, "std": known.radius_std, "response": response, "kind": kind}
    key = key_of(answers, [*sharp, *pictures, *([curve] if curve else [])])
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    from toolkit.ball_file import write_ball
    from toolkit.learn_ball import learn_ball

    out = desk.folder / BALL_NAME
    desk.check_writable(out)
    with desk.progress("looking at pictures", len(sharp)) as on_picture:
        learnt = learn_ball(
            sharp, pictures, told=known, response=curve or response, on_picture=on_picture
        )
    _check_kind(kind, learnt)
    write_ball(out, learnt.file)
    return desk.done(STEP, key, told=[*told, *_seen(learnt)], outputs=(out,))


def _check_kind(kind: str, learnt: "LearntBall") -> None:
    """Refuse two colours where the pictures show none, before every shot fails for it."""
    seen = learnt.together.colours.kind
    if kind == "two-colour" and seen != "plane":
        raise ConfigError(
            f"the ball is said to have two colours, but its pictures show {COLOURS[seen]}; answer"
            " shaded or unsure (--kind-of-ball)"
        )


def _seen(learnt: "LearntBall") -> list[str]:
    """Say in how many pictures the ball was found, its colours, and what was left out."""
    colours, count = learnt.together.colours, len(learnt.pictures)
    return [
        f"found in {count} sharp picture{'s'[: count > 1]}, its colours {COLOURS[colours.kind]}",
        *(f"left out of {one.of}: {one.path}: {one.reason}" for one in learnt.left_out),
        *(f"caution: {caution}" for caution in learnt.cautions),
    ]
