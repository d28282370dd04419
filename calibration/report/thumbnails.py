"""Small pictures of photos, inside the page itself."""

from base64 import b64encode
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.imaging import read_image

SIDE = 240
"""Longer side, px."""
QUALITY = 70


def thumbnail(path: Path, corners: NDArray[np.float64] | None = None) -> str | None:
    """Give a photo as a small JPEG in a data URL, with the corners that were found in it.

    None where it cannot be read; the reason stands beside it.
    """
    try:
        image = read_image(path)
    except ToolkitError:
        return None
    light = image.rgb[0].clamp_min(0).numpy()
    white = max(float(np.percentile(light[:, ::5, ::5], 99.5)), 1e-6)
    seen = np.sqrt(np.minimum(light / white, 1)).transpose(1, 2, 0)[..., ::-1]
    scale = SIDE / max(seen.shape[:2])
    small = cv2.resize(
        np.ascontiguousarray(seen), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    drawn = np.rint(255 * small).astype(np.uint8)
    for x, y in [] if corners is None else (corners * scale).tolist():
        cv2.circle(drawn, (round(x), round(y)), 2, (80, 80, 255), -1, cv2.LINE_AA)
    _, encoded = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return "data:image/jpeg;base64," + b64encode(encoded.tobytes()).decode("ascii")
