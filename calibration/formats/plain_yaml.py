"""A reader of the YAML that ROS and Kalibr write: mappings, lists and plain values, nothing else.

What could make a file do more than say numbers (tags, anchors, aliases) is refused, so that no
parser for all of YAML is needed. Unlike YAML 1.1, 1e-05 is a number here, as its writers mean it.
"""

import re
from dataclasses import dataclass

from toolkit.errors import ConfigError

DEEPEST = 20
"""Levels of nesting, which none of these files comes near."""

Plain = dict[str, "Plain"] | list["Plain"] | str | float | int | bool | None

_INTEGER = re.compile(r"[-+]?\d{1,18}")
_FLOAT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_QUOTED = re.compile(r"(?<![^\s\[{,:-])(?:\"(?:\\.|[^\"\\])*\"|'(?:''|[^'])*')")
_OPEN = re.compile(r"(?<![^\s\[{,:-])['\"]")
_WORDS: dict[str, Plain] = {"": None, "~": None, "null": None, "true": True, "false": False}
_WORDS |= {".nan": float("nan"), ".inf": float("inf"), "-.inf": float("-inf")}


@dataclass(slots=True)
class _Line:
    number: int
    indent: int
    text: str


def parse_yaml(text: str) -> Plain:
    """Parse a document.

    Raises:
        ConfigError: naming the line, where it is not such YAML.
    """
    lines = _lines(text)
    if not lines:
        return None
    value, rest = _block(lines, 0, lines[0].indent, 0)
    if rest < len(lines):
        raise _refusal(lines[rest], "is indented otherwise than the lines before it")
    return value


def _refusal(line: _Line, trouble: str) -> ConfigError:
    return ConfigError(f"line {line.number} ('{line.text:.40}') {trouble}")


def _lines(text: str) -> list[_Line]:
    """Give the lines that say something; one that is broken within brackets is made whole."""
    found: list[_Line] = []
    depth = 0
    for number, raw in enumerate(text.splitlines(), start=1):
        bare = _without_comment(raw).rstrip()
        if _OPEN.search(_quoted_spans(bare)):
            raise ConfigError(f"line {number} opens a quote that does not end on it")
        words = bare.strip()
        if not words or (depth == 0 and (words in ("---", "...") or bare.startswith("%"))):
            continue
        if "\t" in bare[: len(bare) - len(bare.lstrip())]:
            raise ConfigError(f"line {number} is indented by a tab; use spaces")
        if depth > 0:
            found[-1].text += f" {words}"
        else:
            found.append(_Line(number, len(bare) - len(bare.lstrip()), words))
        depth += _brackets(words)
    if depth > 0:
        raise _refusal(found[-1], "opens a bracket that is never closed")
    return found


def _quoted_spans(text: str) -> str:
    """Give the text with what stands within quotes blotted out, of the same length.

    A quote begins where a value may; the apostrophe of "it's" is a letter.
    """
    return _QUOTED.sub(lambda match: "q" * len(match[0]), text)


def _without_comment(text: str) -> str:
    match = re.search(r"(^|\s)#", _quoted_spans(text))
    return text if match is None else text[: match.start()]


def _brackets(text: str) -> int:
    plain = _quoted_spans(text)
    return sum(plain.count(c) for c in "[{") - sum(plain.count(c) for c in "]}")


def _block(lines: list[_Line], at: int, indent: int, depth: int) -> tuple[Plain, int]:
    """Read the mapping, list or value that begins with line `at`; say where the next begins."""
    if depth > DEEPEST:
        raise _refusal(lines[at], f"is nested more than {DEEPEST} deep")
    if _is_item(lines[at].text):
        return _sequence(lines, at, indent, depth)
    if _key(lines[at].text) is not None:
        return _mapping(lines, at, indent, depth)
    return _flow(lines[at], lines[at].text), at + 1


def _is_item(text: str) -> bool:
    return text == "-" or text.startswith("- ")


def _sequence(lines: list[_Line], at: int, indent: int, depth: int) -> tuple[Plain, int]:
    items: list[Plain] = []
    while at < len(lines) and lines[at].indent == indent and _is_item(lines[at].text):
        line = lines[at]
        rest = line.text[1:].lstrip()
        if rest:  # what follows the dash is a block of its own, indented by where it stands
            line.indent += len(line.text) - len(rest)
            line.text = rest
            item, at = _block(lines, at, line.indent, depth + 1)
        else:
            item, at = _below(lines, at + 1, indent, depth, is_key=False)
        items.append(item)
    return items, at


def _mapping(lines: list[_Line], at: int, indent: int, depth: int) -> tuple[Plain, int]:
    table: dict[str, Plain] = {}
    while at < len(lines) and lines[at].indent == indent and not _is_item(lines[at].text):
        line = lines[at]
        parts = _key(line.text)
        if parts is None:
            raise _refusal(line, "has no 'key: value'")
        key, rest = parts
        if key in table:
            raise _refusal(line, "names a key a second time")
        if rest:
            table[key], at = _flow(line, rest), at + 1
        else:
            table[key], at = _below(lines, at + 1, indent, depth, is_key=True)
    return table, at


def _below(
    lines: list[_Line], at: int, indent: int, depth: int, *, is_key: bool
) -> tuple[Plain, int]:
    """Read what stands below a key or a dash; a list may begin right below its key."""
    if at < len(lines):
        line = lines[at]
        if line.indent > indent or (is_key and line.indent == indent and _is_item(line.text)):
            return _block(lines, at, line.indent, depth + 1)
    return None, at


def _key(text: str) -> tuple[str, str] | None:
    """Part 'key: value'; None where there is no key."""
    match = re.match(r"([^\s\[\]{},:][^\[\]{},:]*|q+)\s*:(\s+|$)", _quoted_spans(text))
    if match is None:
        return None
    return text[: match.end(1)].strip().strip("'\""), text[match.end() :].strip()


def _flow(line: _Line, text: str) -> Plain:
    """Read a value that stands on one line."""
    value, rest = _item(line, text, 0)
    if rest.strip():
        raise _refusal(line, "goes on after its value has ended")
    return value


def _item(line: _Line, text: str, depth: int) -> tuple[Plain, str]:
    """Read a value, within brackets where `depth` says so, and give what follows it."""
    if depth > DEEPEST:
        raise _refusal(line, f"is nested more than {DEEPEST} deep")
    if text[:1] in ("[", "{"):
        return _list(line, text, depth) if text[0] == "[" else _table(line, text, depth)
    if text[:1] in tuple("&*!|>%@`"):
        raise _refusal(line, f"begins a value with '{text[0]}', which is not read here")
    match = re.match(r"[^,\[\]{}]*", _quoted_spans(text)) if depth else None
    end = len(text) if match is None else match.end()
    return _scalar(text[:end].strip()), text[end:]


def _list(line: _Line, text: str, depth: int) -> tuple[Plain, str]:
    items: list[Plain] = []
    rest = text[1:].lstrip()
    while not rest.startswith("]"):
        item, rest = _item(line, rest, depth + 1)
        items.append(item)
        rest = _after_comma(line, rest, "]")
    return items, rest[1:]


def _table(line: _Line, text: str, depth: int) -> tuple[Plain, str]:
    table: dict[str, Plain] = {}
    rest = text[1:].lstrip()
    while not rest.startswith("}"):
        parts = _key(rest)
        if parts is None or parts[0] in table:
            raise _refusal(line, "has no 'key: value', or a key twice, in its brackets")
        table[parts[0]], rest = _item(line, parts[1], depth + 1)
        rest = _after_comma(line, rest, "}")
    return table, rest[1:]


def _after_comma(line: _Line, text: str, end: str) -> str:
    """Give what comes after a comma; the closing bracket stays."""
    rest = text.lstrip()
    if rest.startswith(","):
        return rest[1:].lstrip()
    if not rest.startswith(end):
        raise _refusal(line, "has brackets that do not match")
    return rest


def _scalar(text: str) -> Plain:
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        return text[1:-1].replace("''", "'") if text[0] == "'" else text[1:-1]
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text
