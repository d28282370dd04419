"""TIFF: headers checked first, so that nothing is dropped, turned or filled in silently."""

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from toolkit.errors import ImageError
from toolkit.files import one_line
from toolkit.imaging.metadata import exposure_time
from toolkit.imaging.png import rgb_order
from toolkit.imaging.quiet import quiet_decoders
from toolkit.imaging.stored import StoredPicture, check_size, without_alpha

CFA, LINEAR_RAW = 32803, 34892
GREY, RGB = 1, 2
DNG_VERSION = 50706
ORIENTATION = 274
OLD_JPEG = 6
UNCOMPRESSED = 1
HUFFMAN_COMPRESSIONS = (7, 34713)
"""Lossless JPEG in RAW files and Nikon's: no sample takes less than a bit."""
PLAIN_COMPRESSIONS = (UNCOMPRESSED, 8, 32946)
"""None and deflate, which tifffile unpacks without further packages."""

TIFF_ERRORS = (
    cv2.error,
    tifffile.TiffFileError,
    zlib.error,
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
)
"""What tifffile, Pillow and OpenCV raise on damaged files, found by flipping their bytes."""


def holds_raw(path: Path) -> bool:
    """Tell whether a TIFF structure is a camera's RAW file: a DNG, a mosaic, or preview first.

    A structure that cannot be parsed counts as TIFF, whose reader then says what is wrong with it.
    """
    try:
        with quiet_decoders(), tifffile.TiffFile(path) as file:
            first = file.pages.first
            is_preview = bool(first.subfiletype & 1) or first.compression == OLD_JPEG
            return DNG_VERSION in first.tags or is_preview or any(True for _ in raw_pages(file))
    except TIFF_ERRORS:
        return False


def raw_pages(file: tifffile.TiffFile) -> Iterator[tifffile.TiffPage]:
    """Give the pages, at the top or one level below, that hold sensor values."""
    for page in file.pages:
        for candidate in (page, *(page.pages or ())):
            if candidate.photometric in (CFA, LINEAR_RAW):
                yield candidate


def is_whole(page: tifffile.TiffPage, file_bytes: int) -> bool:
    """Tell whether every strip or tile lies inside the file and has room for its values."""
    pieces = list(zip(page.dataoffsets, page.databytecounts, strict=False))
    if not all(0 < offset and 0 < count <= file_bytes - offset for offset, count in pieces):
        return False
    least_bits = page.imagewidth * page.imagelength * page.samplesperpixel
    if page.compression == UNCOMPRESSED:
        least_bits *= page.bitspersample
    elif page.compression not in HUFFMAN_COMPRESSIONS:
        least_bits = 1
    return 8 * sum(page.databytecounts) >= least_bits


def read_tiff(path: Path) -> StoredPicture:
    """Read a TIFF of 8, 16 bits or floats, grey or RGB, in the stored orientation.

    Raises:
        ImageError: when it is cut or damaged, has several pages or transparent pixels, or is
            neither grey nor RGB.
    """
    try:
        with quiet_decoders(), tifffile.TiffFile(path) as file:
            page = _only_page(path, file)
            _check_page(path, page)
            values = _unpack(path, page)
    except TIFF_ERRORS as error:
        raise ImageError(
            f"{path} is a damaged TIFF ({one_line(error)}); copy it again or save it anew"
        ) from None
    with path.open("rb") as stream:
        exposure = exposure_time(stream)
    return without_alpha(path, StoredPicture(values=values, exposure=exposure))


def _only_page(path: Path, file: tifffile.TiffFile) -> tifffile.TiffPage:
    full = [page.aspage() for page in file.pages]
    full = [page for page in full if not page.subfiletype & 1]
    if len(full) != 1:
        raise ImageError(f"{path} has {len(full)} pages; save the one picture to measure")
    return full[0]


def _check_page(path: Path, page: tifffile.TiffPage) -> None:
    check_size(path, page.imagewidth, page.imagelength)
    if page.photometric not in (GREY, RGB):
        raise ImageError(f"{path} is neither grey nor RGB; save it as RGB of 8 or 16 bits")
    is_known = page.dtype in (np.uint8, np.uint16, np.float16, np.float32, np.float64)
    if not is_known or page.bitspersample not in (8, 16, 32, 64) or page.imagedepth != 1:
        raise ImageError(
            f"{path} has values of {page.bitspersample} bits of a kind that is not read; "
            "save it as 8 or 16 bit integers or 32 bit floats"
        )
    if page.samplesperpixel > 4 or (page.photometric == RGB and page.samplesperpixel < 3):
        raise ImageError(f"{path} has {page.samplesperpixel} channels; save it as grey or RGB")
    if not is_whole(page, page.parent.filehandle.size):
        raise ImageError(f"{path} is cut short or damaged; copy it again from the camera")


def _unpack(path: Path, page: tifffile.TiffPage) -> NDArray[Any]:
    if page.compression in PLAIN_COMPRESSIONS and page.predictor == 1:
        values = page.asarray()
        if page.planarconfig == 2 and values.ndim == 3:
            values = np.moveaxis(values, 0, -1)
    else:
        values = _unpack_with_libtiff(path, page)
    shape = (page.imagelength, page.imagewidth)
    if values.shape[:2] != shape or values.ndim not in (2, 3):
        raise ImageError(f"{path} is a damaged TIFF; copy it again or save it anew")
    return values.astype(np.float32, copy=False) if values.dtype.kind == "f" else values


def _unpack_with_libtiff(path: Path, page: tifffile.TiffPage) -> NDArray[Any]:
    """Unpack LZW and the like, by the one of two doors to libtiff that reports damage.

    Pillow cannot hold 16-bit colours; OpenCV gives 8-bit ones with damaged rows. Both turn the
    picture as the orientation tag says, even when told not to, so the tag is blanked first.
    """
    data = np.fromfile(path, np.uint8)
    orientation = page.tags.get(ORIENTATION)
    if orientation is not None:
        upright = np.frombuffer(struct.pack(f"{page.parent.byteorder}H", 1), np.uint8)
        data[orientation.valueoffset : orientation.valueoffset + 2] = upright
    is_byte = page.dtype == np.uint8
    values = _unpack_bytes(data) if is_byte else cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if values is None or values.dtype != page.dtype:
        raise ImageError(f"{path} cannot be unpacked; copy it again or save it without compression")
    return values if is_byte else rgb_order(values)


def _unpack_bytes(data: NDArray[np.uint8]) -> NDArray[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # damaged metadata does not matter here
        with Image.open(io.BytesIO(data.tobytes())) as picture:
            return np.array(picture)
