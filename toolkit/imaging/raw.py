"""RAW: the sensor's own values, minus black, over white."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rawpy
import tifffile
import torch
from numpy.typing import NDArray

from toolkit.demosaicing import Pattern, reach, tile
from toolkit.errors import ImageError
from toolkit.files import one_line
from toolkit.imaging.metadata import exposure_time
from toolkit.imaging.quiet import quiet_decoders
from toolkit.imaging.stored import check_size, exposure_tensor
from toolkit.imaging.tiff import DNG_VERSION, TIFF_ERRORS, is_whole, raw_pages
from toolkit.response import LINEAR, Response
from toolkit.types import LinearImage

NO_SHUTTER_SPEED = (0.0, 1.0)
"""What libraw reports when a file does not tell the exposure time, or tells 1/0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A part of the sensor, counted from the corner of the whole frame, masked margins included."""

    top: int
    left: int
    height: int
    width: int


def read_raw(path: Path, response: Response = LINEAR) -> LinearImage:
    """Read a RAW picture in sensor orientation, cut to the crop that its maker recommends.

    A Bayer or X-Trans mosaic is kept as it is, and demosaiced when somebody needs all colours; RAW
    files that hold colours or grey already have none. `crop` counts from the visible area, the
    sensor without its masked margins.

    Args:
        path: any file libraw reads.
        response: for a sensor that is not linear; applied to the mosaic.

    Raises:
        ImageError: when the file is damaged or pruned, of an unknown camera, or its colours are not
            red, green, blue.
    """
    _check_pieces(path)
    with _opened(path) as raw:
        visible, window = _windows(raw.sizes)
        values = _visible_values(path, raw)
        rows = slice(window.top - visible.top, window.top - visible.top + window.height)
        columns = slice(window.left - visible.left, window.left - visible.left + window.width)
        values = values[rows, columns]
        white = int(raw.white_level)
        _check_values(path, values, white)
        pattern = _pattern(path, raw, window)
        black = _black(path, raw, window, pattern)
        if not 0 <= black.max() < white:
            raise ImageError(
                f"{path} has black level {black.max():g} and white {white}; it is damaged"
            )
        light = _normalise(values, black, white)
        met_white = values >= white
        reported = float(raw.other.shutter_speed)
    light = _respond(light, pattern, response)
    crop = (window.left - visible.left, window.top - visible.top, visible.width, visible.height)
    return LinearImage(
        rgb=torch.from_numpy(light)[None] if pattern is None else None,
        clipped=torch.from_numpy(_spread(met_white, pattern))[None, None],
        exposure=exposure_tensor(_exposure(path, reported)),
        mosaic=None if pattern is None else torch.from_numpy(light)[None, None],
        pattern=pattern,
        crop=None if window == visible else crop,
        response=response.name,
        curve_doubt=response.doubt(),
    )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open and unpack a RAW file; the size is checked in between."""
    try:
        with rawpy.RawPy() as raw:
            with quiet_decoders(), path.open("rb") as file:
                raw.open_buffer(file)  # by its path, rawpy opens no name that is not UTF-8
                check_size(path, raw.sizes.raw_width, raw.sizes.raw_height)
                raw.unpack()
            yield raw
    except (rawpy.LibRawError, rawpy.NotSupportedError, NotImplementedError) as error:
        text = error.args[0] if error.args else ""
        reason = text.decode(errors="replace") if isinstance(text, bytes) else one_line(error)
        raise ImageError(
            f"{path} is a damaged or unsupported RAW file ({reason}); "
            "copy it again, or convert it to DNG"
        ) from None


def _check_pieces(path: Path) -> None:
    """Refuse a file that lost sensor values: libraw then shows zeros or whatever memory held."""
    try:
        with quiet_decoders(), tifffile.TiffFile(path) as file:
            size = path.stat().st_size
            whole = all(is_whole(page, size) for page in raw_pages(file))
    except TIFF_ERRORS:
        return  # not a TIFF structure, or one that only libraw understands
    if not whole:
        raise ImageError(f"{path} lacks a part of its sensor values; copy it again from the camera")


def _windows(sizes: Any) -> tuple[Window, Window]:
    """Give the visible area and the recommended crop within it, or the visible area twice."""
    visible = Window(
        top=sizes.top_margin, left=sizes.left_margin, height=sizes.height, width=sizes.width
    )
    top, left = sizes.crop_top_margin, sizes.crop_left_margin
    bottom, right = top + sizes.crop_height, left + sizes.crop_width
    is_inside = (
        visible.top <= top < bottom <= visible.top + visible.height
        and visible.left <= left < right <= visible.left + visible.width
    )
    if not is_inside:
        return visible, visible
    return visible, Window(top=top, left=left, height=bottom - top, width=right - left)


def _visible_values(path: Path, raw: Any) -> NDArray[Any]:
    values: NDArray[Any] | None = raw.raw_image_visible
    if values is None or values.ndim not in (2, 3) or values.dtype != np.uint16:
        raise ImageError(f"{path} holds no integer sensor values; convert it to a common DNG")
    if abs(raw.sizes.pixel_aspect - 1) > 1e-3:
        raise ImageError(f"{path} has pixels that are not square; such sensors are not supported")
    return values[..., :3] if values.ndim == 3 else values


def _check_values(path: Path, values: NDArray[Any], white: int) -> None:
    low, high = int(values.min()), int(values.max())
    if low == high:
        raise ImageError(
            f"{path} has the value {low} everywhere; its picture is lost, copy it again"
        )
    # Cameras saturate somewhat above the white level they state, but never beyond its number of
    # bits.
    if high >= 1 << max(white, 1).bit_length():
        raise ImageError(
            f"{path} has values up to {high}, far above its white level {white}; "
            "it is damaged, copy it again"
        )


def _pattern(path: Path, raw: Any, window: Window) -> Pattern | None:
    """Give the mosaic's period from the window's corner; None for RAW files without a mosaic."""
    if raw.raw_pattern is None or raw.num_colors == 1:
        return None
    rows, columns = raw.raw_pattern.shape
    letters = raw.color_desc.decode("ascii", errors="replace")
    names = [[letters[c] for c in row] for row in _colour_indices(raw, window, rows, columns)]
    if {name for row in names for name in row} != set("RGB"):
        raise ImageError(
            f"{path} has sensor colours {letters}; only red, green and blue are supported"
        )
    return tuple(tuple("RGB".index(name) for name in row) for row in names)


def _colour_indices(raw: Any, window: Window, rows: int, columns: int) -> list[list[int]]:
    # raw_pattern itself starts at another corner, depending on the margins.
    return [
        [raw.raw_color(window.top + i, window.left + j) for j in range(columns)]
        for i in range(rows)
    ]


def _black(path: Path, raw: Any, window: Window, pattern: Pattern | None) -> NDArray[np.float32]:
    """Give the black level from the window's corner, [h, w], or [1, 1, 3] without a mosaic."""
    levels = np.asarray(raw.black_level_per_channel, np.float32)
    if pattern is None:
        return levels[:3].reshape(1, 1, 3) if raw.num_colors == 3 else levels[:1].reshape(1, 1)
    # libraw folds periods up to 2 x 2 into the channels, and hides larger ones.
    stated = _stated_black(path, window)
    if stated is not None:
        return stated
    return levels[_colour_indices(raw, window, len(pattern), len(pattern[0]))]


def _stated_black(path: Path, window: Window) -> NDArray[np.float32] | None:
    """Read a DNG's black levels, [h, w] from the window's corner; None to ask libraw."""
    try:
        with quiet_decoders(), tifffile.TiffFile(path) as file:
            if DNG_VERSION not in file.pages.first.tags:
                return None
            tags = next(raw_pages(file)).tags
            if 50715 in tags or 50716 in tags:  # levels that change along rows or columns
                return None
            rows, columns = tags.valueof(50713, default=(1, 1))
            values = np.atleast_1d(np.asarray(tags[50714].value, np.float32))
            if tags[50714].dtype in (5, 10):  # ratios
                values = values[0::2] / values[1::2]
            top, left, _, _ = tags.valueof(50829, default=(0, 0, 0, 0))  # ActiveArea
            period = values.reshape(int(rows), int(columns))
    except (*TIFF_ERRORS, StopIteration):
        return None
    return np.roll(period, (top - window.top, left - window.left), axis=(0, 1))


def _normalise(
    values: NDArray[np.uint16], black: NDArray[np.float32], white: int
) -> NDArray[np.float32]:
    """Give (values - black) / (white - black) as float32; the common case needs no loop."""
    if black.ndim == 2 and (black == black[0, 0]).all():
        light = values.astype(np.float32)
        light -= black[0, 0]
        light *= 1 / (white - black[0, 0])
        return light
    if black.ndim == 3:
        return (values - black) / (white - black)
    light = np.empty(values.shape, np.float32)
    rows, columns = black.shape
    for i in range(rows):
        for j in range(columns):
            part = values[i::rows, j::columns] - black[i, j]
            light[i::rows, j::columns] = part / (white - black[i, j])
    return light


def _respond(
    light: NDArray[np.float32], pattern: Pattern | None, response: Response
) -> NDArray[np.float32]:
    """Apply the response; give a mosaic [H, W], or colours [3, H, W]."""
    if pattern is None:
        return response.decode(light)
    if response.curves is None:
        return light
    channels = tile(np.asarray(pattern), light.shape)
    return np.choose(channels, [response.light(light, c) for c in range(3)])


def _spread(met_white: NDArray[np.bool_], pattern: Pattern | None) -> NDArray[np.bool_]:
    """Mark the pixels into whose colours a clipped value went, [H, W]."""
    if pattern is None:
        return np.any(met_white, axis=2) if met_white.ndim == 3 else met_white
    if not met_white.any():
        return met_white
    size = 2 * reach(pattern) + 1
    return cv2.dilate(met_white.view(np.uint8), np.ones((size, size), np.uint8)).view(np.bool_)


def _exposure(path: Path, reported: float) -> float | None:
    """Give the file's own entry, or libraw's number where that one cannot be a stopgap."""
    with path.open("rb") as file:
        stated = exposure_time(file)
    if stated is not None:
        return stated
    is_known = math.isfinite(reported) and reported > 0 and reported not in NO_SHUTTER_SPEED
    return reported if is_known else None
