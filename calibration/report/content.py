"""What a report shows, gathered from a calibration."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A photo that was not used."""

    name: str
    reason: str
    thumbnail: str | None  # data URL; None where the photo cannot be read


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One question that was put to the calibration, and its answer in plain words."""

    is_passed: bool
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelRow:
    """One lens model that was tried."""

    name: str
    board: str  # flat or bent
    terms: int
    held_out_px: float
    is_taken: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class UsedRow:
    """One photo that was used."""

    name: str
    corners: int
    rms_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Content:
    """Everything on the page."""

    picture_size: tuple[int, int]
    summary: Sequence[tuple[str, str]]  # name and value
    verdicts: Sequence[Verdict]
    advice: Sequence[str]
    cautions: Sequence[str]
    corners: Sequence[Array]  # of each view used [N, 2] px
    counts: NDArray[np.int64]  # corners in each cell of the picture
    places: Array  # of all corners used [N, 2] px
    errors: Array  # found less predicted [N, 2] px
    uncertainty: Array  # px [R, C]
    models: Sequence[ModelRow]
    left_out: Sequence[LeftOut]
    used: Sequence[UsedRow]
    curves: Sequence[tuple[str, Array, Array, Array]] = ()  # channel, brightness, light, std


def name_of(path: Path) -> str:
    """Give a photo's name as people look for it: its folder and itself."""
    return "/".join(path.parts[-2:])
