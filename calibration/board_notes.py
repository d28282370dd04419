"""What to say about a board once it was found: named wrongly, alike when turned, of odd lengths."""

from collections.abc import Sequence

from calibration.board import Board, BoardRequest
from calibration.survey import Survey
from calibration.view import View
from toolkit.measurement import Caution

SHARE_TOLERANCE = 0.1
"""Share by which marker over square, as measured in the photos, may differ from what was given.

Blur makes black frames look up to 3 % small.
"""
USUAL_SQUARES = (1e-3, 0.5)
"""Sides of squares, metre, outside which another unit was probably meant."""


def board_notes(views: Sequence[View], seen: Survey, request: BoardRequest) -> tuple[Caution, ...]:
    """Say what the reader should know about the board, each thing once."""
    board = next((view.target for view in views if view.target is not None), None)
    notes = [_square_note(request)]
    if board is None:
        pass
    elif board.kind == "charuco":
        notes += [_charuco_size_note(board, request), _share_note(seen, request)]
    else:
        notes += [_checker_size_note(board, seen, request), _symmetry_note(board)]
    return tuple(note for note in notes if note is not None)


def _square_note(request: BoardRequest) -> Caution | None:
    square = request.square_m
    if square is None or USUAL_SQUARES[0] <= square <= USUAL_SQUARES[1]:
        return None
    text = f"a square of {square:g} m is unusual; give metres, 0.025 for 25 mm (only poses use it)"
    return Caution(code="square_size", message=text)


def _checker_size_note(board: Board, seen: Survey, request: BoardRequest) -> Caution | None:
    if request.size is None:
        return None
    named = f"{request.size[0]}x{request.size[1]}"
    if seen.is_sure and seen.size is not None and seen.size != board.size:
        text = f"the photos show {seen.size[0]}x{seen.size[1]} inner corners, not {named};"
        return Caution(code="board_size", message=f"{text} the corners beyond that are not used")
    if request.size != board.size:
        text = f"board {named} is taken as {board.columns}x{board.rows}, long side first: once it"
        return Caution(
            code="board_swapped", message=f"{text} is turned nothing tells the two apart"
        )
    return None


def _charuco_size_note(board: Board, request: BoardRequest) -> Caution | None:
    if request.size is None or request.size == board.squares:
        return None
    text = (
        f"the markers show a board of {board.squares[0]}x{board.squares[1]} squares, not"
        f" {request.size[0]}x{request.size[1]}"
    )
    if request.size == board.squares[::-1]:
        return Caution(code="board_swapped", message=f"{text}: the sides were swapped")
    return Caution(code="board_size", message=f"{text}; what they show was used")


def _share_note(seen: Survey, request: BoardRequest) -> Caution | None:
    given = request.marker_share
    if given is None or seen.layout is None:
        return None
    measured = seen.layout.marker_share
    if abs(measured / given - 1) <= SHARE_TOLERANCE:
        return None
    text = (
        f"in the photos markers are {measured:.2f} of a square wide, but the lengths given say"
        f" {given:.2f}; measure both again (only poses use them)"
    )
    return Caution(code="marker_size", message=text)


def _symmetry_note(board: Board) -> Caution | None:
    if not board.turns_onto_itself:
        return None
    turn = "quarter" if board.columns == board.rows else "half"
    text = (
        f"a {board.columns}x{board.rows} board looks the same after {turn} a turn: harmless for"
        " the lens, but poses are open to it; one side odd and one even, as 9x6, tells"
    )
    return Caution(code="symmetric_board", message=text)
