"""Find the inner corners of a checkerboard in one picture."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.float64]
Grey = NDArray[np.float32] | NDArray[np.uint8]
Detector = tuple[Any, int]
"""One of OpenCV's, and its flags."""

GLANCE_SIDES = (320, 800)
"""Long side, px, to which a photo is reduced to see what board is on it.

At 320 px 13 of 13 and 15 of 19 real photos were read right in 19 ms each, not worse than at 1280 px
in 150 ms; misread ones hardly ever agree on a wrong size.
"""
SEARCH_SIDES = (800, 1600, 3200)
"""Long side, px, to which a photo is reduced for the search; the next when one fails."""
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
QUICK_SIDE, QUICK = 400, (cv2.findChessboardCorners, 0)
"""Long side, px, and detector that are tried first.

With one threshold for all of the picture it finds 28 of 32 real boards, misses the others in 4 ms,
and saves half the time of searching adaptively at once.
"""
CLASSIC = (cv2.findChessboardCorners, cv2.CALIB_CB_ADAPTIVE_THRESH + cv2.CALIB_CB_NORMALIZE_IMAGE)
THOROUGH = (
    (cv2.findChessboardCornersSB, 0),
    (cv2.findChessboardCornersSB, cv2.CALIB_CB_NORMALIZE_IMAGE),
)
EVEN_LIGHT = cv2.CALIB_CB_LARGER + cv2.CALIB_CB_NORMALIZE_IMAGE
"""Of 32 real photos 19 to 31 were read right with uneven light and 26 evened out; each misreads
others."""
CIRCLE_POINTS = 48
"""How often the circle about a corner is read."""
MOST_UNLIKE = 0.2
"""Mean difference of opposite points on it, over the contrast."""
MARKED_SPREAD = 0.15
"""Spread of brightness inside the white squares, over the contrast, from which they hold markers.
"""


def most_common(items: Sequence[tuple[int, int]]) -> tuple[int, int] | None:
    """Give the most frequent pair, the larger where two are as frequent; None of nothing."""
    counts = Counter(items)
    return max(counts, key=lambda pair: (counts[pair], pair[0] * pair[1]), default=None)


def glance(grey: Grey) -> Pixels | None:
    """Read a board of any size in a much reduced picture, quickly and not always right.

    Returns:
        Corners [R, C, 2] px to about a pixel of the reduced picture.
    """
    whole = as_bytes(grey)
    for side in GLANCE_SIDES:
        small = reduced(whole, side)
        found = _read_any(small, EVEN_LIGHT)
        if found is not None:
            return _enlarged(found, small, whole)
        if small is whole:
            break
    return None


def find_any(grey: Grey) -> list[Pixels]:
    """Read a board of any size in one picture: up to two readings [R, C, 2] px, not refined."""
    whole = as_bytes(grey)
    for side in SEARCH_SIDES[1:]:
        small = reduced(whole, side)
        readings = [_read_any(small, flags) for flags in (cv2.CALIB_CB_LARGER, EVEN_LIGHT)]
        found = [_enlarged(corners, small, whole) for corners in readings if corners is not None]
        if found or small is whole:
            break
    return found


def find_corners(
    grey: Grey, board: tuple[int, int] | None, *, is_thorough: bool = True
) -> list[Pixels]:
    """Find a board in one picture and refine its corners.

    Args:
        grey: brightness 0..255 [H, W].
        board: inner corners (long side, short side), or None for any size from 3 x 3.
        is_thorough: seek a known board by the slower detector too where the quick one misses it.

    Returns:
        Corners [R, C, 2] px with C >= R: none or one reading of a known board, up to two of an
        unknown one. The square between the first four corners is dark where that can be told
        (C + R odd); else the first corner is the one nearest to the picture's.
    """
    if board is None:
        return [refine_corners(grey, _oriented(corners, grey)) for corners in find_any(grey)]
    best: list[tuple[int, Pixels]] = []
    for corners in _attempts(as_bytes(grey), board, is_thorough):
        start = _oriented(corners, grey)
        moved = refine_corners(grey, start)
        # a corner that would have to leave its window is given back where it was put
        stuck = int((np.abs(moved - start) < 1e-4).all(axis=-1).sum())
        best.append((stuck, moved))
        if stuck == 0:
            break
    return [min(best, key=lambda attempt: attempt[0])[1]] if best else []


def refine_corners(grey: Grey, corners: Pixels) -> Pixels:
    """Move corners [R, C, 2] to the saddle points of brightness, to a few hundredths of a pixel."""
    return refined(grey, corners, WINDOW_SHARE * spacing(corners))


def refined(grey: Grey, corners: Pixels, half_window: float) -> Pixels:
    """Move corners [..., 2] to the saddle points of brightness within a window."""
    half = int(np.clip(half_window, *WINDOW_LIMITS))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    start = np.ascontiguousarray(corners.reshape(-1, 1, 2), dtype=np.float32)
    moved = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), stop)
    return np.asarray(moved, dtype=np.float64).reshape(corners.shape)


def holds_markers(grey: Grey, corners: Pixels) -> bool:
    """Tell whether the white squares between corners [R, C, 2] are printed on."""
    first, last = corners[:-1, :-1, None, None], corners[1:, 1:, None, None]
    right, down = corners[:-1, 1:, None, None], corners[1:, :-1, None, None]
    x, y = np.meshgrid(np.linspace(0.2, 0.8, 9), np.linspace(0.2, 0.8, 9))
    x, y = x[..., None], y[..., None]
    top, bottom = first + x * (right - first), down + x * (last - down)
    places = (top + y * (bottom - top)).reshape(-1, 81, 2).astype(np.float32)
    patches = cv2.remap(as_bytes(grey), places[..., 0], places[..., 1], cv2.INTER_LINEAR)
    low, high = np.percentile(patches, (5, 95))
    is_white = np.add.outer(np.arange(corners.shape[0] - 1), np.arange(corners.shape[1] - 1)) % 2
    spreads = patches.std(axis=1).reshape(is_white.shape) / max(high - low, 1)
    return bool(max(np.median(spreads[is_white == i]) for i in (0, 1)) > MARKED_SPREAD)


def are_crossings(picture: NDArray[np.uint8], corners: Pixels, radius: float) -> NDArray[np.bool_]:
    """Tell whether a circle about a corner [N, 2] meets two dark and two light parts, each alike.

    On the board's rim, below the last row, a marker has corners too, but only one dark part each;
    beside something that hides the board one part is unlike its opposite.
    """
    angle = np.linspace(0, 2 * np.pi, CIRCLE_POINTS, endpoint=False)
    ring = max(radius, 1.5) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    places = (corners[:, None] + ring).astype(np.float32)
    seen = cv2.remap(
        picture, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float64)
    middle = (seen.max(axis=1) + seen.min(axis=1)) / 2
    is_light = seen > middle[:, None]
    changes = (is_light != np.roll(is_light, 1, axis=1)).sum(axis=1)
    unlike = np.abs(seen - np.roll(seen, CIRCLE_POINTS // 2, axis=1)).mean(axis=1)
    contrast = np.maximum(np.ptp(seen, axis=1), 1)
    return np.asarray((changes == 4) & (unlike < MOST_UNLIKE * contrast))


def shows(grey: Grey, board: tuple[int, int]) -> bool:
    """Tell whether a photo plainly shows a checkerboard of this size, and none that goes on."""
    whole = as_bytes(grey)
    corners = next(_search(whole, QUICK_SIDE, board, [QUICK]), None)
    if corners is None:
        return False
    return not _goes_on(whole, corners) and not holds_markers(whole, corners)


def _goes_on(picture: NDArray[np.uint8], corners: Pixels) -> bool:
    """Whether squares meet where the next row or column of corners would be, on any side."""
    radius = 0.3 * spacing(corners)
    for grid in (corners, corners[::-1], corners.swapaxes(0, 1), corners.swapaxes(0, 1)[::-1]):
        next_row = 2 * grid[0] - grid[1]
        if are_crossings(picture, next_row, radius).mean() > 0.5:
            return True
    return False


def size_of(corners: Pixels) -> tuple[int, int]:
    """Give the size of a board of corners [R, C, 2], long side first."""
    rows, columns = sorted(corners.shape[:2])
    return columns, rows


def spacing(corners: Pixels) -> float:
    """Give the smallest distance of two neighbouring corners of [R, C, 2], px."""
    gaps = [np.linalg.norm(np.diff(corners, axis=axis), axis=-1) for axis in (0, 1)]
    return float(min(np.nanmin(gap) for gap in gaps if np.isfinite(gap).any()))


def reduced(picture: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """Shrink a picture to `side` px at most; the same object when it is small enough."""
    scale = side / max(picture.shape)
    if scale >= 1:
        return picture
    # means over a pixel and a half are slow, and there is little to lose between them
    how = cv2.INTER_LINEAR if scale > 0.5 else cv2.INTER_AREA
    shrunk = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=how)
    return np.asarray(shrunk, dtype=np.uint8)


def as_bytes(grey: Grey) -> NDArray[np.uint8]:
    """Round brightness to whole levels; the same object when it has them."""
    if grey.dtype == np.uint8:
        return np.asarray(grey, dtype=np.uint8)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def _attempts(
    whole: NDArray[np.uint8], board: tuple[int, int], is_thorough: bool
) -> Iterator[Pixels]:
    """Places of a known board [R, C, 2] px by one detector after the other, the quickest first."""
    yield from _search(whole, QUICK_SIDE, board, [QUICK])
    detectors = [CLASSIC, *(THOROUGH if is_thorough else ())]
    for side in SEARCH_SIDES[: None if is_thorough else 1]:
        found = False
        for corners in _search(whole, side, board, detectors):
            found = True
            yield corners
        if found or side >= max(whole.shape):
            return


def _search(
    whole: NDArray[np.uint8], side: int, board: tuple[int, int], detectors: Sequence[Detector]
) -> Iterator[Pixels]:
    """Places in the whole picture of a board that detectors find in one reduced to `side`."""
    small = reduced(whole, side)
    for search, flags in detectors:
        is_found, corners = search(small, board, flags=flags)
        if is_found:
            grid = np.asarray(corners, dtype=np.float64).reshape(*board[::-1], 2)
            yield _enlarged(grid, small, whole)


def _read_any(picture: NDArray[np.uint8], flags: int) -> Pixels | None:
    is_found, corners, grid = cv2.findChessboardCornersSBWithMeta(picture, (3, 3), flags)
    if not is_found:
        return None
    return np.asarray(corners, dtype=np.float64).reshape(*grid.shape, 2)


def _enlarged(corners: Pixels, small: NDArray[Any], whole: NDArray[Any]) -> Pixels:
    """Carry places in a reduced picture to the whole one."""
    steps = np.array(whole.shape[::-1]) / small.shape[::-1]
    return np.asarray((corners + 0.5) * steps - 0.5)


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
