"""What the formats of other programs have in common."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from toolkit.camera import Camera
from toolkit.errors import ConfigError, MismatchError


@dataclass(frozen=True, slots=True, kw_only=True)
class ForeignCamera:
    """A camera of another program's file, in our terms."""

    camera: Camera
    name: str  # by which the file tells it from others
    rms_px: float | None = None
    left_out: tuple[str, ...] = ()  # what the file says and a camera.toml does not hold


Cameras = Mapping[str, Callable[[], ForeignCamera]]
"""By name, each read when it is asked for: one that cannot be spoils no other."""


def number(value: object, what: str) -> float:
    """Give a finite number.

    Raises:
        ConfigError: naming `what`, where it is none.
    """
    # to Python a yes or no is an int, too
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{what} is {value!r:.40}; a finite number is needed")
    return float(value)


def numbers(values: object, what: str, count: int | None = None) -> list[float]:
    """Give a list of finite numbers, `count` of them where that is said.

    Raises:
        ConfigError: naming `what`, where it is none.
    """
    if not isinstance(values, list) or (count is not None and len(values) != count):
        wanted = "a list of numbers" if count is None else f"{count} numbers"
        raise ConfigError(f"{what} is {values!r:.60}; {wanted} are needed")
    return [number(value, what) for value in values]


def size(values: Sequence[object], what: str) -> tuple[int, int]:
    """Give a picture's width and height.

    Raises:
        ConfigError: naming `what`, where they are no whole numbers from 1 up.
    """
    width, height = (number(value, what) for value in values)
    if min(width, height) < 1 or width % 1 or height % 1:
        raise ConfigError(f"{what} is {width:g}x{height:g}; whole numbers of pixels are needed")
    return int(width), int(height)


def focal_and_centre(matrix: Sequence[float], what: str) -> tuple[float, float, float, float]:
    """Give fx, fy, cx, cy of a camera matrix, row by row.

    Raises:
        ConfigError: where it is no camera matrix, or one of pixels that are not upright.
    """
    fx, skew, cx, below, fy, cy, *last = matrix
    if below != 0 or last != [0, 0, 1]:
        raise ConfigError(f"{what} is no camera matrix [fx 0 cx; 0 fy cy; 0 0 1]")
    if skew != 0:
        raise ConfigError(
            f"{what} has a skew of {skew:g}, which no camera.toml holds; calibrate without it"
        )
    return fx, fy, cx, cy


def matrix_rows(camera: Camera) -> list[list[float]]:
    """Give the camera matrix, 3 rows of 3."""
    return [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]


def polynomial_model(coefficients: Sequence[float], what: str) -> tuple[str, tuple[float, ...]]:
    """Give model and distortion of OpenCV's 4, 5, 8, 12 or 14 coefficients.

    Raises:
        ConfigError: where there is another number of them, or a thin prism or tilted sensor.
    """
    kept = list(coefficients)
    if len(kept) in (12, 14):
        if any(kept[8:]):
            raise ConfigError(
                f"{what} tells of a thin prism or a tilted sensor, which no camera.toml holds; "
                "calibrate without them"
            )
        kept = kept[:8]
    if len(kept) not in (0, 4, 5, 8):
        raise ConfigError(f"{what} has {len(kept)} coefficients; 4, 5 or 8 are needed")
    if len(kept) == 8 and not any(kept[5:]):
        kept = kept[:5]
    return ("rational" if len(kept) == 8 else "pinhole"), tuple(kept)


def yaml_list(values: Sequence[float]) -> str:
    """Write numbers so that YAML 1.1 too, as PyYAML has it, reads them as such: 1.0e-05."""
    words = (repr(float(value)) for value in values)
    return f"[{', '.join(w if '.' in w else w.replace('e', '.0e') for w in words)}]"


def four_polynomial(camera: Camera, program: str) -> list[float]:
    """Give k1 k2 p1 p2 of a lens that has no more.

    Raises:
        MismatchError: where it has, as `program` could not hold it.
    """
    k1, k2, p1, p2, *more = (*camera.distortion, *(0.0,) * (4 - len(camera.distortion)))
    if any(more):
        raise MismatchError(
            f"{program} holds k1 k2 p1 p2, and this {camera.model} camera has "
            f"{len(camera.distortion)} coefficients; calibrate with fewer terms, or choose "
            "another --format"
        )
    return [k1, k2, p1, p2]
