"""rig.toml: all that stays the same from shot to shot, so that the shot alone need be named."""

import glob
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from toolkit.errors import ConfigError
from toolkit.files import check_keys, read_toml

Colour = tuple[float, float, float]

_SECTIONS: dict[str, dict[str, type | tuple[type, ...]]] = {
    "camera": {"file": str},
    "response": {"kind": str, "file": str},
    "ball": {"radius_m": float, "radius_std_m": float, "file": str, "colours": list},
    "exposure": {"time_s": float, "time_std_s": float, "readout_s": float},
    "background": {"images": list},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """What a rig.toml says; None, or empty, where it says nothing. Paths are ready to open."""

    camera: Path | None = None
    response: str | Path | None = None  # a name, or a response.toml
    ball_radius: float | None = None  # metre
    ball_radius_std: float | None = None  # metre
    ball_colours: tuple[Colour, ...] = ()  # linear R,G,B, sensor white = 1
    ball: Path | None = None  # a ball.toml
    ball_image: Path | None = None  # a sharp picture of the ball, over the shot's background
    exposure: float | None = None  # second
    exposure_std: float | None = None  # second
    readout: float | None = None  # second from the start of the first row to that of the last
    background: tuple[Path, ...] = ()
    estimator: str | None = None
    options: Mapping[str, str] = field(default_factory=dict)  # as --set writes them

    def over(self, other: "Rig") -> "Rig":
        """Give what this rig says, and what `other` says where this one is silent.

        A standard deviation belongs to its own value and options to their own estimator: they are
        not mixed with those of the other rig.
        """
        same_estimator = self.estimator in (None, other.estimator)
        keeps_radius = self.ball_radius is None and self.ball_radius_std is None
        keeps_exposure = self.exposure is None and self.exposure_std is None
        return Rig(
            camera=self.camera or other.camera,
            response=self.response or other.response,
            ball_radius=other.ball_radius if self.ball_radius is None else self.ball_radius,
            ball_radius_std=other.ball_radius_std if keeps_radius else self.ball_radius_std,
            ball_colours=self.ball_colours or other.ball_colours,
            ball=self.ball or other.ball,
            ball_image=self.ball_image or other.ball_image,
            exposure=other.exposure if self.exposure is None else self.exposure,
            exposure_std=other.exposure_std if keeps_exposure else self.exposure_std,
            readout=other.readout if self.readout is None else self.readout,
            background=self.background or other.background,
            estimator=self.estimator or other.estimator,
            options={**(other.options if same_estimator else {}), **self.options},
        )


def read_rig(path: Path) -> Rig:
    """Read a rig.toml; its paths are relative to the folder it lies in.

    Raises:
        ConfigError: when the file is missing or no rig file, or a key or value is impossible.
    """
    table = read_toml(path, "rig")
    check_keys(str(path), table, dict.fromkeys([*_SECTIONS, "measure"], dict))
    for name, keys in _SECTIONS.items():
        check_keys(f"{path} [{name}]", table.get(name, {}), keys)
    ball, exposure = table.get("ball", {}), table.get("exposure", {})
    camera = table.get("camera", {}).get("file")
    measure = dict(table.get("measure", {}))
    check_keys(f"{path} [measure]", {"estimator": measure.get("estimator", "")}, {"estimator": str})
    estimator = measure.pop("estimator", None)
    return Rig(
        camera=None if camera is None else path.parent / camera,
        response=_response(path, table.get("response", {})),
        ball_radius=ball.get("radius_m"),
        ball_radius_std=ball.get("radius_std_m"),
        ball_colours=_colours(path, ball.get("colours", [])),
        ball=None if "file" not in ball else path.parent / ball["file"],
        exposure=exposure.get("time_s"),
        exposure_std=exposure.get("time_std_s"),
        readout=exposure.get("readout_s"),
        background=_backgrounds(path, table.get("background", {}).get("images", [])),
        estimator=estimator,
        options={key: _as_option_text(path, key, value) for key, value in measure.items()},
    )


def _response(path: Path, section: Mapping[str, str]) -> str | Path | None:
    if "kind" in section and "file" in section:
        raise ConfigError(f"{path} [response] has both kind and file; keep one of them")
    if "file" in section:
        return path.parent / section["file"]
    return section.get("kind")


def _colours(path: Path, rows: list[Any]) -> tuple[Colour, ...]:
    for row in rows:
        is_colour = isinstance(row, list) and len(row) == 3
        if not is_colour or any(isinstance(c, bool) or not isinstance(c, int | float) for c in row):
            raise ConfigError(f"{path} [ball]: colour {row!r:.60} is not three numbers [R, G, B]")
    return tuple((float(r), float(g), float(b)) for r, g, b in rows)


def _backgrounds(path: Path, patterns: list[Any]) -> tuple[Path, ...]:
    """Expand the patterns in the order given; a name with no wildcard in it stands for itself."""
    found: list[Path] = []
    for pattern in patterns:
        if not isinstance(pattern, str):
            raise ConfigError(f"{path} [background]: image {pattern!r:.60} is not a path")
        names = [pattern]
        if glob.has_magic(pattern):
            names = sorted(glob.glob(pattern, root_dir=path.parent))
        if not names:
            raise ConfigError(f"{path} [background]: no picture matches '{pattern}'")
        found += [path.parent / name for name in names]
    return tuple(found)


def _as_option_text(path: Path, key: str, value: Any) -> str:
    """Write an estimator's option as the command line would, so that one parser reads both."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list) and not any(isinstance(item, list | dict) for item in value):
        return ",".join(_as_option_text(path, key, item) for item in value)
    if isinstance(value, str | int | float):
        return str(value)
    raise ConfigError(
        f"{path} [measure]: '{key}' is {value!r:.60}; a number, text or list is needed"
    )
