"""PNG: checked chunk by chunk before any decoder sees it, decoded and written in full depth."""

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from toolkit.errors import ImageError, ShapeError
from toolkit.files import write_whole
from toolkit.imaging.metadata import exif_block, exposure_of_block
from toolkit.imaging.quiet import quiet_decoders
from toolkit.imaging.stored import StoredPicture, check_size, without_alpha

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_END = len(SIGNATURE) + 25  # the IHDR chunk is always the first and 25 bytes long
PALETTE = 3
LINEAR_GAMMA = struct.pack(">I", 100_000)  # gamma 1 in a gAMA chunk


def read_png(path: Path) -> StoredPicture:
    """Read a PNG of 8 or 16 bits, grey or RGB, in the stored orientation.

    The file may state its encoding: a gAMA chunk of 1 (as `write_png16` leaves) is linear, an sRGB
    chunk is sRGB.

    Raises:
        ImageError: when it is cut or damaged, animated, has a palette, under 8 bits or transparent
            pixels.
    """
    data = path.read_bytes()
    chunks = _chunks(path, data)
    width, height, depth, kind = struct.unpack(">IIBB", chunks[b"IHDR"][:10])
    check_size(path, width, height)
    if kind == PALETTE or depth < 8:
        raise ImageError(
            f"{path} has a palette or under 8 bits; save it as 8 or 16 bit RGB or grey"
        )
    if b"acTL" in chunks:
        raise ImageError(f"{path} is an animated PNG; save the one frame to measure")
    values = _decode(path, data, (height, width), np.uint16 if depth == 16 else np.uint8)
    stored = StoredPicture(
        values=values,
        exposure=exposure_of_block(chunks.get(b"eXIf")),
        response=_stated_response(chunks),
    )
    return without_alpha(path, stored)


def write_png16(
    path: Path, rgb: NDArray[np.floating] | torch.Tensor, *, exposure_s: float | None = None
) -> None:
    """Write linear light as a 16-bit PNG that states gamma 1 and, in EXIF, the exposure time.

    Args:
        path: the new file; it appears whole or not at all.
        rgb: light [3, H, W], white = 1; below 0 and above 1 it is clipped.
        exposure_s: exposure time, second; None leaves it out.

    Raises:
        ShapeError: when the array is not [3, H, W].
        ImageError: when a value is not finite.
        EnvironmentFault: when the file cannot be written.
    """
    light = np.asarray(rgb.detach().cpu() if isinstance(rgb, torch.Tensor) else rgb)
    if light.ndim != 3 or light.shape[0] != 3:
        raise ShapeError(f"rgb has shape {list(light.shape)}, but [3, H, W] is needed")
    if not np.isfinite(light).all():
        raise ImageError(f"{path} cannot hold values that are not finite; remove them first")
    stored = np.rint(np.clip(light[::-1], 0, 1) * 65535).astype(np.uint16).transpose(1, 2, 0)
    # Little compression: noise does not shrink, and the default takes ten times as long.
    _, encoded = cv2.imencode(".png", stored, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    data = encoded.tobytes()
    extra = _chunk(b"gAMA", LINEAR_GAMMA)
    if exposure_s is not None:
        extra += _chunk(b"eXIf", exif_block(exposure_s))
    with write_whole(Path(path)) as temporary:
        temporary.write_bytes(data[:HEADER_END] + extra + data[HEADER_END:])


def _chunks(path: Path, data: bytes) -> dict[bytes, bytes]:
    """Give the first chunk of each type, after checking every checksum up to the end chunk."""
    found: dict[bytes, bytes] = {}
    view = memoryview(data)
    start = len(SIGNATURE)
    while b"IEND" not in found:
        if start + 12 > len(data):
            raise ImageError(f"{path} is cut short; copy it again from the camera")
        (length,) = struct.unpack_from(">I", data, start)
        body = view[start + 4 : start + 8 + length]  # type and content, what the checksum covers
        stop = start + 12 + length
        if stop > len(data) or zlib.crc32(body) != struct.unpack_from(">I", data, stop - 4)[0]:
            raise ImageError(f"{path} is cut or damaged at byte {start}; copy it again")
        name = bytes(body[:4])
        found.setdefault(name, b"" if name == b"IDAT" else bytes(body[4:]))
        start = stop
    if len(found.get(b"IHDR", b"")) != 13 or b"IDAT" not in found:
        raise ImageError(f"{path} is a PNG without a picture; copy it again")
    return found


def _decode(
    path: Path, data: bytes, size: tuple[int, int], dtype: type[np.generic]
) -> NDArray[Any]:
    try:
        with quiet_decoders():
            values = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ImageError(f"{path} cannot be decoded ({error.err}); copy it again") from None
    if values is None or values.shape[:2] != size or values.dtype != dtype:
        raise ImageError(f"{path} is a damaged PNG; copy it again from the camera")
    return rgb_order(values)


def rgb_order(values: NDArray[Any]) -> NDArray[Any]:
    """Turn OpenCV's B G R (A) into R G B (A); grey stays."""
    if values.ndim == 3 and values.shape[2] >= 3:
        return values[..., [2, 1, 0, 3][: values.shape[2]]]
    return values


def _stated_response(chunks: dict[bytes, bytes]) -> str | None:
    if chunks.get(b"gAMA") == LINEAR_GAMMA:
        return "linear"
    return "srgb" if b"sRGB" in chunks else None


def _chunk(name: bytes, content: bytes) -> bytes:
    body = name + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))
