"""Lay a board out on paper: its squares and markers, a ruler to check the print, and what it is."""

import math
from dataclasses import replace
from pathlib import Path

from calibration.board import Board
from calibration.pdf import Page, Word, pdf_of
from toolkit.errors import ConfigError
from toolkit.files import write_whole

Rectangle = tuple[float, float, float, float]

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4), "a3": (297.0, 420.0)}
"""Width and height, mm."""
MARGIN = 10.0
"""White around the board, mm: detectors need it, and printers leave the rim white anyway."""
FOOT = 36.0
"""Room below the board for the ruler and the words, mm."""
RULER = 100
"""Length of the ruler, mm."""
HAIRLINE = 0.15
MARKER_SHARE = 0.7
"""Side of a marker over that of a square, where it is not given; leaves a bit's width of white."""
DICTIONARY = "DICT_5X5_250"
LARGEST_SQUARE = 0.4
"""Metre; above, another unit was meant."""


def write_board(path: Path, board: Board, *, paper: str = "a4") -> Board:
    """Write a board as a PDF at true scale.

    Args:
        path: the new file; it appears whole or not at all.
        board: what to print; a missing side of squares becomes the largest whole mm that fits, a
            missing dictionary and side of markers usual ones.
        paper: "a4", "letter" or "a3".

    Returns:
        The board with all its lengths.

    Raises:
        ConfigError: when it does not fit the paper, or has more markers than the dictionary.
        EnvironmentFault: when the file cannot be written.
    """
    board = completed(board, paper)
    with write_whole(path) as temporary:
        temporary.write_bytes(pdf_of(board_page(board, paper), str(board)))
    return board


def completed(board: Board, paper: str) -> Board:
    """Fill in the lengths and the dictionary that are not given, and check that the board fits.

    Raises:
        ConfigError: when it does not.
    """
    largest = _largest_square(board, paper)
    if board.square_m is None:
        board = replace(board, square_m=math.floor(largest) / 1000)
    if board.square_m is None or not 0 < board.square_m <= LARGEST_SQUARE:
        raise ConfigError(f"square is {board.square_m} m; give metres, as 0.025 for 25 mm")
    if board.square_m * 1000 > largest + 1e-9:
        raise ConfigError(
            f"a {board} of {board.square_m * 1000:g} mm squares does not fit {paper}; squares of"
            f" {math.floor(largest)} mm do, or take larger paper or fewer squares"
        )
    if board.kind == "charuco":
        board = replace(
            board,
            dictionary=board.dictionary or DICTIONARY,
            marker_m=board.marker_m or round(MARKER_SHARE * board.square_m, 4),
        )
        _check_markers(board)
    return board


def board_page(board: Board, paper: str) -> Page:
    """Lay out a board whose lengths are all given; the first square, top left, is black."""
    width, height = _paper_size(board, paper)
    square = 1000 * (board.square_m or 0)
    columns, rows = board.squares
    left, top = (width - columns * square) / 2, (height - FOOT - rows * square) / 2
    ink = [
        (left + x * square, top + y * square, square, square)
        for y in range(rows)
        for x in range(columns)
        if (x + y) % 2 == 0
    ]
    if board.kind == "charuco":
        ink += _markers(board, left, top)
    ruler, numbers = _ruler(MARGIN, height - FOOT + 8)
    words = [
        Word(x=MARGIN, y=height - FOOT + 17 + 4.2 * line, text=text, height=3.2)
        for line, text in enumerate(_told(board))
    ]
    return Page(width=width, height=height, rectangles=ink + ruler, words=[*numbers, *words])


def command(board: Board) -> str:
    """Give the command that calibrates from photos of this board."""
    size = board.squares if board.kind == "charuco" else board.size
    words = f"toolkit calibrate --images photos/*.jpg --board {size[0]}x{size[1]}"
    if board.kind == "charuco":
        words += f" --kind charuco --dictionary {board.dictionary} --marker {board.marker_m:g}"
    return f"{words} --square {board.square_m:g}"


def _told(board: Board) -> list[str]:
    square = 1000 * (board.square_m or 0)
    if board.kind == "charuco":
        name = f"{board}, squares {square:g} mm, markers {1000 * (board.marker_m or 0):g} mm"
    else:
        columns, rows = board.squares
        name = f"Checker{board} ({columns}x{rows} squares), squares {square:g} mm"
    return [
        name,
        "Print at 100 %; the bar above must then be 100 mm long. Glue it flat on a stiff plate.",
        "Measure a row of squares; --square is its length over their number. With 10 to 20 photos:",
        command(board),
    ]


def _ruler(left: float, top: float) -> tuple[list[Rectangle], list[Word]]:
    """Millimetre ticks over a bar that is exactly 100 mm long, with a number every 10."""
    bars = [(left, top, float(RULER), HAIRLINE)]
    for mm in range(RULER + 1):
        tick = 4.5 if mm % 10 == 0 else 3.2 if mm % 5 == 0 else 2.0
        # the outer ticks end with the bar, so that it may be measured from edge to edge
        x = min(max(left + mm - HAIRLINE / 2, left), left + RULER - HAIRLINE)
        bars.append((x, top - tick, HAIRLINE, tick))
    numbers = [
        Word(x=left + mm - 0.8 * len(str(mm)), y=top + 3.2, text=str(mm), height=2.8)
        for mm in range(0, RULER + 1, 10)
    ]
    return bars, [*numbers, Word(x=left + RULER + 4, y=top + 3.2, text="mm", height=2.8)]


def _markers(board: Board, left: float, top: float) -> list[Rectangle]:
    """Black bits of the markers in the white squares, numbered row by row, as runs along x."""
    import cv2

    from calibration.markers import dictionary_named

    dictionary = dictionary_named(board.dictionary or DICTIONARY)
    bits = dictionary.markerSize + 2
    square, side = 1000 * (board.square_m or 0), 1000 * (board.marker_m or 0)
    bit, gap = side / bits, (square - side) / 2
    whites = [
        (x, y) for y in range(board.squares[1]) for x in range(board.squares[0]) if (x + y) % 2
    ]
    ink = []
    for number, (column, row) in enumerate(whites):
        is_black = cv2.aruco.generateImageMarker(dictionary, number, bits) == 0
        x, y = left + column * square + gap, top + row * square + gap
        for line, values in enumerate(is_black.tolist()):
            ink += [
                (x + bit * first, y + bit * line, bit * (last - first), bit)
                for first, last in _runs(values)
            ]
    return ink


def _runs(values: list[bool]) -> list[tuple[int, int]]:
    """Where a row is black, from the first cell to that after the last."""
    edges = [False, *values, False]
    changes = [i for i in range(len(values) + 1) if edges[i] != edges[i + 1]]
    return list(zip(changes[::2], changes[1::2], strict=True))


def _check_markers(board: Board) -> None:
    from calibration.markers import dictionary_named

    there_are = len(dictionary_named(board.dictionary or DICTIONARY).bytesList)
    needed = board.squares[0] * board.squares[1] // 2
    if needed > there_are:
        raise ConfigError(
            f"a {board} needs {needed} markers, its dictionary has {there_are}; take a larger one"
        )


def _paper_size(board: Board, paper: str) -> tuple[float, float]:
    """Width and height, mm, of paper turned so that the board may be largest."""
    if paper not in PAPERS:
        raise ConfigError(f"paper '{paper}' is not known; known are {', '.join(PAPERS)}")
    short, tall = PAPERS[paper]
    return max(((short, tall), (tall, short)), key=lambda size: _room(board, size))


def _room(board: Board, size: tuple[float, float]) -> float:
    """Side of the largest square, mm."""
    columns, rows = board.squares
    return min((size[0] - 2 * MARGIN) / columns, (size[1] - FOOT - 2 * MARGIN) / rows)


def _largest_square(board: Board, paper: str) -> float:
    largest = _room(board, _paper_size(board, paper))
    if largest < 1:
        raise ConfigError(f"a {board} does not fit {paper} in squares of a millimetre or more")
    return largest
