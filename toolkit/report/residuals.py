"""What the exact streak leaves unexplained, drawn beside the shot."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ConfigError
from toolkit.measurement import Measurement, ResidualMap
from toolkit.report.overlay import CONTOUR, Colour, Picture, draw_line, visible, write_picture
from toolkit.types import LinearImage

MORE: Colour = (213, 94, 0)
"""Where the streak shows more of the ball's light than such a ball would leave."""
LESS: Colour = (0, 114, 178)
"""Where it shows less."""
FULL = 4.0
"""Standard deviations from which a colour is full, at least; the strongest tenth is always."""
MARGIN = 1.5
"""Patches left round the streak."""
LONGER_SIDE = 800
"""px, to which the streak's part of the picture is enlarged."""
ASKED = 500
"""Patches at most whose neighbours are looked for."""
FADED = 0.25
"""Contrast of the shot below the colours."""


def draw_residuals(image: LinearImage, measurement: Measurement) -> Picture:
    """Draw the streak, enlarged, and beside it by how much each patch of it is off.

    Args:
        image: the shot, one picture.
        measurement: its exact fit left residuals.

    Returns:
        sRGB picture [H, W, 3] of 8 bits, R first: orange where the streak shows more of the ball
        than the most likely motion would leave, blue where less, the stronger the surer.

    Raises:
        ConfigError: when there are no residuals, as those of an earlier stage.
    """
    residuals = None if measurement.fit is None else measurement.fit.residuals
    if residuals is None or not residuals.sigma:
        raise ConfigError(
            f"stage {measurement.stage} leaves no residuals to draw; they belong to the exact "
            "streak, --stage sweep, and there are none where contours stood in for it"
        )
    place, side = np.array(residuals.place_px), patch_side(residuals)
    picture = visible(image)
    margin = round(MARGIN * side)
    low = np.maximum(np.floor(place.min(0)).astype(int) - margin, 0)
    high = np.ceil(place.max(0)).astype(int) + margin + 1
    shot = picture[low[1] : high[1], low[0] : high[0]]
    coloured = _coloured(shot, place - low, np.array(residuals.sigma), side)
    scale = max(1, LONGER_SIDE // max(shot.shape[:2]))
    shot, coloured = (_enlarged(part, scale) for part in (shot, coloured))
    contours = measurement.contours
    if contours is not None:
        for line in (contours.left, contours.right):
            draw_line(coloured, (np.array(line) - low + 0.5) * scale - 0.5, CONTOUR, 1)
    is_flat = shot.shape[0] < shot.shape[1]
    return np.concatenate([shot, coloured], axis=0 if is_flat else 1)


def write_residuals(path: Path, image: LinearImage, measurement: Measurement) -> None:
    """Write `draw_residuals` as a PNG, whole or not at all.

    Raises:
        ConfigError: when there are no residuals.
        EnvironmentFault: when the place cannot be written.
    """
    write_picture(path, draw_residuals(image, measurement))


def patch_side(residuals: ResidualMap) -> int:
    """Give the side of the patches, px: the distance at which most have their neighbour."""
    place = np.array(residuals.place_px)
    if len(place) < 2:
        return 1
    some = place[:: math.ceil(len(place) / ASKED)]
    gaps = [np.partition(np.hypot(*(place - one).T), 1)[1] for one in some]
    return max(1, round(float(np.median(gaps))))


def _coloured(shot: Picture, place: NDArray[Any], sigma: NDArray[Any], side: int) -> Picture:
    """Lay colours over a faded picture."""
    grey = 255 - FADED * (255 - shot.astype(float).mean(-1, keepdims=True))
    mixed = np.repeat(grey, 3, axis=-1)
    strength = np.clip(np.abs(sigma) / max(FULL, float(np.quantile(np.abs(sigma), 0.9))), 0, 1)
    for (x, y), share, value in zip(place, strength, sigma, strict=True):
        left, top = round(float(x) - side / 2 + 0.5), round(float(y) - side / 2 + 0.5)
        patch = mixed[max(top, 0) : top + side, max(left, 0) : left + side]
        patch += share * (np.array(MORE if value > 0 else LESS) - patch)
    coloured: Picture = np.rint(mixed).astype(np.uint8)
    return coloured


def _enlarged(picture: Picture, scale: int) -> Picture:
    size = (picture.shape[1] * scale, picture.shape[0] * scale)
    return np.ascontiguousarray(
        cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8
    )
