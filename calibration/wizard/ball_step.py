"""The wizard's sixth step: the ball's radius and, where there is one, a sharp picture of it."""

from pathlib import Path

from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.memory import key_of
from calibration.wizard.named_files import find_file, split_words
from calibration.wizard.quantities import parse_length, parse_radius
from calibration.wizard.questions import Question, Words, one_of, optional
from calibration.wizard.scene import BACKGROUND, response_of
from toolkit.candidates import AUTO
from toolkit.errors import ConfigError

STEP = "ball"
BALL_NAME = "ball.toml"
HOW_TO = (
    "A sharp picture of the resting ball helps where it is not of one colour, or unevenly lit: in",
    "the light of the shots, before the same background, the whole of it in view.",
)


def _radius(words: Words) -> float:
    return parse_radius(" ".join(words))


def _picture(words: Words) -> Path | None:
    return None if words in (("none",), ("",), ()) else find_file(words)


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
    flag="--ball-image F",
    text="A sharp picture of the resting ball; none: there is none",
    parse=_picture,
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
    """Ask for the radius, and learn the ball's looks from a sharp picture into ball.toml.

    Raises:
        ConfigError: when nobody tells the radius, or ball.toml is somebody else's.
        CalibrationError: when the sharp picture shows no ball that can be used.
        ImageError: when it cannot be read.
    """
    radius, std = desk.ask(RADIUS), desk.ask(RADIUS_STD)
    if std is not None and std >= radius:
        raise ConfigError(f"a radius of {radius:g} m cannot be unsure by {std:g} m; give it again")
    if not desk.asker.knows(SHARP.name):
        for line in HOW_TO:
            desk.tell(line)
    sharp = desk.ask(SHARP)
    told = [f"radius {1000 * radius:g} mm" + (f" +/- {1000 * std:g} mm" if std else "")]
    if sharp is None:
        key = key_of({"radius": radius, "std": std})
        return (
            desk.kept(STEP) if desk.memory.is_done(STEP, key) else desk.done(STEP, key, told=told)
        )
    desk.ask(KIND)
    return _learn_looks(desk, sharp, radius, std, told)


def has_looks(desk: Desk) -> bool:
    """Whether ball.toml was made from a sharp picture."""
    return desk.asker.knows(SHARP.name) and desk.ask(SHARP) is not None


def estimator_of(desk: Desk) -> str | None:
    """Give the estimator that suits the ball; None leaves the choice to `measure`."""
    if not has_looks(desk):
        return None
    return ESTIMATORS.get(desk.ask(KIND), AUTO)


def _learn_looks(
    desk: Desk, sharp: Path, radius: float, std: float | None, told: list[str]
) -> Outcome:
    pictures, response = desk.ask(BACKGROUND), response_of(desk)
    curve = Path(response) if response and Path(response).is_file() else None
    answers = {"radius": radius, "std": std, "response": response, "kind": desk.ask(KIND)}
    key = key_of(answers, [sharp, *pictures, *([curve] if curve else [])])
    if desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    out = desk.folder / BALL_NAME
    desk.check_writable(out)
    told += _write_ball(out, sharp, pictures, curve or response, radius)
    return desk.done(STEP, key, told=told, outputs=(out,))


def _write_ball(
    out: Path, sharp: Path, pictures: tuple[Path, ...], response: str | Path | None, radius: float
) -> list[str]:
    """Find the ball, write ball.toml, and say what was seen."""
    from toolkit.ball_colours import learn_colours
    from toolkit.ball_file import BallFile, SharpSource, write_ball
    from toolkit.disc import view_ball
    from toolkit.imaging import read_background, read_image

    view = view_ball(
        read_image(sharp, response=response), read_background(pictures, response=response)
    )
    colours, disc = learn_colours([view]), view.picture_disc
    ball = BallFile(
        radius=radius,
        kind=colours.kind,
        colours=colours.pigments,
        plane_normal=colours.normal,
        plane_normal_std=colours.normal_std,
        sharp=SharpSource(image=sharp, background=pictures, disc=disc, response=response),
    )
    write_ball(out, ball)
    (x, y), (longer, shorter) = disc.centre, disc.semi_axes
    return [
        f"found at ({x:.0f}, {y:.0f}) px, {longer + shorter:.0f} px wide; its colours: "
        f"{len(colours.pigments)} ({colours.kind})"
    ]
