import re

import cv2
import numpy as np
import pytest

from calibration.board import Board, BoardRequest
from calibration.board_page import PAPERS, board_page, command, completed, write_board
from calibration.checkers import find_corners, glance, size_of
from calibration.markers import COMMON, find_charuco, find_markers, layout_of
from toolkit.errors import ConfigError

PX_PER_MM = 5
POINT = 25.4 / 72  # mm
CHARUCO = Board(kind="charuco", columns=6, rows=4)


def content_of(data):
    """The drawing of the page; the lengths and places the file states are checked on the way."""
    starts = [int(s) for s in re.findall(rb"(\d{10}) 00000 n", data)]
    for number, start in enumerate(starts, start=1):
        assert data[start:].startswith(b"%d 0 obj\n" % number)
    table = int(re.search(rb"startxref\n(\d+)\n%%EOF", data)[1])
    assert data[table:].startswith(b"xref\n")
    stream = re.search(rb"/Length (\d+) >>\nstream\n(.*?)\nendstream", data, re.DOTALL)
    assert len(stream[2]) == int(stream[1])
    return stream[2].decode("cp1252")


def size_on_paper(data):
    width, height = re.search(rb"/MediaBox \[0 0 (\S+) (\S+)\]", data).groups()
    return float(width) * POINT, float(height) * POINT


def rectangles_of(data):
    """Rectangles in mm from the top left [N, 4], through the page's own matrix."""
    content = content_of(data)
    a, b, c, d, e, f = map(float, re.match(r"(\S+ \S+ \S+ \S+ \S+ \S+) cm", content)[1].split())
    assert (b, c) == (0, 0)
    x, y, w, h = np.array(re.findall(r"(\S+) (\S+) (\S+) (\S+) re", content), dtype=float).T
    height = size_on_paper(data)[1]
    left, top = (a * x + e) * POINT, height - (d * y + f) * POINT
    return np.stack([left, top, a * w * POINT, -d * h * POINT], axis=-1)


def raster(data):
    """The page as a picture; every pixel is as dark as the share of it that is covered."""
    width, height = (round(PX_PER_MM * side) for side in size_on_paper(data))
    ink = np.zeros((height, width))
    for x, y, w, h in rectangles_of(data) * PX_PER_MM:
        rows = np.arange(int(y), min(int(y + h) + 2, height))
        columns = np.arange(int(x), min(int(x + w) + 2, width))
        part = np.outer(covered(rows, y, y + h), covered(columns, x, x + w))
        ink[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += part
    return (255 * (1 - np.clip(ink, 0, 1))).astype(np.float32)


def covered(cells, low, high):
    return np.clip(np.minimum(cells + 1, high) - np.maximum(cells, low), 0, 1)


def in_mm(corners):
    return (corners + 0.5) / PX_PER_MM


def distance_from_grid(corners, ids, columns, square):
    """Largest distance, mm, of corners from a grid of `square` mm that may only be shifted."""
    grid = square * np.stack([ids % columns, ids // columns], axis=-1)
    gaps = in_mm(corners) - grid
    return np.abs(gaps - gaps.mean(axis=0)).max()


@pytest.mark.parametrize("paper", ["a4", "letter", "a3"])
def test_a_printed_checkerboard_is_found_at_true_scale(tmp_path, paper):
    made = write_board(tmp_path / "b.pdf", Board(columns=9, rows=6), paper=paper)
    data = (tmp_path / "b.pdf").read_bytes()
    assert sorted(size_on_paper(data)) == pytest.approx(sorted(PAPERS[paper]), abs=1e-4)
    picture = raster(data)
    assert size_of(glance(picture)) == (9, 6)
    (corners,) = find_corners(picture, (9, 6))
    square = 1000 * made.square_m
    assert square == int(square) >= 20
    assert distance_from_grid(corners.reshape(-1, 2), np.arange(54), 9, square) < 0.01


def test_a_printed_charuco_board_is_told_and_found_at_true_scale(tmp_path):
    made = write_board(tmp_path / "b.pdf", CHARUCO)
    picture = raster((tmp_path / "b.pdf").read_bytes())
    markers = find_markers(picture, COMMON)
    assert markers.dictionary == "DICT_5X5_50"  # the first fifty of DICT_5X5_250
    assert sorted(markers.ids) == list(range(17))
    layout = layout_of(markers)
    assert layout.squares_x == 7
    assert not layout.is_legacy
    assert layout.marker_share == pytest.approx(made.marker_m / made.square_m, abs=0.01)
    corners, ids = find_charuco(picture, layout, markers)
    assert sorted(ids) == list(range(24))
    assert distance_from_grid(corners, ids, 6, 1000 * made.square_m) < 0.01


def test_markers_are_those_of_opencv(tmp_path):
    made = write_board(tmp_path / "b.pdf", CHARUCO)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    board = cv2.aruco.CharucoBoard((7, 5), made.square_m, made.marker_m, dictionary)
    side = round(1000 * made.square_m * PX_PER_MM)
    theirs = board.generateImage((7 * side, 5 * side))
    picture = raster((tmp_path / "b.pdf").read_bytes())
    left, top = (rectangles_of((tmp_path / "b.pdf").read_bytes())[0, :2] * PX_PER_MM).round()
    ours = picture[int(top) :, int(left) :][: 5 * side, : 7 * side]
    assert (np.abs(ours - theirs) > 200).mean() < 0.01  # edges fall differently on pixels


def test_the_ruler_is_a_hundred_millimetres(tmp_path):
    write_board(tmp_path / "b.pdf", Board(columns=9, rows=6))
    x, _, width, height = rectangles_of((tmp_path / "b.pdf").read_bytes()).T
    bar = np.argmax(width)
    assert width[bar] == pytest.approx(100, abs=1e-3)
    is_tick = (width < 0.2) & (height > 1)
    assert is_tick.sum() == 101
    middles = np.sort(x[is_tick] + width[is_tick] / 2) - x[bar]
    np.testing.assert_allclose(middles[1:-1], np.arange(1, 100), atol=1e-3)
    assert x[is_tick].min() == pytest.approx(x[bar], abs=1e-3)
    assert (x + width)[is_tick].max() == pytest.approx(x[bar] + 100, abs=1e-3)


def test_name_size_and_command_are_printed(tmp_path):
    made = write_board(tmp_path / "b.pdf", Board(columns=9, rows=6, square_m=0.02))
    printed = content_of((tmp_path / "b.pdf").read_bytes())
    assert r"Checkerboard of 9x6 inner corners \(10x7 squares\), squares 20 mm" in printed
    assert command(made) in printed
    assert "(100) Tj" in printed
    assert command(made).endswith("--board 9x6 --square 0.02")
    charuco = command(completed(CHARUCO, "a4"))
    assert "--board 7x5 --kind charuco --dictionary DICT_5X5_250 --marker 0.0" in charuco


@pytest.mark.parametrize(
    ("board", "message"),
    [
        (Board(columns=9, rows=6, square_m=0.03), "does not fit a4; squares of 22 mm do"),
        (Board(columns=9, rows=6, square_m=25), "square is 25 m; give metres, as 0.025"),
        (Board(kind="charuco", columns=30, rows=30), "needs 480 markers, its dictionary has 250"),
        (
            Board(kind="charuco", columns=6, rows=4, dictionary="DICT_9X9"),
            "--dictionary DICT_9X9 is not known; known are DICT_4X4_100",
        ),
    ],
)
def test_what_cannot_be_printed_is_refused_and_nothing_is_written(tmp_path, board, message):
    path = tmp_path / "b.pdf"
    path.write_text("older")
    with pytest.raises(ConfigError, match=message):
        write_board(path, board)
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]


def test_everything_stays_on_the_page_and_the_board_keeps_white_around():
    for board in (Board(columns=9, rows=6), Board(columns=3, rows=12), CHARUCO):
        page = board_page(completed(board, "a4"), "a4")
        x, y, w, h = np.array(page.rectangles).T
        assert min(x.min(), y.min()) >= 9.999
        assert (x + w).max() <= page.width - 9.999
        assert (y + h).max() <= page.height - 5
        assert max(word.y for word in page.words) <= page.height - 5


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"columns": 9, "rows": 2}, "board 9x2 must have from 3 to 99"),
        ({"columns": 9, "rows": 6, "square_m": 0.0}, "square is 0.0 m; a positive length"),
        (
            {"kind": "charuco", "columns": 4, "rows": 6, "square_m": 0.02, "marker_m": 0.02},
            "marker 0.02 m does not fit into a square of 0.02 m",
        ),
    ],
)
def test_impossible_boards_are_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        Board(**settings)


def test_a_request_takes_sizes_and_boards():
    assert BoardRequest.of((6, 9)).size == (6, 9)
    assert BoardRequest.of(None).kind is None
    assert BoardRequest(dictionary="DICT_5X5_250").kind == "charuco"
    assert BoardRequest.of(CHARUCO).size == (7, 5)
    with pytest.raises(ConfigError, match="a checkerboard has no markers"):
        BoardRequest(kind="checker", marker_m=0.01)


def test_half_a_turn_shows_where_the_counts_differ_by_one():
    assert not Board(columns=9, rows=6).turns_onto_itself
    assert Board(columns=8, rows=6).turns_onto_itself
    assert Board(columns=7, rows=5).turns_onto_itself
    assert not CHARUCO.turns_onto_itself
