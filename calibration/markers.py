"""Find the inner corners of a ChArUco board in one picture, and tell which board it is."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.board import MOST
from calibration.checkers import Grey, Pixels, are_crossings, as_bytes, reduced, refined
from toolkit.errors import ConfigError

SEARCH_SIDE = 1600
"""Long side, px, to which a photo is reduced to seek markers."""
COMMON = (
    "DICT_6X6_50",
    "DICT_5X5_50",
    "DICT_4X4_50",
    "DICT_7X7_50",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_36h11",
)
"""Families of markers that are tried; a larger set of a family begins with the smaller one."""
PLENTY = 8
"""Markers that leave no doubt of their dictionary: of another one or two are misread."""
FEWEST_MARKERS = 6
"""Different markers that tell a layout; any four fit any plane."""
WIDEST = 30
"""Squares along x up to which a layout is sought."""
LAYOUT_ERROR = 0.15
"""Squares that markers may stand off their places, which only a bent picture explains."""
DRAWS = 200
"""Fours of markers tried for a layout: one in two of them holds no misread marker."""
LAYOUT_SHARE = 0.8
"""Share of the markers that must stand within it; the rest may be other things misread."""
CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
"""Of a marker of side 1 about its centre, in OpenCV's order."""
WINDOW_SHARE = 0.7
"""Half the refining window over the white gap between a corner and the next marker."""
LARGEST_WINDOW = 0.3
"""The same, over the side of a square."""
CIRCLE_SHARE = 0.95
"""Radius of the circle that tells a crossing, over the white gap."""
MOST_MOVED = 0.2
"""Squares a corner may move when it is refined; past it another edge was taken for it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Markers:
    """Markers of one dictionary in a picture."""

    dictionary: str
    corners: Pixels  # [N, 4, 2] px
    ids: NDArray[np.int64]  # [N]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How markers stand on a board; the rows follow from the markers seen."""

    dictionary: str
    squares_x: int
    marker_share: float  # side of a marker over that of a square
    is_legacy: bool = False  # the first square is white, as OpenCV printed it until 4.6


def dictionary_named(name: str) -> Any:
    """Give OpenCV's dictionary.

    Raises:
        ConfigError: when there is none of that name.
    """
    known = sorted(word for word in dir(cv2.aruco) if word.startswith("DICT_"))
    if name not in known:
        raise ConfigError(f"--dictionary {name} is not known; known are {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def larger_of(name: str) -> str:
    """Give a larger dictionary that begins with the same markers, where there is one."""
    return name.replace("_50", "_250")


def find_markers(grey: Grey, dictionaries: Sequence[str]) -> Markers | None:
    """Find markers of the dictionary, of those given, that has most, or plenty, in the picture."""
    whole = as_bytes(grey)
    small = reduced(whole, SEARCH_SIDE)
    best: Markers | None = None
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    for name in dictionaries:
        detector = cv2.aruco.ArucoDetector(dictionary_named(name), settings)
        quads, ids, _ = detector.detectMarkers(small)
        if ids is None or (best is not None and len(ids) <= len(best.ids)):
            continue
        steps = np.array(whole.shape[::-1]) / small.shape[::-1]
        corners = (np.reshape(quads, (-1, 4, 2)).astype(np.float64) + 0.5) * steps - 0.5
        best = Markers(dictionary=name, corners=corners, ids=np.ravel(ids).astype(np.int64))
        if len(best.ids) >= PLENTY:
            break
    return best


def layout_of(markers: Markers) -> Layout | None:
    """Tell how many squares a row has from where the markers stand; None where it stays open.

    Every width is tried, and both colours of the first square: only the true one puts the markers
    where a plane, seen in perspective, shows them. Source: derived.
    """
    if len(np.unique(markers.ids)) < FEWEST_MARKERS:
        return None
    best = min(_fits(markers), default=None)
    if best is None:
        return None
    _, is_legacy, _, squares_x, share = best
    return Layout(
        dictionary=markers.dictionary,
        squares_x=squares_x,
        marker_share=share,
        is_legacy=is_legacy,
    )


def find_charuco(grey: Grey, layout: Layout, markers: Markers) -> tuple[Pixels, NDArray[np.int64]]:
    """Find the corners between the markers seen.

    Returns:
        Corners [N, 2] px and their numbers [N], row by row along x; N = 0 when there are none.
    """
    whole = as_bytes(grey)
    small = reduced(whole, SEARCH_SIDE)
    steps = np.array(whole.shape[::-1]) / small.shape[::-1]
    quads = ((markers.corners + 0.5) / steps - 0.5).astype(np.float32)
    settings = cv2.aruco.CharucoParameters()
    settings.minMarkers = 1  # where the marker on one side of a corner was missed
    detector = cv2.aruco.CharucoDetector(_opencv_board(layout), settings)
    found, ids, _, _ = detector.detectBoard(
        small,
        markerCorners=list(quads[:, None]),
        markerIds=markers.ids.astype(np.int32)[:, None],
    )
    if ids is None or len(ids) == 0:
        return np.zeros((0, 2)), np.zeros(0, dtype=np.int64)
    rough = (np.reshape(found, (-1, 2)).astype(np.float64) + 0.5) * steps - 0.5
    numbers = np.ravel(ids).astype(np.int64)
    square = _square_side(markers, layout)
    gap = (1 - layout.marker_share) / 2
    corners = refined(grey, rough, min(WINDOW_SHARE * gap, LARGEST_WINDOW) * square)
    is_sure = np.linalg.norm(corners - rough, axis=-1) < max(MOST_MOVED * square, 1)
    is_sure &= are_crossings(whole, corners, CIRCLE_SHARE * gap * square)
    return corners[is_sure], numbers[is_sure]


def _opencv_board(layout: Layout) -> Any:
    """The board with as many rows as the dictionary has markers for; those unseen do no harm."""
    dictionary = dictionary_named(layout.dictionary)
    rows = min(MOST, max(2 * len(dictionary.bytesList) // layout.squares_x, 2))
    rows -= rows % 2  # a legacy board begins with white only when its rows are even
    size = (layout.squares_x, rows)
    board = cv2.aruco.CharucoBoard(size, 1.0, layout.marker_share, dictionary)
    board.setLegacyPattern(layout.is_legacy)
    return board


def _cells(ids: NDArray[np.int64], squares_x: int, is_legacy: bool) -> NDArray[np.int64]:
    """Column and row of the white square that holds each marker [N, 2]; row by row."""
    first_white = 0 if is_legacy else 1
    in_first = (squares_x + 1 - first_white) // 2  # white squares in rows that begin like the first
    in_pair = squares_x  # and in two rows together
    pair, rest = np.divmod(ids, in_pair)
    is_second = rest >= in_first
    row = 2 * pair + is_second
    nth = rest - in_first * is_second
    column = 2 * nth + np.where(is_second, 1 - first_white, first_white)
    return np.stack([column, row], axis=-1)


def _fits(markers: Markers) -> Iterator[tuple[float, bool, float, int, float]]:
    """Layouts that fit, the best the least: of all that most markers fit, the newer pattern first.

    Minus the share of fitting markers, legacy, median error in squares, width, marker share.
    """
    for squares_x in range(2, WIDEST + 1):
        for is_legacy in (False, True):
            centres = _cells(markers.ids, squares_x, is_legacy) + 0.5
            if np.ptp(centres, axis=0).min() < 1:
                continue  # in one line they fit anything
            # from the picture to the board, so that the error is in squares
            H: Any
            H, _ = cv2.findHomography(
                markers.corners.mean(1), centres, cv2.RANSAC, LAYOUT_ERROR, maxIters=DRAWS
            )
            if H is None:
                continue
            placed = cv2.perspectiveTransform(markers.corners, H)
            sides = np.linalg.norm(placed - np.roll(placed, 1, axis=1), axis=-1)
            share = float(np.median(sides))
            # a marker's own corners begin at its top left: a wrong layout turns or skews them
            expected = centres[:, None] + share * CORNERS
            errors = np.linalg.norm(placed - expected, axis=-1).max(axis=1)
            fitting = float((errors < LAYOUT_ERROR).mean())
            if 0.1 < share < 1 and fitting >= LAYOUT_SHARE:
                yield -fitting, is_legacy, float(np.median(errors)), squares_x, share


def _square_side(markers: Markers, layout: Layout) -> float:
    """Side of a square where it looks smallest, px."""
    sides = np.linalg.norm(markers.corners - np.roll(markers.corners, 1, axis=1), axis=-1)
    return float(sides.min()) / layout.marker_share
