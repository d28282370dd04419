"""The scene without the ball, from stills or from a clip."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from toolkit.errors import ConfigError, ImageError, MismatchError
from toolkit.imaging.kinds import kind_of
from toolkit.imaging.reading import read_image
from toolkit.imaging.stored import to_linear
from toolkit.types import LinearImage

EXPOSURE_TOLERANCE = 0.01
"""Share by which exposure times may differ: cameras round what they write."""


def read_background(
    paths: Sequence[str | Path], *, response: str | Path | None = None
) -> LinearImage:
    """Combine pictures of the empty scene into one with less noise.

    Several stills are averaged in linear light. Of one video the median of the stored values at
    every pixel is taken, which a passing ball does not disturb; its noise variance is pi/2 times
    that of a mean, so that n frames count as 2n/pi.

    Args:
        paths: stills of one kind, or one video.
        response: as in `read_image`.

    Returns:
        One picture (B = 1); `frames` tells by how much its noise variance is smaller than a single
        picture's.

    Raises:
        ConfigError: when there is no path, or a video among several.
        ImageError: when a file cannot be read, or the background is the same everywhere.
        MismatchError: when the stills differ in size, kind or exposure time.
    """
    places = [Path(path) for path in paths]
    if not places:
        raise ConfigError("no background is given; name stills or one video of the empty scene")
    videos = [path for path in places if kind_of(path) == "video"]
    if videos and len(places) > 1:
        raise ConfigError(f"{videos[0]} is a video among several backgrounds; give it alone")
    background = _read_clip(videos[0], response) if videos else _average_stills(places, response)
    _check_content(places[0], background)
    return background


def _read_clip(path: Path, response: str | Path | None) -> LinearImage:
    from toolkit.imaging.video import read_median  # its library takes a while to load

    stored, count = read_median(path)
    frames = max(1, round(2 * count / math.pi))
    return replace(to_linear(path, stored, response), frames=frames)


def _average_stills(paths: Sequence[Path], response: str | Path | None) -> LinearImage:
    first = read_image(paths[0], response=response)
    if len(paths) == 1:
        return first
    total, clipped = first.recorded, first.clipped
    for path in paths[1:]:
        other = read_image(path, response=response)
        _check_alike(paths[0], first, path, other)
        total = total + other.recorded
        clipped = clipped | other.clipped
    return first.remade(total / len(paths), clipped=clipped, frames=len(paths))


def _check_alike(path: Path, image: LinearImage, other_path: Path, other: LinearImage) -> None:
    if image.clipped.shape != other.clipped.shape:
        raise MismatchError(
            f"backgrounds differ in size: {path} has {image.width} x {image.height} pixels, "
            f"{other_path} {other.width} x {other.height}; use pictures of one camera setting"
        )
    if (image.pattern, image.crop, image.response) != (other.pattern, other.crop, other.response):
        raise MismatchError(
            f"backgrounds {path} and {other_path} are of different kinds; use files of one kind"
        )
    times = [float(p.exposure) for p in (image, other) if p.exposure is not None]
    if len(times) == 2 and abs(times[0] - times[1]) > EXPOSURE_TOLERANCE * max(times):
        raise MismatchError(
            f"backgrounds {path} and {other_path} were exposed {times[0]:.6g} s "
            f"and {times[1]:.6g} s; use pictures of one camera setting"
        )


def _check_content(path: Path, background: LinearImage) -> None:
    low, high = torch.aminmax(background.recorded)
    if not bool(torch.isfinite(high - low)) or bool(low == high):
        raise ImageError(f"background {path} is the same everywhere; give a picture of the scene")
