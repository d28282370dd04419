"""Lengths and times as people write them: 0,036 and 36 mm, 1/500 and 2 ms."""

import math
import re

from toolkit.errors import ConfigError

LENGTHS = {"": 1.0, "m": 1.0, "cm": 100.0, "mm": 1000.0, "in": 1 / 0.0254, '"': 1 / 0.0254}
TIMES = {"": 1.0, "s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6}
"""How many of a unit make a metre or a second: 36 / 1000 is 0.036, but 36 * 0.001 is not."""
LARGEST_RADIUS = 1.0
"""Metre; a larger ball is a number in millimetres or centimetres whose unit was left out."""
SMALLEST_RADIUS = 5e-4

_NUMBER = re.compile(
    r"(?P<top>\d*[.,]?\d+(?:e[+-]?\d+)?|\d+[.,])\s*(?:/\s*(?P<bottom>\d+(?:[.,]\d+)?))?"
    r"\s*(?P<unit>[a-zµ\"]*)",
    re.IGNORECASE | re.ASCII,
)


def parse_radius(text: str) -> float:
    """Read a ball's radius, metre.

    Raises:
        ConfigError: when it is no length, or none of a ball.

    Example:
        >>> parse_radius("0,036"), parse_radius("36 mm")
        (0.036, 0.036)
    """
    value, unit = _parse(text, LENGTHS, "a length such as 0.036 or 36 mm")
    if not unit and value > LARGEST_RADIUS:
        raise ConfigError(
            f"'{text}' would be {value:g} metres; write the unit, as in '{text.strip()} mm'"
        )
    if not SMALLEST_RADIUS <= value <= LARGEST_RADIUS:
        raise ConfigError(
            f"'{text}' is {value:g} m; a ball's radius (half its diameter) from 0.5 mm to 1 m is"
            " needed"
        )
    return value


def parse_length(text: str) -> float:
    """Read a positive or zero length, metre.

    Raises:
        ConfigError: when it is none.
    """
    return _parse(text, LENGTHS, "a length such as 0.025 or 25 mm")[0]


def parse_time(text: str) -> float:
    """Read a time, second.

    Raises:
        ConfigError: when it is none.

    Example:
        >>> parse_time("1/500"), parse_time("2 ms")
        (0.002, 0.002)
    """
    return _parse(text, TIMES, "a time such as 0.002, 2 ms or 1/500")[0]


def _parse(text: str, units: dict[str, float], wanted: str) -> tuple[float, str]:
    """Give the value in SI and the unit as it was written."""
    match = _NUMBER.fullmatch(text.strip())
    unit = "" if match is None else match["unit"].lower()
    if match is None or unit not in units:
        raise ConfigError(f"'{text}' is not {wanted}")
    value = _number(match["top"])
    if match["bottom"] is not None:
        bottom = _number(match["bottom"])
        if bottom == 0:
            raise ConfigError(f"'{text}' divides by zero; {wanted} is needed")
        value /= bottom
    value /= units[unit]
    if not math.isfinite(value):
        raise ConfigError(f"'{text}' is too large; {wanted} is needed")
    return value, unit


def _number(text: str) -> float:
    """Read digits with a point or a comma in them; both together are no number here."""
    return float(text.replace(",", "."))
