"""Writing RAW pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from toolkit.errors import ConfigError, ShapeError
from toolkit.files import write_whole
from toolkit.imaging.metadata import rational

Pattern = tuple[tuple[int, ...], ...]

SMALLEST = 22
"""Rows and columns below which libraw takes a file for no RAW at all."""


def write_dng(
    path: Path,
    mosaic: NDArray[np.uint16],
    *,
    pattern: Pattern = ((0, 1), (1, 2)),
    black: int | Sequence[int] = 0,
    white: int = 65535,
    exposure_s: float | None = None,
    camera_matrix: Sequence[Sequence[float]] | None = None,
    orientation: int = 1,
) -> None:
    """Write an uncompressed Bayer DNG, readable by libraw and every RAW converter.

    Uncompressed, because libraw reads no DNG packed with zlib.
    Source: Adobe DNG specification 1.4. Deviation: none.

    Args:
        path: the new file; it appears whole or not at all.
        mosaic: stored values, each of one colour [H, W].
        pattern: channel (0 R, 1 G, 2 B) of the mosaic's upper left 2 x 2 values.
        black: stored value of no light, one for all or four in the pattern's reading order.
        white: stored value of sensor white.
        exposure_s: exposure time, second; None leaves it out.
        camera_matrix: from XYZ (D65) to the camera's colours, row by row [3, 3]; the identity when
            None. It says how to show the picture and is not used for measuring.
        orientation: EXIF value, how a viewer should turn the picture; the stored rows stay as they
            are.

    Raises:
        ShapeError: when the mosaic is not uint16 [H, W] of at least 22 x 22, or pattern or matrix
            has another shape.
        ConfigError: when a black level is not below white, or the exposure time is not a positive
            number.
        EnvironmentFault: when the file cannot be written.
    """
    levels = (black,) * 4 if isinstance(black, int) else tuple(int(level) for level in black)
    _check_mosaic(mosaic, pattern, levels)
    if not all(0 <= level < white <= 65535 for level in levels):
        raise ConfigError(f"black {black} and white {white} do not fit 0 <= black < white <= 65535")
    if exposure_s is not None and not 1e-9 <= exposure_s < 1e5:
        raise ConfigError(f"exposure time {exposure_s} s is not a positive number of seconds")
    matrix = np.eye(3) if camera_matrix is None else np.asarray(camera_matrix, dtype=np.float64)
    if matrix.shape != (3, 3):
        raise ShapeError(f"camera_matrix has shape {list(matrix.shape)}, but [3, 3] is needed")
    tags = _tags(pattern, levels, white, matrix, orientation)
    if exposure_s is not None:
        tags.append((33434, "2I", 1, rational(exposure_s), True))
    with write_whole(Path(path)) as temporary:
        tifffile.imwrite(
            temporary,
            mosaic,
            photometric="cfa",
            extratags=tags,
            metadata=None,
            software=False,
            rowsperstrip=mosaic.shape[0],
        )


def _check_mosaic(mosaic: NDArray[Any], pattern: Pattern, levels: tuple[int, ...]) -> None:
    if mosaic.dtype != np.uint16 or mosaic.ndim != 2 or min(mosaic.shape) < SMALLEST:
        raise ShapeError(
            f"mosaic is {mosaic.dtype} {list(mosaic.shape)}, "
            f"but uint16 [H, W] of at least {SMALLEST} x {SMALLEST} is needed"
        )
    if sorted(c for row in pattern for c in row) != [0, 1, 1, 2] or len(pattern) != 2:
        raise ShapeError(f"pattern {pattern} is not 2 x 2 of one R (0), two G (1) and one B (2)")
    if len(levels) != 4:
        raise ShapeError(f"black has {len(levels)} values, but one or four are needed")


def _tags(
    pattern: Pattern,
    levels: tuple[int, ...],
    white: int,
    matrix: NDArray[np.float64],
    orientation: int,
) -> list[tuple[Any, ...]]:
    """Give the tags as tifffile takes them: code, type, count, value, only for the first page."""
    ratios = tuple(part for entry in matrix.ravel() for part in (round(entry * 10_000), 10_000))
    return [
        (271, "s", 0, "Ball streak toolkit", True),  # Make
        (272, "s", 0, "Simulated camera", True),  # Model
        (274, "H", 1, orientation, True),
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes(c for row in pattern for c in row), True),  # CFAPattern
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50707, "B", 4, bytes([1, 1, 0, 0]), True),  # DNGBackwardVersion
        (50708, "s", 0, "Ball streak toolkit simulated camera", True),  # UniqueCameraModel
        (50710, "B", 3, bytes([0, 1, 2]), True),  # CFAPlaneColor
        (50711, "H", 1, 1, True),  # CFALayout: rectangular
        (50713, "H", 2, (2, 2), True),  # BlackLevelRepeatDim
        (50714, "H", 4, levels, True),  # BlackLevel
        (50717, "I", 1, white, True),  # WhiteLevel
        (50721, "2i", 9, ratios, True),  # ColorMatrix1
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1: D65
    ]
