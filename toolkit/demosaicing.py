"""From a mosaic to three colours, linearly: noise stays of known size, negative values stay."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ConfigError, ShapeError

Pattern = tuple[tuple[int, ...], ...]

_RED_OR_BLUE = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
_WIDE = np.outer([1, 2, 3, 2, 1], [1, 2, 3, 2, 1]).astype(np.float32)


def demosaic(
    mosaic: NDArray[np.float32], pattern: Pattern, method: str = "bilinear"
) -> NDArray[np.float32]:
    """Fill in the two colours that each pixel of a mosaic did not measure; the measured one stays.

    Args:
        mosaic: light [H, W].
        pattern: channel (0 R, 1 G, 2 B) of the mosaic's first rows and columns, repeated over it.
        method: a name in `DEMOSAICERS`.

    Returns:
        Light [3, H, W].

    Raises:
        ConfigError: when the method is unknown.

    Example:
        >>> bool((demosaic(np.full((4, 6), 0.5, np.float32), ((0, 1), (1, 2))) == 0.5).all())
        True
    """
    if method not in DEMOSAICERS:
        raise ConfigError(
            f"demosaicing method '{method}' is unknown; use one of {', '.join(DEMOSAICERS)}"
        )
    return DEMOSAICERS[method](mosaic, pattern)


def superpixels(mosaic: NDArray[np.float32], pattern: Pattern, size: int) -> NDArray[np.float32]:
    """Average what each colour's pixels measured in blocks of the mosaic: a reduced picture.

    Nothing is interpolated, so that it costs a small part of demosaicing the whole.

    Args:
        mosaic: light [H, W].
        pattern: as in `demosaic`.
        size: side of a block, px, whole periods of the pattern; an incomplete last block is cut
            off.

    Returns:
        Light [3, H // size, W // size].

    Raises:
        ShapeError: when the size is not a whole number of periods.
    """
    period = len(pattern)
    if size % period:
        raise ShapeError(f"size is {size} px, but whole periods of {period} px are needed")
    height, width = (side // size for side in mosaic.shape)
    # [H, W / period, period] is a view in which each channel holds one column of the pattern
    columns = mosaic[: height * size, : width * size].reshape(height * size, -1, period)
    rgb = np.zeros((3, height, width), np.float32)
    for row, colours in enumerate(pattern):
        means = cv2.resize(columns[row::period], (width, height), interpolation=cv2.INTER_AREA)
        for column, channel in enumerate(colours):
            rgb[channel] += means[..., column]
    sites = np.bincount(np.ravel(pattern), minlength=3)
    rgb /= sites[:, None, None]
    return rgb


def is_bayer(pattern: Pattern) -> bool:
    """Tell whether a pattern is 2 x 2 with its two greens on a diagonal."""
    flat = [c for row in pattern for c in row]
    return sorted(flat) == [0, 1, 1, 2] and len(pattern) == 2 and (flat[0] == 1) == (flat[3] == 1)


def reach(pattern: Pattern) -> int:
    """Give how many pixels away a mosaic value still has a part in a demosaiced one."""
    return 1 if is_bayer(pattern) else 2


def _bilinear(mosaic: NDArray[np.float32], pattern: Pattern) -> NDArray[np.float32]:
    """Interpolate by normalised convolution, which for a Bayer mosaic is bilinear.

    The border is mirrored about the outermost pixels: for a period of 2 the pattern goes on across
    it, so that the kernels need no normalisation there.
    Source: Knutsson & Westin 1993, normalised convolution. Deviation: none.
    """
    if not is_bayer(pattern):
        return _convolve_any(mosaic, pattern)
    rgb = np.empty((3, *mosaic.shape), np.float32)
    one_colour = np.empty_like(mosaic)  # shared by the channels: fresh memory costs more than sums
    for channel, kernel in enumerate((_RED_OR_BLUE, _GREEN, _RED_OR_BLUE)):
        one_colour.fill(0)
        for row, column in zip(*np.nonzero(np.asarray(pattern) == channel), strict=True):
            one_colour[row::2, column::2] = mosaic[row::2, column::2]
        cv2.filter2D(one_colour, -1, kernel, rgb[channel], borderType=cv2.BORDER_REFLECT_101)
    return rgb


def _convolve_any(mosaic: NDArray[np.float32], pattern: Pattern) -> NDArray[np.float32]:
    """Do the same for any pattern that shows each colour in every 5 x 5 pixels, such as X-Trans."""
    channels = tile(np.asarray(pattern), mosaic.shape)
    rgb = np.empty((3, *mosaic.shape), np.float32)
    for channel in range(3):
        seen = (channels == channel).astype(np.float32)
        weight = cv2.filter2D(seen, -1, _WIDE, borderType=cv2.BORDER_CONSTANT)
        total = cv2.filter2D(mosaic * seen, -1, _WIDE, borderType=cv2.BORDER_CONSTANT)
        rgb[channel] = np.where(seen > 0, mosaic, total / weight)
    return rgb


def tile(period: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Repeat a small array over a picture of `shape` [H, W]."""
    repeats = [-(-length // step) for length, step in zip(shape, period.shape, strict=True)]
    return np.tile(period, repeats)[: shape[0], : shape[1]]


DEMOSAICERS: Mapping[str, Callable[[NDArray[np.float32], Pattern], NDArray[np.float32]]] = (
    MappingProxyType({"bilinear": _bilinear})
)
"""The methods by name."""
