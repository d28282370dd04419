"""ball.toml: what is known about a ball, and where it can be seen sharply."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from toolkit.errors import ConfigError
from toolkit.files import check_keys, read_toml, write_text
from toolkit.toml_text import to_toml

if TYPE_CHECKING:  # reading the numbers of a ball needs no pictures
    from toolkit.ball import Disc, SharpBall

Colour = tuple[float, float, float]

KINDS = ("plane", "line", "solid")
_KEYS: dict[str, type | tuple[type, ...]] = {
    "radius_m": float,
    "radius_std_m": float,
    "kind": str,
    "colours": list,
    "colours_std": list,
    "plane_normal": list,
    "plane_normal_std": float,
    "sharp": dict,
    "also": list,
}
_SHARP: dict[str, type | tuple[type, ...]] = {
    "image": str,
    "background": list,
    "response": str,
    "response_file": str,
    "centre_px": list,
    "semi_axes_px": list,
    "angle_rad": float,
    "std_px": float,
}
_SHARP_OPTIONAL = ("response", "response_file")


@dataclass(frozen=True, slots=True, kw_only=True)
class SharpSource:
    """Where a ball is seen sharply. Paths are ready to open."""

    image: Path
    background: tuple[Path, ...]
    disc: "Disc"
    response: str | Path | None = None  # a name, or a response.toml; None when nobody said

    @property
    def files(self) -> tuple[Path, ...]:
        """All that `look` reads."""
        curve = (self.response,) if isinstance(self.response, Path) else ()
        return (self.image, *self.background, *curve)

    def look(self) -> "SharpBall":
        """Read the pictures and take the light of the disc.

        Raises:
            ImageError: when a picture cannot be read.
            MismatchError: when the disc does not lie in it, or the pictures differ in size.
        """
        from toolkit.ball_look import look_at_disc
        from toolkit.imaging import read_background, read_image

        image = read_image(self.image, response=self.response)
        background = read_background(self.background, response=self.response)
        return look_at_disc(image, background, self.disc)


@dataclass(frozen=True, slots=True, kw_only=True)
class BallFile:
    """What a ball.toml says; None, or empty, where it says nothing."""

    radius: float | None = None  # metre
    radius_std: float | None = None  # metre
    kind: str | None = None  # "plane", "line" or "solid", as the colours lie about black
    colours: tuple[Colour, ...] = ()  # linear R,G,B, sensor white = 1: two pigments, or one
    colours_std: tuple[Colour, ...] = ()  # of each of them
    plane_normal: Colour | None = None  # unit, of the plane through black and both pigments
    plane_normal_std: float | None = None  # radian
    sharp: SharpSource | None = None
    also: tuple[SharpSource, ...] = ()  # further pictures in the same light, the ball not turned

    @property
    def files(self) -> tuple[Path, ...]:
        """All that `look` reads."""
        sources = (*((self.sharp,) if self.sharp else ()), *self.also)
        return tuple(dict.fromkeys(path for source in sources for path in source.files))

    def look(self) -> "SharpBall":
        """Read the pictures and take the mean light of the discs.

        Raises:
            ConfigError: when the file names no picture.
            ImageError: when a picture cannot be read.
            MismatchError: when a disc does not lie in it, or the pictures differ in size.
        """
        if self.sharp is None:
            raise ConfigError("the ball file names no sharp picture; run `toolkit ball` again")
        if not self.also:
            return self.sharp.look()
        from toolkit.mean_ball import mean_ball

        return mean_ball([source.look() for source in (self.sharp, *self.also)])


def read_ball(path: Path) -> BallFile:
    """Read a ball.toml; its paths are relative to the folder it lies in. No picture is opened.

    Raises:
        ConfigError: when the file is missing or no ball file, or a key or value is impossible.
    """
    where = str(path)
    table = read_toml(path, "ball")
    check_keys(where, table, _KEYS)
    kind = table.get("kind")
    if kind is not None and kind not in KINDS:
        raise ConfigError(f"{where}: kind is '{kind:.40}'; one of {', '.join(KINDS)} is needed")
    normal = None
    if "plane_normal" in table:
        normal = _unit(where, _numbers(where, "plane_normal", table["plane_normal"], 3))
    colours, std = (
        tuple(_colour(where, row) for row in table.get(key, []))
        for key in ("colours", "colours_std")
    )
    if std and len(std) != len(colours):
        raise ConfigError(f"{where}: {len(std)} colours_std for {len(colours)} colours; one each")
    if "also" in table and "sharp" not in table:
        raise ConfigError(f"{where}: [[also]] without [sharp]; run `toolkit ball` again")
    return BallFile(
        radius=_positive(where, "radius_m", table.get("radius_m")),
        radius_std=_positive(where, "radius_std_m", table.get("radius_std_m")),
        kind=kind,
        colours=colours,
        colours_std=std,
        plane_normal=normal,
        plane_normal_std=_positive(where, "plane_normal_std", table.get("plane_normal_std")),
        sharp=_sharp(path, table["sharp"], "[sharp]") if "sharp" in table else None,
        also=tuple(_sharp(path, section, "[[also]]") for section in table.get("also", [])),
    )


def write_ball(path: Path, ball: BallFile) -> None:
    """Write a ball.toml, whole or not at all; pictures are named relative to its folder.

    Raises:
        ConfigError: when a number is not finite.
        EnvironmentFault: when the place cannot be written.
    """
    table: dict[str, Any] = {
        "radius_m": ball.radius,
        "radius_std_m": ball.radius_std,
        "kind": ball.kind,
        "colours": [list(colour) for colour in ball.colours] or None,
        "colours_std": [list(colour) for colour in ball.colours_std] or None,
        "plane_normal": ball.plane_normal,
        "plane_normal_std": ball.plane_normal_std,
        "sharp": None if ball.sharp is None else _sharp_table(path.parent, ball.sharp),
        "also": [_sharp_table(path.parent, source) for source in ball.also] or None,
    }
    write_text(path, to_toml("ball", {k: v for k, v in table.items() if v is not None}))


def _sharp_table(folder: Path, sharp: SharpSource) -> dict[str, Any]:
    table: dict[str, Any] = {
        "image": _from(folder, sharp.image),
        "background": [_from(folder, place) for place in sharp.background],
    }
    if isinstance(sharp.response, Path):
        table["response_file"] = _from(folder, sharp.response)
    elif sharp.response is not None:
        table["response"] = sharp.response
    return table | {
        "centre_px": sharp.disc.centre,
        "semi_axes_px": sharp.disc.semi_axes,
        "angle_rad": sharp.disc.angle,
        "std_px": sharp.disc.std,
    }


def _from(folder: Path, place: Path) -> str:
    """Write a path so that it is found from `folder`, with slashes on every system."""
    try:
        return Path(os.path.relpath(place.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return place.resolve().as_posix()


def _sharp(path: Path, section: Mapping[str, Any], name: str) -> SharpSource:
    from toolkit.ball import Disc

    where = f"{path} {name}"
    if not isinstance(section, Mapping):
        raise ConfigError(f"{where} is {section!r:.40}; run `toolkit ball` again")
    check_keys(where, section, _SHARP)
    missing = [key for key in _SHARP if key not in section and key not in _SHARP_OPTIONAL]
    if missing:
        raise ConfigError(f"{where}: {', '.join(missing)} missing; run `toolkit ball` again")
    if "response" in section and "response_file" in section:
        raise ConfigError(f"{where} has both response and response_file; keep one of them")
    names = section["background"]
    if not names or not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{where}: background is {names!r:.60}; a list of paths is needed")
    x, y = _numbers(where, "centre_px", section["centre_px"], 2)
    longer, shorter = _numbers(where, "semi_axes_px", section["semi_axes_px"], 2)
    angle, std = _numbers(where, "angle_rad, std_px", [section["angle_rad"], section["std_px"]], 2)
    if not 1 <= shorter <= longer or std < 0:
        raise ConfigError(
            f"{where}: semi_axes_px {longer:g}, {shorter:g} with std_px {std:g} make no disc; "
            "run `toolkit ball` again"
        )
    curve = section.get("response_file")
    return SharpSource(
        image=path.parent / section["image"],
        background=tuple(path.parent / name for name in names),
        disc=Disc(centre=(x, y), semi_axes=(longer, shorter), angle=angle, std=std),
        response=section.get("response") if curve is None else path.parent / curve,
    )


def _numbers(where: str, key: str, values: list[Any], count: int) -> list[float]:
    is_number = [isinstance(v, int | float) and not isinstance(v, bool) for v in values]
    if len(values) != count or not all(is_number) or not all(math.isfinite(v) for v in values):
        raise ConfigError(f"{where}: {key} is {values!r:.60}; {count} finite numbers are needed")
    return [float(value) for value in values]


def _positive(where: str, key: str, value: float | None) -> float | None:
    if value is not None and not (math.isfinite(value) and value > 0):
        raise ConfigError(f"{where}: {key} is {value!r:.40}; a positive number is needed")
    return None if value is None else float(value)


def _colour(where: str, row: Any) -> Colour:
    if not isinstance(row, list):
        raise ConfigError(f"{where}: colour {row!r:.60} is not three numbers [R, G, B]")
    r, g, b = _numbers(where, "a colour", row, 3)
    return r, g, b


def _unit(where: str, vector: list[float]) -> Colour:
    length = math.hypot(*vector)
    if not 0.99 < length < 1.01:
        raise ConfigError(f"{where}: plane_normal has the length {length:.3g}; 1 is needed")
    x, y, z = (value / length for value in vector)
    return x, y, z
