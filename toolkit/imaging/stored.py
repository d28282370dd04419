"""A picture as its file stores it, on the way to light."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from toolkit.errors import ImageError
from toolkit.response import LINEAR, Response, load_response
from toolkit.types import LinearImage

MAX_PIXELS = 160_000_000
"""Above the largest cameras on sale, below what fills a common memory (2 GB as float32 RGB)."""

MAX_FLOAT = 4.0
"""A float picture above this was not scaled to white = 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredPicture:
    """Decoded but not yet linear: white is an integer type's largest value, or 1 for floats."""

    values: NDArray[Any]  # [H, W] or [H, W, 3] uint8, uint16 or float32
    exposure: float | None = None  # s
    response: str | None = None  # what the file itself states about its encoding
    is_video: bool = False


def check_size(path: Path, width: int, height: int) -> None:
    """Raise `ImageError` when a header announces an empty or an absurdly large picture."""
    if min(width, height) < 1:
        raise ImageError(
            f"{path} announces {width} x {height} pixels; it is damaged, copy it again"
        )
    if width * height > MAX_PIXELS:
        raise ImageError(
            f"{path} announces {width} x {height} pixels, more than {MAX_PIXELS // 10**6} million; "
            "cut out the part that matters"
        )


def to_linear(path: Path, stored: StoredPicture, response: str | Path | None) -> LinearImage:
    """Turn a stored picture into light.

    Where nobody names the response and the file states none, 8-bit pictures and video are
    taken for sRGB, deeper ones for linear, and the result says that this is assumed; floats are
    linear by custom.

    Raises:
        ImageError: when a float picture has values that are not finite or not scaled to white = 1.
        ConfigError: when the response is unknown.
    """
    curve, is_assumed = _choose_response(stored, response)
    _check_floats(path, stored.values)
    return LinearImage(
        rgb=torch.from_numpy(curve.decode(stored.values))[None],
        clipped=torch.from_numpy(_clipped(stored.values))[None, None],
        exposure=exposure_tensor(stored.exposure),
        response=curve.name,
        response_is_assumed=is_assumed,
        curve_doubt=curve.doubt(),
    )


def exposure_tensor(seconds: float | None) -> torch.Tensor | None:
    """Give an exposure time as the [1] tensor of a picture."""
    return None if seconds is None else torch.tensor([seconds], dtype=torch.float64)


def without_alpha(path: Path, stored: StoredPicture) -> StoredPicture:
    """Drop an alpha channel that is opaque everywhere, and the axis of a single grey channel.

    Raises:
        ImageError: when some pixel is transparent: its colour is then not what a sensor saw.
    """
    values = stored.values
    if values.ndim == 2 or values.shape[2] == 3:
        return stored
    if values.shape[2] in (2, 4):
        alpha = values[..., -1]
        opaque = 1 if alpha.dtype.kind == "f" else np.iinfo(alpha.dtype).max
        if not bool((alpha == opaque).all()):
            raise ImageError(f"{path} has transparent pixels; save it without an alpha channel")
    return replace(stored, values=values[..., :3] if values.shape[2] == 4 else values[..., 0])


def _choose_response(stored: StoredPicture, response: str | Path | None) -> tuple[Response, bool]:
    if response is not None:
        return load_response(response), False
    if stored.response is not None:
        return load_response(stored.response), False
    if stored.values.dtype == np.uint8 or stored.is_video:
        return load_response("srgb"), True
    return LINEAR, stored.values.dtype.kind != "f"


def _check_floats(path: Path, values: NDArray[Any]) -> None:
    if values.dtype.kind != "f":
        return
    low, high = float(values.min()), float(values.max())  # NaN survives both
    if not np.isfinite([low, high]).all():
        raise ImageError(f"{path} has values that are not finite; write it again without them")
    if high > MAX_FLOAT:
        raise ImageError(f"{path} has values up to {high:.6g}; scale it so that sensor white is 1")


def _clipped(values: NDArray[Any]) -> NDArray[np.bool_]:
    white = 1 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    if values.ndim == 2:
        return values >= white
    met = values >= white
    return met[..., 0] | met[..., 1] | met[..., 2]
