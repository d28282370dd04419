"""Dataclasses to and from the plain dicts, lists and numbers of JSON, checked by field type."""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from toolkit.errors import ConfigError


def to_plain(value: Any) -> Any:
    """Turn dataclasses into dicts in field order, tuples into lists, NaN and infinity into None."""
    if is_dataclass(value):
        return {item.name: to_plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def from_plain(kind: Any, value: Any, where: str) -> Any:
    """Build a value of type `kind` from plain data; a None in a list of numbers becomes NaN.

    Raises:
        ConfigError: naming the place, when a key is missing or unknown, or a type is wrong.
    """
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        if value is None:
            return None
        (kind,) = (part for part in get_args(kind) if part is not NoneType)
        return from_plain(kind, value, where)
    if is_dataclass(kind):
        return _dataclass_from_plain(kind, value, where)
    if origin is tuple:
        return _tuple_from_plain(kind, value, where)
    if origin is Mapping:
        _, item_kind = get_args(kind)
        items = _checked(value, dict, where).items()
        return {key: from_plain(item_kind, item, f"{where}.{key}") for key, item in items}
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return _checked(value, kind, where)


@cache
def _field_types(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {item.name: hints[item.name] for item in fields(kind)}


def _dataclass_from_plain(kind: Any, value: Any, where: str) -> Any:
    table = _checked(value, dict, where)
    types = _field_types(kind)
    for key in table:
        if key not in types:
            raise ConfigError(f"{where}: unknown key '{key}'; known are {', '.join(types)}")
    for key in types:
        if key not in table:
            raise ConfigError(f"{where}: key '{key}' is missing; write null where it is not known")
    return kind(**{key: from_plain(types[key], table[key], f"{where}.{key}") for key in types})


def _tuple_from_plain(kind: Any, value: Any, where: str) -> Any:
    items = _checked(value, list, where)
    parts = get_args(kind)
    open_ended = parts[-1] is Ellipsis
    if not open_ended and len(items) != len(parts):
        raise ConfigError(f"{where}: {len(items)} entries; {len(parts)} are needed")
    return tuple(
        math.nan if item is None and parts[0] is float else from_plain(parts[0], item, where)
        for item in items
    )


def _checked(value: Any, kind: Any, where: str) -> Any:
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise ConfigError(f"{where}: {value!r:.60} is not a {kind.__name__}")
    return value
