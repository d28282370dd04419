"""From sharp pictures of a resting ball to all that they tell of it together: `toolkit ball`."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

from toolkit.ball import Disc
from toolkit.ball_agreement import (
    ColoursTogether,
    LightTogether,
    learn_colours_together,
    same_light,
)
from toolkit.ball_file import BallFile, SharpSource
from toolkit.ball_size import (
    CONTRADICTION,
    DISTANCE_STD,
    RadiusFound,
    SizeInView,
    find_radius,
    size_in_view,
)
from toolkit.camera import Camera
from toolkit.camera_file import fit_camera, read_camera
from toolkit.disc import BallView, view_ball
from toolkit.errors import CalibrationError, ConfigError, ImageError, MismatchError
from toolkit.files import sha256
from toolkit.imaging import read_background, read_image
from toolkit.shot_checks import RADIUS_LIMITS
from toolkit.types import LinearImage


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """One sharp picture in which the ball was found."""

    path: Path
    background: tuple[Path, ...]
    image: LinearImage
    view: BallView
    distance: float | None  # metre, as somebody told
    size: SizeInView | None = None  # where the camera is known

    @property
    def disc(self) -> Disc:
        """The disc, px of the whole picture."""
        return self.view.picture_disc


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A picture that was not used, and why."""

    path: Path
    of: str  # "all", "radius", "colours" or "shading"
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LearntBall:
    """What sharp pictures tell of a ball."""

    file: BallFile
    pictures: tuple[Picture, ...]
    together: ColoursTogether
    light: LightTogether  # by the place among the pictures whose colours agree
    radius: RadiusFound | None  # where camera and distances are known
    distance_std: float  # metre, of those distances
    left_out: tuple[LeftOut, ...]
    cautions: tuple[str, ...]

    @property
    def reference(self) -> Picture:
        """The picture that ball.toml names first: its disc is that of the shading."""
        assert self.file.sharp is not None  # it was made from pictures
        return next(one for one in self.pictures if one.path == self.file.sharp.image)


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What somebody knows about the ball besides its pictures, metre."""

    radius: float | None = None
    radius_std: float | None = None
    distances: tuple[float, ...] = ()  # of its centre from the camera: one, or one a picture
    distance_std: float | None = None


def learn_ball(
    images: Sequence[Path],
    backgrounds: Sequence[Path],
    *,
    told: Told,
    camera: Path | None = None,
    response: str | Path | None = None,
    on_picture: Callable[[Path], None] | None = None,
) -> LearntBall:
    """Learn a ball's size, colours and light from one or several sharp pictures.

    A picture that cannot be used, or contradicts the others, is left out and named, as long as most
    of the others agree.

    Args:
        images: of the ball at rest, each sharp.
        backgrounds: the same view without it: as many as pictures, one for each in their order;
            otherwise all of them belong to every picture.
        told: what is known besides.
        camera: a camera.toml.
        response: "linear", "srgb", the name of a curve, or a response.toml.
        on_picture: called with each picture's path as it has been read.

    Raises:
        ConfigError: when numbers are impossible, or do not belong to the pictures.
        ImageError: when a lone picture, or a background, cannot be read.
        MismatchError: when pictures, background or camera do not belong together.
        CalibrationError: when no picture shows a ball that can be used, or they contradict each
            other.
    """
    _check(told, len(images), camera)
    pictures, left_out = _look(images, backgrounds, told, response, on_picture)
    lens: Camera | None = None
    if camera is not None:
        lens = fit_camera(read_camera(camera), pictures[0].image)
        pictures = [replace(one, size=size_in_view(one.disc, lens)) for one in pictures]
    distance_std = DISTANCE_STD if told.distance_std is None else told.distance_std
    radius = _radius(pictures, distance_std, lens)
    if radius is not None:
        left_out += [
            LeftOut(path=pictures[i].path, of="radius", reason=_other_radius(radius, i))
            for i in radius.contradicting
        ]
    together = learn_colours_together([one.view for one in pictures])
    left_out += [
        LeftOut(path=pictures[i].path, of="colours", reason=reason)
        for i, reason in together.contradicting.items()
    ]
    agreeing = [one for i, one in enumerate(pictures) if i not in together.contradicting]
    light = same_light([one.view for one in agreeing])
    sources = [_source(agreeing[i], response) for i in light.alike]
    radius_m, radius_std = _settled_radius(told, radius)
    return LearntBall(
        file=BallFile(
            radius=radius_m,
            radius_std=radius_std,
            kind=together.colours.kind,
            colours=together.colours.pigments,
            colours_std=together.std,
            plane_normal=together.colours.normal,
            plane_normal_std=together.colours.normal_std,
            sharp=sources[0],
            also=tuple(sources[1:]),
        ),
        pictures=tuple(pictures),
        together=together,
        light=light,
        radius=radius,
        distance_std=distance_std,
        left_out=(*left_out, *_other_light(agreeing, light)),
        cautions=(*_doubts(told, radius), *_lens_doubts(lens), *_response_doubts(pictures)),
    )


def _check(told: Told, count: int, camera: Path | None) -> None:
    limits = f"from {RADIUS_LIMITS[0]:g} to {RADIUS_LIMITS[1]:g} m"
    for flag, values in (("--radius", (told.radius,)), ("--distance", told.distances)):
        for value in values:
            if value is not None and not RADIUS_LIMITS[0] <= value <= RADIUS_LIMITS[1]:
                raise ConfigError(f"{flag} is {value:g} m; a number {limits} is needed")
    for flag, std, value in (
        ("--radius-std", told.radius_std, told.radius),
        ("--distance-std", told.distance_std, min(told.distances, default=None)),
    ):
        if std is not None and (value is None or not 0 < std < value):
            raise ConfigError(
                f"{flag} is {std:g} m; a positive number is needed, and a larger one that it "
                f"belongs to: {flag.removesuffix('-std')}"
            )
    if told.distances and camera is None:
        raise ConfigError("--distance tells the ball's size only through a lens; give --camera F")
    if len(told.distances) not in (0, 1, count):
        raise ConfigError(
            f"{len(told.distances)} distances for {count} pictures; give --distance once for all, "
            "or once for each"
        )


def _look(
    images: Sequence[Path],
    backgrounds: Sequence[Path],
    told: Told,
    response: str | Path | None,
    on_picture: Callable[[Path], None] | None,
) -> tuple[list[Picture], list[LeftOut]]:
    """Find the ball in each picture; those in which it cannot be found are named."""
    read = cache(partial(read_background, response=response))
    pictures: list[Picture] = []
    left_out: list[LeftOut] = []
    errors: list[ImageError | MismatchError | CalibrationError] = []
    seen: dict[str, Path] = {}
    for place, path in enumerate(images):
        own = (backgrounds[place],) if len(backgrounds) == len(images) else tuple(backgrounds)
        empty = read(own)  # one that cannot be read is no picture's fault
        try:
            picture = _find(path, own, empty, response, seen)
        except (ImageError, MismatchError, CalibrationError) as error:
            if len(images) == 1:
                raise
            errors.append(error)
            left_out.append(LeftOut(path=path, of="all", reason=str(error)))
        else:
            distances = told.distances
            distance = distances[place] if len(distances) > 1 else next(iter(distances), None)
            pictures.append(replace(picture, distance=distance))
        if on_picture is not None:
            on_picture(path)
    return _same_size(pictures, left_out, errors)


def _find(
    path: Path,
    background: tuple[Path, ...],
    empty: LinearImage,
    response: str | Path | None,
    seen: dict[str, Path],
) -> Picture:
    image = read_image(path, response=response)
    first = seen.setdefault(sha256(path), path)
    if first != path:
        raise MismatchError(f"the same file as {first}, counted once")
    return Picture(
        path=path,
        background=background,
        image=image,
        view=view_ball(image, empty),
        distance=None,
    )


def _same_size(
    pictures: list[Picture],
    left_out: list[LeftOut],
    errors: list[ImageError | MismatchError | CalibrationError],
) -> tuple[list[Picture], list[LeftOut]]:
    """Keep the pictures of the most common size."""
    if not pictures:
        path, error = left_out[0].path, errors[0]
        raise type(error)(f"none of {len(left_out)} pictures can be used: {path}: {error}")
    sizes = [(one.image.width, one.image.height) for one in pictures]
    usual = max(sizes, key=sizes.count)
    for one, size in zip(pictures, sizes, strict=True):
        if size != usual:
            reason = f"{size[0]}x{size[1]} px, but most pictures are {usual[0]}x{usual[1]}"
            left_out.append(LeftOut(path=one.path, of="all", reason=reason))
    kept = [one for one, size in zip(pictures, sizes, strict=True) if size == usual]
    return kept, left_out


def _radius(
    pictures: Sequence[Picture], distance_std: float, camera: Camera | None
) -> RadiusFound | None:
    sizes = [one.size for one in pictures if one.size is not None]
    distances = [one.distance for one in pictures if one.distance is not None]
    if camera is None or not distances:
        return None
    return find_radius(sizes, distances, distance_std, camera)


def _other_radius(found: RadiusFound, place: int) -> str:
    return (
        f"gives a radius of {1000 * found.by_picture[place]:.2f} mm where the others give "
        f"{1000 * found.radius:.2f} mm; check its distance"
    )


def _settled_radius(told: Told, found: RadiusFound | None) -> tuple[float | None, float | None]:
    """What somebody told beats what was measured, and keeps its own standard deviation."""
    if told.radius is not None:
        return told.radius, told.radius_std
    return (None, None) if found is None else (found.radius, found.std)


def _other_light(pictures: Sequence[Picture], light: LightTogether) -> list[LeftOut]:
    best = pictures[light.alike[0]]
    return [
        LeftOut(
            path=pictures[i].path,
            of="shading",
            reason=f"differs from {best.path} by {share:.0%} of the ball's brightness: lit or "
            "turned otherwise",
        )
        for i, share in light.others.items()
    ]


def _source(picture: Picture, response: str | Path | None) -> SharpSource:
    return SharpSource(
        image=picture.path,
        background=picture.background,
        disc=picture.disc,
        response=response,
    )


def _doubts(told: Told, found: RadiusFound | None) -> tuple[str, ...]:
    if told.radius is None or found is None:
        return ()
    allowed = CONTRADICTION * math.hypot(found.std, told.radius_std or 0.0)
    if abs(told.radius - found.radius) <= allowed:
        return ()
    return (
        f"--radius says {1000 * told.radius:.2f} mm and the pictures {1000 * found.radius:.2f} +/- "
        f"{1000 * found.std:.2f} mm; measure radius and distance again: every position and speed "
        "is in proportion to the radius",
    )


def _lens_doubts(camera: Camera | None) -> tuple[str, ...]:
    if camera is None or camera.covariance is not None:
        return ()
    return (
        "the camera file tells no covariance, so sizes are as if the lens were known exactly; "
        "calibrate with `toolkit calibrate`",
    )


def _response_doubts(pictures: Sequence[Picture]) -> tuple[str, ...]:
    image = pictures[0].image
    if not image.response_is_assumed:
        return ()
    return (
        f"the response '{image.response}' is only assumed, and a wrong one shifts the colours; "
        "use RAW, or name it with --response",
    )
