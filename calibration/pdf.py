"""A page of black rectangles and words as a PDF, at true scale.

Written by hand: a board needs nothing else, and every length is then exact to 0.0001 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

POINTS_PER_MM = 72 / 25.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Word:
    """A line of text; its baseline begins at (x, y)."""

    x: float  # mm from the left
    y: float  # mm from the top
    text: str
    height: float = 3.0  # mm, of the font


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """Black rectangles and words on white paper; mm from the top left, y down."""

    width: float
    height: float
    rectangles: Sequence[tuple[float, float, float, float]] = ()  # x, y, width, height
    words: Sequence[Word] = field(default=())


def pdf_of(page: Page, title: str) -> bytes:
    """Give a PDF of one page that asks its viewer to print it unscaled."""
    size = f"{page.width * POINTS_PER_MM:.5f} {page.height * POINTS_PER_MM:.5f}"
    content = _content(page)
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents 4 0 R"
        " /Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        b"<< /Title (%s) >>" % _escaped(title),
    ]
    return _file(objects)


def _content(page: Page) -> bytes:
    """Draw in mm from the top left: the first line turns the page's points into that."""
    scale = f"{POINTS_PER_MM:.10f}"
    lines = [f"{scale} 0 0 -{scale} 0 {page.height * POINTS_PER_MM:.5f} cm", "0 g"]
    lines += ["{:.4f} {:.4f} {:.4f} {:.4f} re".format(*r) for r in page.rectangles]
    drawn = "\n".join([*lines, "f"]).encode()  # one path: neighbours leave no hairline
    words = [
        b"BT /F1 %.4f Tf 1 0 0 -1 %.4f %.4f Tm (%s) Tj ET"
        % (word.height, word.x, word.y, _escaped(word.text))
        for word in page.words
    ]
    return b"\n".join([drawn, *words])


def _escaped(text: str) -> bytes:
    raw = text.encode("cp1252", errors="replace")
    return raw.replace(b"\\", rb"\\").replace(b"(", rb"\(").replace(b")", rb"\)")


def _file(objects: Sequence[bytes]) -> bytes:
    """Number the objects and list where each begins, as the format asks."""
    data = b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"
    starts = []
    for number, body in enumerate(objects, start=1):
        starts.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % start for start in starts)
    count = len(objects) + 1
    return data + (
        b"xref\n0 %d\n0000000000 65535 f \n%strailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n"
        b"startxref\n%d\n%%%%EOF\n" % (count, table, count, len(objects), len(data))
    )
