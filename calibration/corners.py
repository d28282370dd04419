"""Find the inner corners of a checkerboard in photos.

A board of C x R inner corners is named long side first, (9, 6) for nine by six: once a board is
turned, nothing tells 9x6 from 6x9.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.board import Board
from toolkit.errors import ConfigError, ImageError
from toolkit.files import sha256
from toolkit.imaging import read_image
from toolkit.types import LinearImage

Pixels = NDArray[np.float64]
Grey = NDArray[np.float32]

SEARCH_SIDES = (1600, 3200)
"""Long side, px, to which a photo is reduced for the search; the second when the first fails."""
WINDOW_SHARE = 0.35
"""Half the refining window over the smallest distance of two corners.

Measured on 13 views 640x480: RMS 0.18 px at 0.3 to 0.4, but 0.46 px and fx 0.7 % off at 0.45, where
the window meets the neighbouring corners; 0.27 px without refining.
"""
WINDOW_LIMITS = (2, 60)
"""Half window, px: less holds too few pixels, more costs seconds a photo.

A soft picture of 25 megapixels (6 of the views above, enlarged 9 times) needs a wide one: RMS over
the enlargement 0.29 px at 25, 0.21 px at 50, 0.19 px at 100.
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """One photo of the board: what was found, how well it fits, or why it is not used."""

    path: Path
    picture_size: tuple[int, int] | None = None  # width, height; None when it cannot be read
    board: tuple[int, int] | None = None  # inner corners: along the long and the short side, or,
    # of a ChArUco board, along x and y
    corners: Pixels | None = None  # [N, 2] px, row by row along x; of a partial view those found
    ids: NDArray[np.int64] | None = None  # [N] which of the board's points they are; None: all
    target: Board | None = None  # what is printed on the board; a checkerboard when None
    rms_px: float | None = None  # distance of the corners from those the camera predicts
    T_cam_board: NDArray[np.float64] | None = None  # [4, 4], in squares, or metres when known
    reason: str = ""  # why it is not used; empty when it is

    @property
    def is_used(self) -> bool:
        """Whether the view takes part in the calibration."""
        return not self.reason

    @property
    def corner_count(self) -> int:
        """How many corners were found."""
        return 0 if self.corners is None else len(self.corners)

    @property
    def points(self) -> NDArray[np.float64]:
        """Where the found corners are on the board, in squares [N, 3]; none without a board."""
        if self.board is None:
            return np.zeros((0, 3))
        target = self.target or Board(columns=self.board[0], rows=self.board[1])
        return target.points() if self.ids is None else target.points()[self.ids]


def find_boards(
    images: Sequence[Path],
    *,
    board: tuple[int, int] | None = None,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> tuple[View, ...]:
    """Find one board in many photos.

    Without `board` every photo is read on its own, twice, for rows are missed or invented in one
    reading out of ten to three; the size most readings agree on is sought again where none has it.

    Args:
        images: photos, RAW or not; one is held in memory at a time.
        board: inner corners along its two sides, in any order, or None.
        on_photo: called after each photo is first read.

    Returns:
        One view per photo in the same order. Those that are unreadable, the same file twice,
        without the board or of another picture size carry the reason; the others have `corners`
        of one board.
    """
    wanted = None if board is None else (max(board), min(board))
    readings: list[_Reading] = []
    first_of: dict[str, Path] = {}
    for path in images:
        readings.append(_read_once(path, wanted, first_of))
        on_photo(path)
    votes = [_size(found) for reading in readings for found in reading.found]
    wanted = wanted or most_common(votes)
    return _of_one_size([_settle(reading, wanted) for reading in readings])


def most_common(items: Sequence[tuple[int, int]]) -> tuple[int, int] | None:
    """Give the most frequent pair, the larger where two are as frequent; None of nothing."""
    counts = Counter(items)
    return max(counts, key=lambda pair: (counts[pair], pair[0] * pair[1]), default=None)


def find_corners(grey: Grey, board: tuple[int, int] | None) -> list[Pixels]:
    """Find a board in one picture and refine its corners.

    Args:
        grey: brightness 0..255 [H, W].
        board: inner corners (long side, short side), or None for any size from 3 x 3.

    Returns:
        Corners [R, C, 2] px with C >= R: none or one reading of a known board, up to two of an
        unknown one. The square between the first four corners is dark where that can be told
        (C + R odd); else the first corner is the one nearest to the picture's.
    """
    whole = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    for side in SEARCH_SIDES:
        reduced = _reduced(whole, side)
        found = _search(reduced, board) if board else _search_any(reduced)
        if found or reduced is whole:
            break
    steps = np.array(whole.shape[::-1]) / reduced.shape[::-1]
    placed = (_oriented((corners + 0.5) * steps - 0.5, grey) for corners in found)
    return [refine_corners(grey, corners) for corners in placed]


def refine_corners(grey: Grey, corners: Pixels) -> Pixels:
    """Move corners [R, C, 2] to the saddle points of brightness, to a few hundredths of a pixel."""
    half = int(np.clip(WINDOW_SHARE * _spacing(corners), *WINDOW_LIMITS))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    start = np.ascontiguousarray(corners.reshape(-1, 1, 2), dtype=np.float32)
    refined = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), stop)
    return np.asarray(refined, dtype=np.float64).reshape(corners.shape)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reading:
    """A photo and the boards read in it before its size is settled."""

    view: View
    sought: tuple[int, int] | None = None  # the size that was looked for, None for any
    found: tuple[Pixels, ...] = ()  # each [R, C, 2]


def _read_once(path: Path, board: tuple[int, int] | None, first_of: dict[str, Path]) -> _Reading:
    try:
        digest = sha256(path)
    except OSError as error:
        return _Reading(view=View(path=path, reason=f"cannot be read ({error.strerror})"))
    if digest in first_of:
        reason = f"the same file as {first_of[digest]}, counted once"
        return _Reading(view=View(path=path, reason=reason))
    first_of[digest] = path
    return _read(path, board)


def _read(path: Path, board: tuple[int, int] | None) -> _Reading:
    try:
        image = read_image(path)
    except ImageError as error:
        return _Reading(view=View(path=path, reason=str(error)))
    except ConfigError:  # without a frame's number only a video has this
        reason = "is no single picture; save frames of a video as PNG"
        return _Reading(view=View(path=path, reason=reason))
    name = "board" if board is None else f"board of {board[0]}x{board[1]} inner corners"
    view = View(path=path, picture_size=(image.width, image.height), reason=f"no {name} found")
    return _Reading(view=view, sought=board, found=tuple(find_corners(grey_of(image), board)))


def _settle(reading: _Reading, board: tuple[int, int] | None) -> View:
    """Take the reading that has the board, or seek it again where none has."""
    if reading.view.picture_size is None or board is None:
        return reading.view
    right = [found for found in reading.found if _size(found) == board]
    if not right and reading.sought != board:
        reading = _read(reading.view.path, board)
        right = list(reading.found)
    if not right:
        return reading.view
    return replace(reading.view, board=board, corners=right[0].reshape(-1, 2), reason="")


def _of_one_size(views: Sequence[View]) -> tuple[View, ...]:
    """Give the reason to views whose picture size most others do not share."""
    usual = most_common([v.picture_size for v in views if v.is_used and v.picture_size])
    return tuple(
        replace(
            view,
            reason=f"{view.picture_size[0]}x{view.picture_size[1]} px, but most photos are "
            f"{usual[0]}x{usual[1]}; calibrate each kind of file on its own",
        )
        if view.is_used and usual and view.picture_size and view.picture_size != usual
        else view
        for view in views
    )


def grey_of(image: LinearImage) -> Grey:
    """Give perceptual brightness 0..255 [H, W]; a dark RAW is lifted, the brightest 0.5 % clip."""
    light = image.rgb[0].mean(0).clamp_min(0).numpy()
    white = max(float(np.percentile(light[::5, ::5], 99.5)), 1e-6)
    return np.asarray(255 * np.sqrt(np.minimum(light / white, 1)), dtype=np.float32)


def _reduced(picture: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """Shrink a picture to `side` px at most; the same object when it is small enough."""
    scale = side / max(picture.shape)
    if scale >= 1:
        return picture
    shrunk = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, dtype=np.uint8)


def _search_any(picture: NDArray[np.uint8]) -> list[Pixels]:
    """Read a board of any size [R, C, 2], with and without evening out the light.

    Of 32 real photos 19 to 31 were read right without and 26 with it, but each misreads others.
    """
    found = []
    for flags in (cv2.CALIB_CB_LARGER, cv2.CALIB_CB_LARGER + cv2.CALIB_CB_NORMALIZE_IMAGE):
        is_found, corners, grid = cv2.findChessboardCornersSBWithMeta(picture, (3, 3), flags)
        if is_found:
            found.append(np.asarray(corners, dtype=np.float64).reshape(*grid.shape, 2))
    return found


def _search(picture: NDArray[np.uint8], board: tuple[int, int]) -> list[Pixels]:
    """Find a known board [R, C, 2] by the sector-based detector, or by the classic one."""
    attempts = (
        (cv2.findChessboardCornersSB, 0),
        (cv2.findChessboardCornersSB, cv2.CALIB_CB_NORMALIZE_IMAGE),
        (
            cv2.findChessboardCorners,
            cv2.CALIB_CB_ADAPTIVE_THRESH + cv2.CALIB_CB_NORMALIZE_IMAGE,
        ),
    )
    for search, flags in attempts:
        is_found, corners = search(picture, board, flags=flags)
        if is_found:
            return [np.asarray(corners, dtype=np.float64).reshape(*board[::-1], 2)]
    return []


def _oriented(corners: Pixels, grey: Grey) -> Pixels:
    """Put the long side along the rows, as seen from the front; views share the first corner."""
    if corners.shape[0] > corners.shape[1]:
        corners = corners.swapaxes(0, 1)
    along, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    if along[0] * down[1] < along[1] * down[0]:
        corners = corners[:, ::-1]
    turned = corners[::-1, ::-1]
    if sum(corners.shape[:2]) % 2:
        is_first = _first_square(corners, grey) <= _first_square(turned, grey)
    else:
        is_first = bool(corners[0, 0].sum() <= turned[0, 0].sum())
    return corners if is_first else turned


def _first_square(corners: Pixels, grey: Grey) -> Any:
    """Brightness at the centre of the square between the first four corners."""
    x, y = np.rint(corners[:2, :2].mean((0, 1))).astype(int)
    return grey[np.clip(y, 0, grey.shape[0] - 1), np.clip(x, 0, grey.shape[1] - 1)]


def _size(corners: Pixels) -> tuple[int, int]:
    """The board's size, long side first."""
    rows, columns = corners.shape[:2]
    return columns, rows


def _spacing(corners: Pixels) -> float:
    """Smallest distance of two neighbouring corners, px."""
    gaps = [np.linalg.norm(np.diff(corners, axis=axis), axis=-1).min() for axis in (0, 1)]
    return float(min(gaps))
