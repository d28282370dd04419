"""What the inputs of a shot must be, whoever gave them: numbers in range, pictures that fit."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from toolkit.errors import ConfigError, MismatchError
from toolkit.rig import Rig

if TYPE_CHECKING:
    from toolkit.types import LinearImage

RADIUS_LIMITS = (1e-6, 1e4)
EXPOSURE_LIMITS = (1e-9, 1e5)
READOUT_LIMITS = (0.0, 1e5)
"""Metre and second; beyond these lies no ball and no shutter, but a slip of the keyboard."""

Roi = tuple[int, int, int, int]


def check_numbers(ball_radius: float, settings: Rig) -> None:
    """Refuse numbers that no ball and no camera has.

    Raises:
        ConfigError: naming the number and what it may be.
    """
    for what, value, unit, limits in (
        ("ball's radius", ball_radius, "m", RADIUS_LIMITS),
        ("exposure time", settings.exposure, "s", EXPOSURE_LIMITS),
        ("readout time", settings.readout, "s", READOUT_LIMITS),
    ):
        if value is not None and not limits[0] <= value <= limits[1]:
            span = f"from {limits[0]:g} to {limits[1]:g} {unit}"
            raise ConfigError(f"the {what} is {value:g} {unit}; a number {span} is needed")
    for what, value, unit in (
        ("ball's radius", settings.ball_radius_std, "m"),
        ("exposure time", settings.exposure_std, "s"),
    ):
        if value is not None and not (math.isfinite(value) and value >= 0):
            raise ConfigError(
                f"the standard deviation of the {what} is {value:g} {unit}; "
                "zero or a positive number is needed"
            )


def check_readout(readout: float, exposure: float | None) -> None:
    """Refuse a readout that cannot be compared with any exposure time.

    A rolling shutter is seen by the share of the exposure that passes between two rows. To leave it
    out unasked would shift the result without a sign.

    Raises:
        ConfigError: when rows start one after the other, and nobody knows for how long each lasts.
    """
    if readout > 0 and exposure is None:
        raise ConfigError(
            f"a readout of {readout:g} s says nothing without the exposure time, which nobody "
            "told; give --exposure, or --readout 0 where the ball hardly moves meanwhile"
        )


def check_size(shot: Path, image: "LinearImage", other: Path, background: "LinearImage") -> None:
    """Refuse a background of another size.

    Raises:
        MismatchError: naming both files and sizes.
    """
    sizes = [f"{picture.width}x{picture.height}" for picture in (image, background)]
    if sizes[0] != sizes[1]:
        raise MismatchError(
            f"{shot} has {sizes[0]} pixels but the background {other} has {sizes[1]}; "
            "take both with the same settings"
        )


def check_roi(roi: Roi | None, image: "LinearImage") -> None:
    """Refuse a region that is not inside the picture.

    Raises:
        ConfigError: naming the region and the picture's size.
    """
    if roi is None:
        return
    left, top, width, height = roi
    fits = left + width <= image.width and top + height <= image.height
    if min(left, top) < 0 or min(width, height) <= 0 or not fits:
        raise ConfigError(
            f"roi {left},{top},{width},{height} (left, top, width, height) is not inside the "
            f"picture of {image.width}x{image.height} pixels"
        )
