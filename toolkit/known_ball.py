"""What is known about the ball of a shot: by the caller, the rig, or a ball.toml."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from toolkit.ball_file import BallFile, read_ball
from toolkit.errors import ImageError, ToolkitError
from toolkit.rig import Rig

if TYPE_CHECKING:
    from toolkit.ball import SharpBall
    from toolkit.ball_colours import BallColours
    from toolkit.disc import BallView

LEARNT = ("plane_normal", "colour")
"""Fields that a sharp picture fills where nobody names a colour."""
NO_PLANE = {
    "line": "shows one colour and its shades, or black and white; use uniform or known-shading",
    "solid": "shows more than two colours, or gloss; use known-shading",
}
"""Why a ball has no two pigments that could be told, by the kind of its colours."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownBall:
    """What is known about a ball; its sharp picture is looked at when it is asked for."""

    radius: float | None  # metre
    radius_std: float | None  # metre, of that radius; None where nobody tells it
    numbers: Mapping[str, object]  # by the names that estimators use for their fields
    look: "Callable[[], SharpBall] | None"  # reads the sharp picture
    learn: "Callable[[], BallColours] | None"  # learns colours from it that nobody has named
    pictures: tuple[Path, ...]  # that `look` reads
    file: Path | None  # the ball.toml
    kind: str | None  # what it says of the colours

    @property
    def names(self) -> frozenset[str]:
        """Names of all that `facts` can give."""
        return frozenset(self.numbers) | ({"ball"} if self.look else frozenset())

    def facts(self, fields: Collection[str]) -> dict[str, object]:
        """Say what is known about those fields of an estimator.

        Raises:
            CalibrationError: when the sharp picture shows no disc that can be used.
            ImageError: when a picture cannot be read.
            MismatchError: when the pictures do not belong together.
        """
        known = {name: value for name, value in self.numbers.items() if name in fields}
        if self.look and "ball" in fields:
            known["ball"] = self.look()
        if self._is_learnt(fields) and self.learn:
            seen = self.learn()
            learnt = {"plane_normal": seen.normal, "colour": _only(seen)}
            known |= {name: learnt[name] for name in LEARNT if name in fields and learnt[name]}
        return known

    def files(self, fields: Collection[str]) -> tuple[Path, ...]:
        """List what is read for those fields."""
        own = () if self.file is None else (self.file,)
        is_seen = "ball" in fields or self._is_learnt(fields)
        return (*own, *(self.pictures if is_seen else ()))

    def lacks_plane(self, fields: Collection[str]) -> str | None:
        """Say why the ball gives no plane of two pigments to a field that asks for one, if so."""
        colours = self.numbers.get("colours", ())
        is_told = "plane_normal" in self.numbers or (isinstance(colours, tuple) and colours[1:])
        if "plane_normal" not in fields or is_told:
            return None
        source, kind = self.file, self.kind
        if self._is_learnt(fields) and self.learn:
            source, kind = self.pictures[0], self.learn().kind
        return f"{source} {NO_PLANE[kind]}" if kind in NO_PLANE else None

    def _is_learnt(self, fields: Collection[str]) -> bool:
        is_named = any(name in self.numbers for name in (*LEARNT, "colours"))
        return self.learn is not None and not is_named and any(name in fields for name in LEARNT)


def know_ball(settings: Rig) -> KnownBall:
    """Gather what settings and their ball file say; the settings' own numbers beat the file's.

    Raises:
        ConfigError: when the ball file is missing or damaged.
        ImageError: when there is no such sharp picture.
    """
    ball = BallFile() if settings.ball is None else read_ball(settings.ball)
    numbers: dict[str, object] = {}
    if settings.ball_colours or ball.colours:
        numbers["colours"] = settings.ball_colours or ball.colours
    if len(settings.ball_colours or ball.colours) == 1:
        numbers["colour"] = (settings.ball_colours or ball.colours)[0]
    # two colours named by hand span a plane of their own
    if ball.plane_normal is not None and len(settings.ball_colours) < 2:
        numbers["plane_normal"] = ball.plane_normal
    picture = settings.ball_image
    if picture is not None and not picture.exists():  # even where nobody will look at it
        raise ImageError(f"{picture} does not exist; give the path of a sharp picture of the ball")
    view = None if picture is None else cache(partial(view_picture, picture, settings))
    # a standard deviation belongs to its own radius
    is_own = settings.ball_radius is not None or settings.ball_radius_std is not None
    return KnownBall(
        radius=ball.radius if settings.ball_radius is None else settings.ball_radius,
        radius_std=settings.ball_radius_std if is_own else ball.radius_std,
        numbers=numbers,
        look=_looking(view, ball, settings.ball),
        learn=None if view is None else partial(_learn, view),
        pictures=_pictures(settings, ball),
        file=settings.ball,
        kind=ball.kind,
    )


def _looking(
    view: "Callable[[], BallView] | None", ball: BallFile, file: Path | None
) -> "Callable[[], SharpBall] | None":
    if view is not None:
        return partial(_lay_out, view)
    return None if ball.sharp is None else partial(_look_again, ball, file)


def _look_again(ball: BallFile, file: Path | None) -> "SharpBall":
    """Look at the pictures that a ball file names; an error names the file too."""
    try:
        return ball.look()
    except ToolkitError as error:
        raise type(error)(f"{file}: {error}") from None


def _lay_out(view: "Callable[[], BallView]") -> "SharpBall":
    from toolkit.ball_look import lay_out

    return lay_out(view())


def _learn(view: "Callable[[], BallView]") -> "BallColours":
    from toolkit.ball_colours import learn_colours

    return learn_colours([view()])


def _only(seen: "BallColours") -> tuple[float, ...] | None:
    """Give the colour of a ball that has but one."""
    return seen.mean if seen.kind == "line" else None


def _pictures(settings: Rig, ball: BallFile) -> tuple[Path, ...]:
    if settings.ball_image is not None:
        return (settings.ball_image,)
    return ball.files


def view_picture(image: Path, settings: Rig) -> "BallView":
    """Read a sharp picture of the ball over the background of the shot, and find the ball.

    Raises:
        CalibrationError: naming the picture, when it shows no disc that can be used.
        ImageError: when a picture cannot be read.
        MismatchError: when the pictures do not belong together.
    """
    from toolkit.disc import view_ball
    from toolkit.imaging import read_background, read_image

    seen = read_image(image, response=settings.response)
    empty = read_background(settings.background, response=settings.response)
    try:
        return view_ball(seen, empty)
    except ToolkitError as error:
        raise type(error)(f"{image}: {error}") from None
