"""Time a calibration from 13 photos against the plain OpenCV recipe on the same photos.

    python benchmarks/calibration_speed.py --photos ../shared/data/checkerboard/opencv_left/*.jpg

The recipe is told the board's size; the toolkit finds it. Both read the files. The photos are used
as they are and enlarged to 4 megapixels; the two take turns, and the median over the turns counts.
The toolkit looks at two photos at a time, which the clock sees where a second core is idle.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.corners import find_boards
from calibration.intrinsics import calibrate

BOARD = (9, 6)
PIXELS = 4_000_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photos", type=Path, nargs="+", required=True)
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--one-core", action="store_true", help="let OpenCV use one thread too")
    settings = parser.parse_args()
    if settings.one_core:
        cv2.setNumThreads(1)
    print(
        f"{'size':<12}{'what':<14}{'recipe ms':>11}{'toolkit ms':>12}{'corners ms':>12}{'ratio':>8}"
    )
    with tempfile.TemporaryDirectory() as folder:
        compare(settings.photos, settings.turns)
        compare(enlarged(settings.photos, Path(folder)), settings.turns)


def compare(photos: Sequence[Path], turns: int) -> None:
    recipe(photos), calibrate(photos)  # warm up: imports, caches
    rows = [[*timed(recipe, photos), *timed(calibrate, photos), *timed(find_boards, photos)]
            for _ in range(turns)]  # fmt: skip
    walls = [statistics.median(row[i] for row in rows) for i in (0, 2, 4)]
    cores = [statistics.median(row[i] for row in rows) for i in (1, 3, 5)]
    ratios = [statistics.median(row[i + 2] / row[i] for row in rows) for i in (0, 1)]
    height, width = cv2.imread(str(photos[0]), 0).shape
    for name, times, ratio in (("by the clock", walls, ratios[0]), ("on cores", cores, ratios[1])):
        text = "".join(f"{1000 * t:>{w}.0f}" for t, w in zip(times, (11, 12, 12), strict=True))
        print(f"{width}x{height:<7}{name:<14}{text}{ratio:>8.2f}")


def timed(task: Callable[[Sequence[Path]], object], photos: Sequence[Path]) -> tuple[float, float]:
    """Seconds by the clock, and on all cores together."""
    clock, cores = time.perf_counter(), time.process_time()
    task(photos)
    return time.perf_counter() - clock, time.process_time() - cores


def recipe(photos: Sequence[Path]) -> float:
    """What OpenCV's tutorial does."""
    points = np.zeros((BOARD[0] * BOARD[1], 3), np.float32)
    points[:, :2] = np.mgrid[: BOARD[0], : BOARD[1]].T.reshape(-1, 2)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
    views = []
    for photo in photos:
        grey = cv2.cvtColor(cv2.imread(str(photo)), cv2.COLOR_BGR2GRAY)
        is_found, corners = cv2.findChessboardCorners(grey, BOARD, None)
        if is_found:
            views.append(cv2.cornerSubPix(grey, corners, (11, 11), (-1, -1), stop))
    return float(cv2.calibrateCamera([points] * len(views), views, grey.shape[::-1], None, None)[0])


def enlarged(photos: Sequence[Path], folder: Path) -> list[Path]:
    made = []
    for photo in photos:
        picture = cv2.imread(str(photo))
        scale = (PIXELS / (picture.shape[0] * picture.shape[1])) ** 0.5
        large = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        made.append(folder / f"{photo.stem}.jpg")
        cv2.imwrite(str(made[-1]), large)
    return made


if __name__ == "__main__":
    main()
