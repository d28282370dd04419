"""The drawings of a calibration report, as SVG that needs neither network nor script.

Colours are named in the page's style sheet, so that they follow a light or a dark screen.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.report.markup import Markup, picture, tag

Array = NDArray[np.float64]

WIDTH = 640.0
"""Of a drawing, in its own units; the page scales it."""
MOST_ARROWS = 1500
MOST_LONG = 4.0
"""Times the usual longest arrow at which one that is longer yet is cut: a misread corner."""
LONGEST_ARROW = 22.0
"""Units that the 95th percentile of the errors is drawn long."""
CELLS = (16, 12)
"""Parts of the picture over which errors are averaged, across and down."""
FEWEST_IN_CELL = 4
"""Corners in a part below which their mean says nothing."""


def draw_coverage(
    size: tuple[int, int], corners: Sequence[Array], counts: NDArray[np.int64]
) -> Markup:
    """Draw all corners found over the grid whose cells should hold some.

    Args:
        size: width, height of the photos, px.
        corners: of each view [N, 2] px.
        counts: corners in each cell [R, C], row by row from the top.
    """
    scale, height = _scale(size)
    rows, columns = counts.shape
    across, down = WIDTH / columns, height / rows
    cells, numbers = [], []
    for row, column in np.ndindex(counts.shape):
        count = int(counts[row, column])
        place = {"x": column * across, "y": row * down}
        cells.append(
            tag("rect", **place, width=across, height=down, class_="cell" if count else "empty")
        )
        numbers.append(tag("text", str(count), x=place["x"] + 5, y=place["y"] + 20, class_="count"))
    dots = [
        tag("circle", cx=x, cy=y, r=1.6, class_="dot")
        for view in corners
        for x, y in _placed(view, scale).tolist()
    ]
    empty = int((counts == 0).sum())
    title = f"{sum(map(len, corners))} corners; {empty} of {counts.size} cells are empty"
    return picture(WIDTH, height, title, *cells, *dots, *numbers)


def draw_residuals(size: tuple[int, int], places: Array, errors: Array) -> tuple[Markup, float]:
    """Draw where each corner was found from where the camera predicts it, and the local means.

    Args:
        size: width, height of the photos, px.
        places: corners [N, 2] px.
        errors: found less predicted [N, 2] px.

    Returns:
        The drawing, and how many times longer its arrows are than the errors.
    """
    scale, height = _scale(size)
    usual = float(np.percentile(np.linalg.norm(errors, axis=-1), 95))
    longer = LONGEST_ARROW / max(usual * scale, 1e-9)
    step = max(1, math.ceil(len(places) / MOST_ARROWS))
    thin = _arrows(places[::step], errors[::step], scale, longer, "each")
    thick = _arrows(*_cell_means(size, places, errors), scale, longer, "mean")
    title = f"the errors of {len(places)} corners, {longer:.0f} times longer than they are"
    frame = tag("rect", x=0, y=0, width=WIDTH, height=height, class_="frame")
    return picture(WIDTH, height, title, frame, *thin, *thick), longer


def draw_uncertainty(size: tuple[int, int], std: Array) -> Markup:
    """Draw how uncertain it is where the camera shows a point of the scene.

    Args:
        size: width, height of the photos, px.
        std: px at places spread over the picture from edge to edge [R, C]; NaN where nothing is
            known.
    """
    _, height = _scale(size)
    rows, columns = std.shape
    across, down = WIDTH / columns, height / rows
    most = max(float(np.nanmax(std, initial=0.0)), 1e-12)
    cells = []
    for row, column in np.ndindex(std.shape):
        value = float(std[row, column])
        place = {"x": column * across, "y": row * down, "width": across, "height": down}
        if math.isfinite(value):
            shade = 0.06 + 0.9 * math.sqrt(value / most)  # one bad corner does not hide the rest
            cells.append(tag("rect", **place, class_="heat", fill_opacity=shade))
        else:
            cells.append(tag("rect", **place, class_="unknown"))
    frame = tag("rect", x=0, y=0, width=WIDTH, height=height, class_="frame")
    title = f"from {float(np.nanmin(std, initial=most)):.2g} to {most:.2g} px"
    return picture(WIDTH, height, title, *cells, frame, *_marks(std, across, down))


def draw_curves(curves: Sequence[tuple[str, Array, Array, Array]]) -> Markup:
    """Draw inverse response curves with a band of two standard deviations.

    Args:
        curves: of each channel its name (a class of the style sheet: r, g, b), brightness,
            light and standard deviation, each [K] from 0 to 1.
    """
    side = WIDTH * 0.75
    parts = [tag("rect", x=0, y=0, width=WIDTH, height=side, class_="frame")]
    parts += [
        tag("line", x1=0, y1=side, x2=WIDTH, y2=0.0, class_="guide"),
        tag("text", "brightness stored", x=WIDTH / 2, y=side - 8, class_="count"),
        tag("text", "light", x=8, y=24, class_="count"),
    ]
    for name, brightness, light, std in curves:
        x = WIDTH * brightness
        above, below = side * (1 - light - 2 * std), side * (1 - light + 2 * std)
        band = [*zip(x, above, strict=True), *zip(x[::-1], below[::-1], strict=True)]
        parts.append(tag("polygon", points=_points(band), class_=f"band {name}"))
        line = [*zip(x, side * (1 - light), strict=True)]
        parts.append(tag("polyline", points=_points(line), class_=f"curve {name}"))
    return picture(WIDTH, side, "light for each stored brightness, by channel", *parts)


def _scale(size: tuple[int, int]) -> tuple[float, float]:
    """Units per pixel, and the height of the drawing."""
    scale = WIDTH / size[0]
    return scale, size[1] * scale


def _placed(pixels: Array, scale: float) -> Array:
    """Pixels [N, 2], counted from the centre of the first, in units from its outer corner."""
    return np.asarray((pixels + 0.5) * scale)


def _arrows(places: Array, errors: Array, scale: float, longer: float, kind: str) -> list[Markup]:
    """Lines with a dot where the camera predicts the corner."""
    starts = _placed(places, scale)
    length = np.maximum(np.linalg.norm(errors, axis=-1, keepdims=True) * scale * longer, 1e-9)
    ends = starts + errors * scale * longer * np.minimum(1, MOST_LONG * LONGEST_ARROW / length)
    drawn = []
    for (x1, y1), (x2, y2) in zip(starts.tolist(), ends.tolist(), strict=True):
        drawn.append(tag("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=f"arrow {kind}"))
        if kind == "mean":
            drawn.append(tag("circle", cx=x1, cy=y1, r=2.2, class_="foot"))
    return drawn


def _cell_means(size: tuple[int, int], places: Array, errors: Array) -> tuple[Array, Array]:
    """Mean place and error of the corners in each part of the picture that holds enough."""
    cells = ((places + 0.5) / np.array(size) * np.array(CELLS)).astype(int)
    index = np.clip(cells, 0, np.array(CELLS) - 1) @ np.array([1, CELLS[0]])
    many = np.bincount(index, minlength=CELLS[0] * CELLS[1])
    good = many >= FEWEST_IN_CELL

    def mean(values: Array) -> Array:
        sums = [np.bincount(index, values[:, axis], len(many)) for axis in (0, 1)]
        return np.stack(sums, axis=-1)[good] / many[good, None]

    return mean(places), mean(errors)


def _marks(std: Array, across: float, down: float) -> list[Markup]:
    """Write the value into some cells, spread over the picture."""
    rows, columns = std.shape
    marks = []
    for row in np.unique(np.linspace(0, rows - 1, 4).round().astype(int)):
        for column in np.unique(np.linspace(1, columns - 2, 5).round().astype(int)):
            value = float(std[row, column])
            if math.isfinite(value):
                marks.append(
                    tag(
                        "text",
                        f"{value:.2g}",
                        x=(column + 0.5) * across,
                        y=(row + 0.5) * down + 6,
                        class_="count middle",
                    )
                )
    return marks


def _points(pairs: "Sequence[tuple[float, float]]") -> str:
    return " ".join(f"{x:.4g},{y:.4g}" for x, y in pairs)
