"""The gates a calibration has to pass, each in plain words with its numbers."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from calibration.coverage import CELLS, LEAST_TILT
from toolkit.camera import Camera

Array = NDArray[np.float64]

FEWEST_VIEWS = 3
ADVISED_VIEWS = 8
"""Below this many views a caution is given."""
COVERED_CELLS = 15
"""Cells of the 25 that should show a corner; the lens is extrapolated elsewhere."""
TILT_DIRECTIONS = 3
"""Of left, right, up, down."""
STEEPEST_TILT = 5.0
"""Degrees that at least one view must lean by, or nothing tells focal length from distance."""
DOUBTFUL_FOCAL_STD, WORST_FOCAL_STD = 0.005, 0.05
"""Standard deviation of a focal length over it from which a lens is doubted, or refused."""
DOUBTFUL_ERROR, WORST_ERROR = 0.0005, 0.005
"""Held-out error over the picture's diagonal from which a lens is doubted; RMS
from which it is refused."""
DOUBTFUL_DIFFERENCE = 0.0005
"""Difference of two halves' lenses over the diagonal that passes whatever was expected."""
HALVES_FACTOR = 4.0
"""Difference of the halves over what the covariance expects, from which they contradict it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """One question put to a calibration, and its answer."""

    code: str
    is_passed: bool
    is_refusal: bool  # a lens that fails it is not given at all
    value: float | None  # None where the views do not tell it
    limit: float
    text: str  # the answer in plain words, with the numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Halves:
    """How much two lenses differ, each fitted to every other view, over the picture."""

    rms_px: float
    most_px: float
    expected_px: float  # what the covariance lets one expect


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """What the gates look at."""

    camera: Camera
    views: int
    grid: NDArray[np.int64]  # [5, 5] corners in each cell
    tilts: Mapping[str, int]  # views facing left, right, up, down
    lean: Array  # [V, 2] degrees
    rms_px: float
    held_out_px: float
    halves: Halves | None


def gates_of(evidence: Evidence) -> tuple[Gate, ...]:
    """Ask every question, those that refuse first."""
    gates = [
        *_error(evidence),
        _steepest(evidence),
        *_focal(evidence.camera),
        _views(evidence.views),
        _coverage(evidence.grid),
        _tilts(evidence.tilts),
        *([_halves(evidence)] if evidence.halves else []),
        _fold(evidence.camera),
    ]
    return tuple(gates)


def focal_std(camera: Camera) -> float:
    """Give the larger relative standard deviation of the two focal lengths."""
    if camera.covariance is None:
        return math.nan
    std = camera.covariance.diagonal()[:2].sqrt() / camera.parameters[:2]
    return float(std.max())


def covers(grid: NDArray[np.int64], tilts: Mapping[str, int]) -> bool:
    """Whether places and tilts of the board pass their gates."""
    return _coverage(grid).is_passed and _tilts(tilts).is_passed


def _gate(
    code: str,
    is_passed: bool,
    text: str,
    value: float | None,
    limit: float,
    *,
    refuses: bool = False,
) -> Gate:
    return Gate(
        code=code, is_passed=is_passed, is_refusal=refuses, value=value, limit=limit, text=text
    )


def _steepest(evidence: Evidence) -> Gate:
    most = float(np.linalg.norm(evidence.lean, axis=-1).max())
    text = f"the most tilted view leans by {most:.0f} degrees"
    passed = most >= STEEPEST_TILT
    if not passed:
        text = (
            f"all views face the camera (the most tilted leans by {most:.0f} degrees), so that"
            " nothing tells the focal length from the distance; tilt the board by 20 to 45 degrees"
            " in several directions"
        )
    return _gate("faces_camera", passed, text, most, STEEPEST_TILT, refuses=True)


def _focal(camera: Camera) -> list[Gate]:
    std = focal_std(camera)
    known = f"standard deviation {100 * std:.2g} %"
    refused = _gate(
        "focal_length_open",
        bool(std < WORST_FOCAL_STD),  # False for NaN
        f"the focal length stays open ({known}); tilt the board by 20 to 45 degrees in several"
        " directions",
        std,
        WORST_FOCAL_STD,
        refuses=True,
    )
    passed = bool(std <= DOUBTFUL_FOCAL_STD)
    text = f"the focal length is known to {100 * std:.2g} %"
    if not passed:
        text = (
            f"the focal length is only known to {100 * std:.1f} %, {100 * DOUBTFUL_FOCAL_STD:g} %"
            " is good; tilt the board more strongly and bring it closer"
        )
    return [refused, _gate("focal_length_uncertain", passed, text, std, DOUBTFUL_FOCAL_STD)]


def _error(evidence: Evidence) -> list[Gate]:
    diagonal = math.hypot(evidence.camera.width, evidence.camera.height)
    error, worst, good = evidence.held_out_px, WORST_ERROR * diagonal, DOUBTFUL_ERROR * diagonal
    rms = evidence.rms_px
    refused = _gate(
        "no_lens_fits",
        rms <= worst,
        f"no lens of this model fits the corners (RMS {rms:.1f} px);"
        " check that the board is flat and that all photos are from one camera at one focal length",
        rms,
        worst,
        refuses=True,
    )
    text = f"views left out of the fit are predicted to {error:.2f} px"
    if error > good:
        text += f", {good:.2f} px is good; check focus, light and that the board is flat"
    return [refused, _gate("held_out_error", error <= good, text, error, good)]


def _views(count: int) -> Gate:
    passed = count >= ADVISED_VIEWS
    text = f"{count} views were used"
    if not passed:
        text = f"only {count} views were used; 10 to 20 make the lens surer"
    return _gate("few_views", passed, text, count, ADVISED_VIEWS)


def _coverage(grid: NDArray[np.int64]) -> Gate:
    count = int((grid > 0).sum())
    passed = count >= COVERED_CELLS
    text = f"corners lie in {count} of the picture's {CELLS} x {CELLS} cells"
    if not passed:
        text += f", {COVERED_CELLS} are good; bring the board to the picture's edges"
    return _gate("poor_coverage", passed, text, count, COVERED_CELLS)


def _tilts(tilts: Mapping[str, int]) -> Gate:
    there = [name for name, count in tilts.items() if count]
    passed = len(there) >= TILT_DIRECTIONS
    words = f"faces {', '.join(there)}" if there else "faces no side"
    text = f"tilted by {LEAST_TILT:.0f} degrees or more, the board {words}"
    if not passed:
        missing = ", ".join(name for name, count in tilts.items() if not count)
        text += f"; tilt it so that it faces {missing} too"
    return _gate("few_tilts", passed, text, len(there), TILT_DIRECTIONS)


def _halves(evidence: Evidence) -> Gate:
    halves, camera = evidence.halves, evidence.camera
    if halves is None:
        raise ValueError("halves are asked about only where there are some")
    good = DOUBTFUL_DIFFERENCE * math.hypot(camera.width, camera.height)
    limit = max(good, HALVES_FACTOR * halves.expected_px)
    passed = bool(halves.rms_px <= limit)
    text = (
        f"two lenses, each from every other view, differ by {halves.rms_px:.2f} px over the picture"
        f" (expected {halves.expected_px:.2f} px)"
    )
    if not passed:
        text += "; the views contradict each other: check focus, zoom and the board's flatness"
    return _gate("halves_differ", passed, text, halves.rms_px, limit)


def _fold(camera: Camera) -> Gate:
    right, bottom = camera.width - 1.0, camera.height - 1.0
    places = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]]
    rays = camera.unproject(torch.tensor(places, dtype=torch.float64))
    open_corners = int((~torch.isfinite(rays).all(dim=-1)).sum())
    text = "the distortion can be inverted in all corners of the picture"
    if open_corners:
        text = "the distortion cannot be inverted in the picture's corners; bring the board there"
    return _gate("distortion_folds", not open_corners, text, open_corners, 0)
