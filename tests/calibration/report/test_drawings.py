import xml.etree.ElementTree as ET

import numpy as np
import pytest

from calibration.report.drawings import (
    LONGEST_ARROW,
    MOST_ARROWS,
    MOST_LONG,
    WIDTH,
    draw_coverage,
    draw_curves,
    draw_residuals,
    draw_uncertainty,
)

SIZE = (640, 480)


def parts(drawing, name, kind=None):
    """The elements of one name, and of one class where one is asked for."""
    root = ET.fromstring(drawing)
    found = root.findall(f"{{http://www.w3.org/2000/svg}}{name}")
    return [one for one in found if kind is None or kind in one.get("class", "").split()]


def numbers(element, *names):
    return np.array([float(element.get(name)) for name in names])


def test_coverage_shows_every_corner_where_it_was_and_marks_empty_cells():
    counts = np.zeros((5, 5), dtype=int)
    counts[0, 0], counts[4, 4] = 1, 2
    corners = [np.array([[0.0, 0.0], [639.0, 479.0]]), np.array([[630.0, 470.0]])]
    drawing = draw_coverage(SIZE, corners, counts)
    dots = parts(drawing, "circle", "dot")
    assert [tuple(numbers(dot, "cx", "cy")) for dot in dots] == [
        (0.5, 0.5),
        (639.5, 479.5),
        (630.5, 470.5),
    ]
    assert len(parts(drawing, "rect", "empty")) == 23
    assert [text.text for text in parts(drawing, "text")].count("0") == 23
    assert "3 corners; 23 of 25 cells are empty" in drawing


def test_arrows_point_where_the_errors_do():
    places = np.array([[100.0, 100.0], [300.0, 200.0]])
    errors = np.array([[0.1, 0.0], [0.0, -0.1]])
    drawing, longer = draw_residuals(SIZE, places, errors)
    first, second = parts(drawing, "line", "each")
    assert np.allclose(numbers(first, "x1", "y1"), [100.5, 100.5])
    assert np.allclose(numbers(first, "x2", "y2") - numbers(first, "x1", "y1"), [LONGEST_ARROW, 0])
    assert np.allclose(
        numbers(second, "x2", "y2") - numbers(second, "x1", "y1"), [0, -LONGEST_ARROW]
    )
    assert longer == pytest.approx(LONGEST_ARROW / 0.1)


def test_a_common_error_of_a_part_of_the_picture_is_seen_through_its_noise():
    generator = np.random.default_rng(0)
    places = generator.uniform([0, 0], SIZE, (4000, 2))
    errors = generator.normal([0.05, 0.0], 0.1, (4000, 2))
    drawing, longer = draw_residuals(SIZE, places, errors)
    means = parts(drawing, "line", "mean")
    shift = np.mean([numbers(m, "x2", "y2") - numbers(m, "x1", "y1") for m in means], axis=0)
    assert len(means) == 16 * 12
    assert shift / longer == pytest.approx([0.05, 0.0], abs=0.01)
    assert len(parts(drawing, "line", "each")) <= MOST_ARROWS


def test_one_misread_corner_does_not_leave_the_drawing():
    places = np.full((40, 2), 200.0)
    errors = np.full((40, 2), 0.1)
    errors[0] = [50.0, 0.0]
    drawing, _ = draw_residuals(SIZE, places, errors)
    lines = parts(drawing, "line", "each")
    longest = max(np.linalg.norm(numbers(m, "x2", "y2") - numbers(m, "x1", "y1")) for m in lines)
    assert longest == pytest.approx(MOST_LONG * LONGEST_ARROW, rel=1e-3)


def test_errors_of_nothing_at_all_are_drawn_as_dots():
    drawing, longer = draw_residuals(SIZE, np.array([[1.0, 1.0]]), np.zeros((1, 2)))
    assert np.isfinite(longer)
    (line,) = parts(drawing, "line")
    assert np.allclose(numbers(line, "x1", "y1"), numbers(line, "x2", "y2"))


def test_the_map_is_darkest_where_least_is_known_and_open_where_nothing_is():
    std = np.full((6, 8), 0.1)
    std[0, 0], std[5, 7] = 1.0, np.nan
    drawing = draw_uncertainty(SIZE, std)
    shades = [float(cell.get("fill-opacity")) for cell in parts(drawing, "rect", "heat")]
    assert shades.index(max(shades)) == 0
    assert len(shades) == 47
    assert len(parts(drawing, "rect", "unknown")) == 1
    assert "from 0.1 to 1 px" in drawing


def test_a_map_of_nothing_is_drawn_all_the_same():
    drawing = draw_uncertainty(SIZE, np.full((3, 4), np.nan))
    assert len(parts(drawing, "rect", "unknown")) == 12


def test_curves_go_from_the_lower_left_to_the_upper_right():
    ramp = np.linspace(0, 1, 5)
    drawing = draw_curves([("r", ramp, ramp**2, np.full(5, 0.01)), ("b", ramp, ramp, 0 * ramp)])
    red, _blue = parts(drawing, "polyline")
    points = np.array([pair.split(",") for pair in red.get("points").split()], dtype=float)
    assert points[0] == pytest.approx([0, 0.75 * WIDTH])
    assert points[-1] == pytest.approx([WIDTH, 0])
    assert len(parts(drawing, "polygon", "r")) == 1
