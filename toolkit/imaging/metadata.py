"""Exposure times from metadata, whatever state it is in."""

import io
import math
import struct
import warnings
from fractions import Fraction
from typing import Any, BinaryIO

from PIL import ExifTags, Image, TiffImagePlugin

LONGEST_EXPOSURE = 1e5
"""Seconds; more than a day is a damaged number."""

# What Pillow's TIFF parser raises on damaged metadata, found by flipping its bytes.
_PARSER_ERRORS = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
)


def exposure_time(file: BinaryIO) -> float | None:
    """Read the exposure time from a TIFF structure: a TIFF or RAW file, or the block that EXIF is.

    Both the Exif directory and the first one may hold it, and either may be wrong; the first usable
    one counts, in this order.

    Returns:
        Seconds, or None when there is none, or none that is a positive number (0, 1/0 and negative
        ones are met).
    """
    exif = Image.Exif()
    found: list[Any] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns about each damaged entry
        try:
            exif.load_from_fp(file)
            found.append(exif.get(ExifTags.Base.ExposureTime))
            found.insert(0, exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.ExposureTime))
        except _PARSER_ERRORS:
            pass  # the pictures of a file with damaged metadata may still be good
    usable = (seconds for seconds in map(_as_seconds, found) if seconds is not None)
    return next(usable, None)


def exposure_of_block(block: bytes | None) -> float | None:
    """Read the exposure time from an EXIF block, with or without its "Exif" header."""
    if not block:
        return None
    return exposure_time(io.BytesIO(block.removeprefix(b"Exif\x00\x00")))


def exif_block(seconds: float) -> bytes:
    """Build the EXIF block of a picture exposed for so many seconds, without its "Exif" header."""
    exif = Image.Exif()
    ratio = TiffImagePlugin.IFDRational(*rational(seconds))
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ExposureTime] = ratio
    return exif.tobytes().removeprefix(b"Exif\x00\x00")


def rational(seconds: float) -> tuple[int, int]:
    """Give the nearest ratio of two unsigned 32-bit integers."""
    fraction = Fraction(seconds).limit_denominator(1_000_000_000)
    if fraction.numerator >= 2**32:
        fraction = Fraction(round(seconds))
    return fraction.numerator, fraction.denominator


def _as_seconds(value: Any) -> float | None:
    try:
        seconds = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return seconds if math.isfinite(seconds) and 0 < seconds < LONGEST_EXPOSURE else None
