"""Find the inner corners of a calibration board in photos.

A checkerboard of C x R inner corners is named long side first, (9, 6) for nine by six: once a board
is turned, nothing tells 9x6 from 6x9.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from calibration.board import Board, BoardRequest
from calibration.board_notes import board_notes
from calibration.checkers import (
    find_any,
    find_corners,
    glance,
    most_common,
    refine_corners,
    size_of,
)
from calibration.edges import clipped_share, edges_of
from calibration.markers import COMMON, Layout, find_charuco, find_markers, larger_of
from calibration.survey import Survey, survey
from calibration.view import View
from calibration.view_checks import check_together
from calibration.workers import in_parallel
from toolkit.errors import ConfigError, ImageError
from toolkit.files import sha256
from toolkit.imaging.brightness import Brightness, read_brightness
from toolkit.measurement import Caution

__all__ = [
    "BoardSearch",
    "View",
    "find_boards",
    "find_corners",
    "most_common",
    "refine_corners",
    "search_boards",
]

FEWEST_CORNERS = 6
"""Of a partial view; they must stand in two rows and two columns at least."""
MARKER_REACH = 0.8
"""How far profiles of edges reach into the white gap beside a marker."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSearch:
    """What many photos of one board show."""

    views: tuple[View, ...]  # one per photo, in the order given
    board: Board | None = None  # None where no photo shows one
    cautions: tuple[Caution, ...] = ()  # about the board, as it was named and as it was found


def find_boards(
    images: Sequence[Path],
    *,
    board: tuple[int, int] | Board | BoardRequest | None = None,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> tuple[View, ...]:
    """Find one board in many photos; see `search_boards`."""
    return search_boards(images, board=board, on_photo=on_photo).views


def search_boards(
    images: Sequence[Path],
    *,
    board: tuple[int, int] | Board | BoardRequest | None = None,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> BoardSearch:
    """Find one board in many photos.

    Without `board` the first photos are glanced at until two are read alike; the rest is searched
    for that board. Where fewer than half show it, all are read again more carefully.

    Args:
        images: photos, RAW or not; a few are held in memory at a time.
        board: inner corners along the two sides of a checkerboard in any order, or what else is
            known of the board.
        on_photo: called after each photo is read.

    Returns:
        One view per photo in the same order. Those that are unreadable, twice there, blurred,
        overexposed, without the board or of another picture size carry the reason; the others have
        `corners` of one board.

    Raises:
        ConfigError: when the markers' dictionary is not known.
    """
    request = BoardRequest.of(board)
    blank = _distinct(images)
    paths = [view.path for view in blank if view.is_used]
    seen = survey(paths, request)
    if seen.kind == "charuco":
        search = _charuco_search(seen, request)
    else:
        search = _checker_search(seen, request)
    views = _look_at_all(blank, search, on_photo)
    if seen.kind == "checker" and request.size is None:
        views = _read_again(blank, views, seen)
    checked = check_together(_of_one_board(views, request))
    found = next((view.target for view in checked if view.target), None)
    return BoardSearch(views=checked, board=found, cautions=board_notes(checked, seen, request))


Search = Callable[[View, Brightness], View]


def _distinct(images: Sequence[Path]) -> list[View]:
    """Blank views, with the reason where a file cannot be opened or came before."""
    views: list[View] = []
    first_of: dict[str, Path] = {}
    for path in images:
        try:
            digest = sha256(path)
        except OSError as error:
            views.append(View(path=path, reason=f"cannot be read ({error.strerror})"))
            continue
        first = first_of.setdefault(digest, path)
        is_first = not any(view.path is first for view in views)
        reason = "" if is_first else f"the same file as {first}, counted once"
        views.append(View(path=path, reason=reason))
    return views


def _look_at_all(
    blank: Sequence[View], search: Search, on_photo: Callable[[Path], None] = lambda path: None
) -> list[View]:
    views = []
    for view in in_parallel(partial(_look, search=search), blank):
        on_photo(view.path)
        views.append(view)
    return views


def _look(view: View, search: Search) -> View:
    if not view.is_used:
        return view
    try:
        picture = read_brightness(view.path)
    except ImageError as error:
        return replace(view, reason=str(error))
    except ConfigError:  # without a frame's number only a video has this
        return replace(view, reason="is no single picture; save frames of a video as PNG")
    return search(replace(view, picture_size=picture.size), picture)


def _checker_search(seen: Survey, request: BoardRequest) -> Search:
    size = seen.size if request.size is None else _long_first(request.size)
    if size is None:
        return partial(_miss, reason="no board found")
    other = seen.size if seen.is_sure and seen.size != size else None
    return partial(_find_checker, size=size, other=other)


def _miss(view: View, picture: Brightness, reason: str) -> View:
    return replace(view, reason=reason)


def _find_checker(
    view: View,
    picture: Brightness,
    size: tuple[int, int],
    other: tuple[int, int] | None = None,
) -> View:
    # where photos agree on another board, the slow detector would only confirm that
    found = find_corners(picture.grey, size, is_thorough=other is None)
    if not found:
        return replace(view, reason=_why_not(picture, size, other))
    target = Board(columns=size[0], rows=size[1])
    view = replace(view, board=size, target=target, corners=found[0].reshape(-1, 2))
    return _with_quality(view, picture)


def _why_not(picture: Brightness, size: tuple[int, int], other: tuple[int, int] | None) -> str:
    text = f"no board of {size[0]}x{size[1]} inner corners found"
    if other is not None:
        text += f"; the photos show {other[0]}x{other[1]}"
        is_squares = (other[0] + 1, other[1] + 1) == size
        return text + (": count inner corners, not squares" if is_squares else ": name that size")
    part = glance(picture.grey)
    if part is None or size_of(part) == size:
        return text
    columns, rows = size_of(part)
    return (
        f"{text}, but perhaps {columns}x{rows}: a checkerboard must be wholly in view, with white"
        " around it; a ChArUco board may be cut"
    )


def _read_again(blank: Sequence[View], views: list[View], seen: Survey) -> list[View]:
    """Let all photos say carefully what board they show, where too few show that of the first."""
    readable = [i for i, view in enumerate(views) if view.picture_size is not None]
    if 2 * sum(views[i].is_used for i in readable) >= len(readable) > 0:
        return views
    votes = [
        size for sizes in in_parallel(_read_sizes, [views[i] for i in readable]) for size in sizes
    ]
    size = most_common(votes)
    if size is None or size == seen.size:
        return views
    search = partial(_find_checker, size=size)
    again = iter(_look_at_all([blank[i] for i in readable], search))
    return [next(again) if i in readable else view for i, view in enumerate(views)]


def _read_sizes(view: View) -> list[tuple[int, int]]:
    return [size_of(corners) for corners in find_any(read_brightness(view.path).grey)]


def _charuco_search(seen: Survey, request: BoardRequest) -> Search:
    layout = seen.layout
    if layout is None and request.size is not None and request.dictionary is not None:
        # too few markers in each photo to tell: what was said must do
        share = request.marker_share or 0.5
        layout = Layout(
            dictionary=request.dictionary, squares_x=request.size[0], marker_share=share
        )
    if layout is None:
        names = request.dictionary or ", ".join(COMMON)
        return partial(_miss, reason=f"no ChArUco board found; markers sought: {names}")
    if request.dictionary is None:
        layout = replace(layout, dictionary=larger_of(layout.dictionary))
    return partial(_find_charuco, layout=layout)


def _find_charuco(view: View, picture: Brightness, layout: Layout) -> View:
    markers = find_markers(picture.grey, [layout.dictionary])
    if markers is None:
        return replace(view, reason=f"no marker of {layout.dictionary} found")
    corners, ids = find_charuco(picture.grey, layout, markers)
    columns = layout.squares_x - 1
    if len(ids) < FEWEST_CORNERS or min(np.ptp(ids // columns), np.ptp(ids % columns)) < 1:
        text = f"only {len(ids)} corners of the ChArUco board found, {FEWEST_CORNERS} in two rows"
        return replace(view, reason=f"{text} are needed; show more of it, nearer or sharper")
    target = Board(
        kind="charuco",
        columns=columns,
        rows=int(ids.max()) // columns + 1,
        dictionary=layout.dictionary,
    )
    view = replace(view, board=target.size, target=target, corners=corners, ids=ids)
    return _with_quality(view, picture, reach=MARKER_REACH * (1 - layout.marker_share) / 2)


def _with_quality(view: View, picture: Brightness, reach: float = 0.3) -> View:
    assert view.corners is not None  # for the type checker
    edges = edges_of(picture.grey, view.grid, reach=reach)
    if not np.isfinite(edges.widths).all():
        return view
    return replace(
        view,
        edge_px=edges.widths,
        edge_shift_px=edges.shift,
        clipped_share=clipped_share(picture.clipped, view.corners),
    )


def _of_one_board(views: Sequence[View], request: BoardRequest) -> list[View]:
    """Give all views the one board: a partial one shows fewer rows than there are."""
    targets = [view.target for view in views if view.target is not None]
    if not targets:
        return list(views)
    rows = max(target.rows for target in targets)
    if targets[0].kind == "charuco" and request.size and request.size[0] == targets[0].squares[0]:
        rows = max(rows, request.size[1] - 1)
    board = replace(targets[0], rows=rows, square_m=request.square_m, marker_m=request.marker_m)
    return [
        view if view.target is None else replace(view, target=board, board=board.size)
        for view in views
    ]


def _long_first(size: tuple[int, int]) -> tuple[int, int]:
    return max(size), min(size)
