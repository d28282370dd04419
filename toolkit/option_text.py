"""Values written as text on the command line, read by the type of the field they are for."""

import math
from collections.abc import Iterable
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from toolkit.errors import ConfigError

Colour = tuple[float, float, float]

WORDS = {"true": True, "yes": True, "on": True, "1": True}
WORDS |= {"false": False, "no": False, "off": False, "0": False}


def parse_settings(words: Iterable[str], flag: str = "--set") -> dict[str, str]:
    """Read FIELD=VALUE words; the last one of a field counts.

    Raises:
        ConfigError: naming `flag`, when a word has no equals sign.

    Example:
        >>> parse_settings(["gloss=0.3", "label=a=b"])
        {'gloss': '0.3', 'label': 'a=b'}
    """
    settings = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals:
            raise ConfigError(f"{flag} is '{word}'; FIELD=VALUE is needed")
        settings[name] = value
    return settings


def parse_colours(texts: Iterable[str], flag: str = "--ball-colour") -> tuple[Colour, ...]:
    """Read colours R,G,B, naming `flag` when one is none."""
    return tuple(parse_option(text, Colour, flag) for text in texts)


def parse_option(text: str, kind: Any, where: str) -> Any:
    """Read `text` as a float, int, bool, str, or a tuple of those written with commas.

    For a field that may be None the word "none" stands for it.

    Raises:
        ConfigError: naming `where`, when the text is no such value.

    Example:
        >>> parse_option("0.2,0.5,1", tuple[float, float, float], "colour")
        (0.2, 0.5, 1.0)
    """
    if get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind):
        if text.strip().lower() == "none":
            return None
        kinds = [part for part in get_args(kind) if part is not NoneType]
        kind = kinds[0] if len(kinds) == 1 else kind
    if get_origin(kind) is tuple:
        return _parse_tuple(text, get_args(kind), where)
    if kind is str:
        return text
    if kind is bool:
        return _parse_bool(text, where)
    if kind is int or kind is float:
        return _parse_number(text, kind, where)
    raise ConfigError(f"{where} cannot be written as text; set it from Python")


def format_option(value: object) -> str:
    """Write a value as `parse_option` reads it.

    Raises:
        ConfigError: when a value of that kind cannot be written as text.

    Example:
        >>> format_option((0.2, 0.5, 1.0))
        '0.2,0.5,1.0'
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return ",".join(format_option(part) for part in value)
    if isinstance(value, int | float | str):
        return str(value)
    raise ConfigError(f"a {type(value).__name__} cannot be written as text; set it from Python")


def can_be_text(kind: Any) -> bool:
    """Say whether a field of this type can be set from the command line.

    Example:
        >>> can_be_text(tuple[float, ...] | None), can_be_text(list[float])
        (True, False)
    """
    if get_origin(kind) in (Union, UnionType):
        possible = [part for part in get_args(kind) if part is not NoneType]
        return len(possible) == 1 and can_be_text(possible[0])
    kinds = get_args(kind) if get_origin(kind) is tuple else (kind,)
    return all(part in (str, bool, int, float, Ellipsis) for part in kinds)


def _parse_number(text: str, kind: type[int] | type[float], where: str) -> int | float:
    try:
        number = kind(text)
    except ValueError:
        wanted = "whole number" if kind is int else "number"
        raise ConfigError(f"{where} is '{text}'; a {wanted} is needed") from None
    if not math.isfinite(number):
        raise ConfigError(f"{where} is '{text}'; a finite number is needed")
    return number


def _parse_bool(text: str, where: str) -> bool:
    word = text.strip().lower()
    if word not in WORDS:
        raise ConfigError(f"{where} is '{text}'; true or false is needed")
    return WORDS[word]


def _parse_tuple(text: str, kinds: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    parts = text.split(",")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(parts)
    if len(parts) != len(kinds):
        raise ConfigError(
            f"{where} is '{text}'; {len(kinds)} values with commas between them are needed"
        )
    return tuple(parse_option(part, kind, where) for part, kind in zip(parts, kinds, strict=True))
