"""JPEG: decoded strictly, so that a cut file never passes for half a picture."""

import io
import warnings
from pathlib import Path

import simplejpeg
from PIL import Image

from toolkit.errors import ImageError
from toolkit.files import one_line
from toolkit.imaging.metadata import exposure_of_block
from toolkit.imaging.stored import StoredPicture, check_size, without_alpha


def read_jpeg(path: Path) -> StoredPicture:
    """Read a JPEG, grey or colour, in the stored orientation.

    Raises:
        ImageError: when it is cut, damaged or not grey or YCbCr.
    """
    data = path.read_bytes()
    try:
        height, width, space, _ = simplejpeg.decode_jpeg_header(data)
        check_size(path, width, height)
        if space not in ("Gray", "GRAY", "YCbCr", "RGB"):
            raise ImageError(f"{path} is a {space} JPEG made for printing; save it as RGB")
        wanted = "GRAY" if space.upper() == "GRAY" else "RGB"
        values = simplejpeg.decode_jpeg(data, colorspace=wanted, strict=True)
    except (ValueError, RuntimeError) as error:
        raise ImageError(
            f"{path} is a cut or damaged JPEG ({one_line(error)}); copy it again from the camera"
        ) from None
    stored = StoredPicture(values=values, exposure=exposure_of_block(_exif(data)))
    return without_alpha(path, stored)


def _exif(data: bytes) -> bytes | None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with Image.open(io.BytesIO(data)) as picture:
                block = picture.info.get("exif")
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
            return None
    return block if isinstance(block, bytes) else None
