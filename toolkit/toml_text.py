"""Writing the project's own small TOML files; the standard library only reads them."""

import json
import math
from collections.abc import Mapping
from typing import Any

from toolkit.errors import ConfigError


def to_toml(kind: str, table: Mapping[str, Any]) -> str:
    """Give the text of a TOML file whose `schema` is "toolkit.<kind>/1".

    Args:
        kind: what the file describes, as `toolkit.files.read_toml` wants it.
        table: keys with text, finite numbers, booleans, or lists of them, also nested; a value that
            is itself such a table becomes a section, and a list of them as many of one name.

    Raises:
        ConfigError: naming the key, when a number is not finite.

    Example:
        >>> print(to_toml("lens", {"f": 2.0, "names": ["a"]}), end="")
        schema = "toolkit.lens/1"
        f = 2.0
        names = ["a"]
    """
    lines = [f'schema = "toolkit.{kind}/1"']
    lines += _lines({key: item for key, item in table.items() if not _sections(key, item)})
    for name, item in table.items():  # after the plain keys, or they would be swallowed
        for heading, section in _sections(name, item):
            lines += ["", heading, *_lines(section)]
    return "\n".join(lines) + "\n"


def _sections(name: str, item: Any) -> list[tuple[str, Mapping[str, Any]]]:
    """Give the sections that a value makes, with their headings; none of a plain value."""
    if isinstance(item, Mapping):
        return [(f"[{name}]", item)]
    if isinstance(item, list | tuple) and item and all(isinstance(one, Mapping) for one in item):
        return [(f"[[{name}]]", one) for one in item]
    return []


def _lines(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_value(value, key)}" for key, value in table.items()]


def _value(value: Any, key: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list | tuple):
        return _list(value, key)
    if isinstance(value, int):
        return repr(value)
    if not math.isfinite(value):
        raise ConfigError(f"'{key}' holds {value}, which no file may carry; only finite numbers")
    return repr(float(value))


def _list(values: list[Any] | tuple[Any, ...], key: str) -> str:
    parts = [_value(value, key) for value in values]
    if any(isinstance(value, list | tuple) for value in values):  # a matrix: one row a line
        return "[\n" + "".join(f"    {part},\n" for part in parts) + "]"
    return f"[{', '.join(parts)}]"


def _text(text: str) -> str:
    """Quote as JSON does and escape DEL too; bytes of a file name that are no text become '?'."""
    whole = text.encode("utf-8", "replace").decode("utf-8")
    return json.dumps(whole, ensure_ascii=False).replace("\x7f", "\\u007f")
