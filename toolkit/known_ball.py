"""What is known about the ball of a shot: by the caller, the rig, or a ball.toml."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from toolkit.ball_file import BallFile, read_ball
from toolkit.errors import ToolkitError
from toolkit.rig import Rig

if TYPE_CHECKING:
    from toolkit.ball import SharpBall


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownBall:
    """What is known about a ball; its sharp picture is looked at when it is asked for."""

    radius: float | None  # metre
    numbers: Mapping[str, object]  # by the names that estimators use for their fields
    look: "Callable[[], SharpBall] | None"  # reads the sharp picture
    pictures: tuple[Path, ...]  # that `look` reads
    file: Path | None  # the ball.toml

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
        return known | ({"ball": self.look()} if self.look and "ball" in fields else {})

    def files(self, fields: Collection[str]) -> tuple[Path, ...]:
        """List what is read for those fields."""
        own = () if self.file is None else (self.file,)
        return (*own, *(self.pictures if "ball" in fields else ()))


def know_ball(settings: Rig) -> KnownBall:
    """Gather what settings and their ball file say; the settings' own numbers beat the file's.

    Raises:
        ConfigError: when the ball file is missing or damaged.
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
    source = _source(settings, ball)
    return KnownBall(
        radius=ball.radius if settings.ball_radius is None else settings.ball_radius,
        numbers=numbers,
        look=source,
        pictures=_pictures(settings, ball),
        file=settings.ball,
    )


def _source(settings: Rig, ball: BallFile) -> "Callable[[], SharpBall] | None":
    image = settings.ball_image
    if image is not None:
        return lambda: look_at_picture(image, settings)
    return None if ball.sharp is None else ball.sharp.look


def _pictures(settings: Rig, ball: BallFile) -> tuple[Path, ...]:
    if settings.ball_image is not None:
        return (settings.ball_image,)
    return () if ball.sharp is None else ball.sharp.files


def look_at_picture(image: Path, settings: Rig) -> "SharpBall":
    """Read a sharp picture of the ball over the background of the shot, and look at it.

    Raises:
        CalibrationError: naming the picture, when it shows no disc that can be used.
        ImageError: when a picture cannot be read.
        MismatchError: when the pictures do not belong together.
    """
    from toolkit.ball_look import look_at_ball
    from toolkit.imaging import read_background, read_image

    seen = read_image(image, response=settings.response)
    empty = read_background(settings.background, response=settings.response)
    try:
        return look_at_ball(seen, empty)
    except ToolkitError as error:
        raise type(error)(f"{image}: {error}") from None
