"""HTML and SVG by functions: every text is escaped unless it was made here."""

from collections.abc import Sequence
from html import escape

VOID = {"meta", "img", "br", "rect", "line", "circle", "path", "polyline", "polygon"}


class Markup(str):
    """Text that is markup already, and is not escaped again."""

    __slots__ = ()


def tag(name: str, /, *children: str, **attributes: object) -> Markup:
    """Write one element.

    Args:
        name: of the element.
        children: what it holds; text that is no `Markup` is escaped.
        attributes: by name, an underscore for a hyphen and one at the end dropped; those that are
            None are left out, and numbers are written short.

    Example:
        >>> tag("p", "1 < 2", tag("b", "!"), class_="odd")
        '<p class="odd">1 &lt; 2<b>!</b></p>'
    """
    words = [name]
    for key, value in attributes.items():
        if value is not None:
            words.append(f'{key.rstrip("_").replace("_", "-")}="{escape(_short(value))}"')
    inside = join(children)
    if name in VOID and not inside:
        return Markup(f"<{' '.join(words)}/>")
    return Markup(f"<{' '.join(words)}>{inside}</{name}>")


def join(parts: Sequence[str], between: str = "") -> Markup:
    """Write parts one after the other, escaping those that are no markup."""
    return Markup(between.join(_escaped(part) for part in parts))


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Markup:
    """Write a table that scrolls by itself where it is wider than the screen."""
    top = tag("tr", *(tag("th", cell, scope="col") for cell in head))
    body = [tag("tr", *(tag("td", cell) for cell in row)) for row in rows]
    return tag("div", tag("table", tag("thead", top), tag("tbody", *body)), class_="wide")


def picture(width: float, height: float, title: str, *children: str) -> Markup:
    """Write a drawing that scales with the page; `title` tells what it shows."""
    return tag(
        "svg",
        tag("title", title),
        *children,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {_short(width)} {_short(height)}",
        role="img",
    )


def _escaped(text: str) -> str:
    if isinstance(text, Markup):
        return text
    # control characters of a file name are not allowed in HTML at all
    return escape("".join(c if c.isprintable() or c in "\n\t" else "?" for c in text))


def _short(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
