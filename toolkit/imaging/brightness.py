"""How bright a picture looks, for finding shapes in it: quicker than light, and good to the eye."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ImageError
from toolkit.imaging.jpeg import read_jpeg
from toolkit.imaging.kinds import kind_of
from toolkit.imaging.reading import read_image
from toolkit.types import LinearImage

NEARLY_WHITE = 254
"""A JPEG's brightest block ripples by one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Brightness:
    """A picture in grey, in sensor orientation."""

    grey: NDArray[Any]  # [H, W] 0..255, uint8 or float32, about even to the eye
    clipped: NDArray[np.bool_]  # [H, W]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.grey.shape[1], self.grey.shape[0]


def read_brightness(path: str | Path) -> Brightness:
    """Read a still picture in grey; a JPEG as it is stored, which is what the eye needs.

    Raises:
        ImageError: as `read_image`.
        ConfigError: when it is a video.
    """
    path = Path(path)
    if kind_of(path) != "jpeg":
        image = read_image(path)
        return Brightness(grey=_lifted(image), clipped=image.clipped[0, 0].numpy())
    try:
        values = read_jpeg(path).values
    except OSError as error:
        raise ImageError(
            f"{path} cannot be read ({error.strerror or error}); check the disk and the permissions"
        ) from None
    grey = values if values.ndim == 2 else cv2.cvtColor(values, cv2.COLOR_RGB2GRAY)
    return Brightness(grey=np.asarray(grey), clipped=np.asarray(grey) >= NEARLY_WHITE)


def _lifted(image: LinearImage) -> NDArray[np.float32]:
    """Light as the eye sees it; a dark RAW is lifted, the brightest 0.5 % clip."""
    light = image.rgb[0].mean(0).clamp_min(0).numpy()
    white = max(float(np.percentile(light[::5, ::5], 99.5)), 1e-6)
    return np.asarray(255 * np.sqrt(np.minimum(light / white, 1)), dtype=np.float32)
