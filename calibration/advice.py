"""Which further photos would help, told from the places and tilts that are missing."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.coverage import CELLS
from calibration.trust import ADVISED_VIEWS, Gate

MOST_VIEWS = 6
"""Views advised at a time."""
NUMBERS = ("no", "one", "two", "three", "four", "five", "six")
REGIONS = {
    "top left": (0, 0),
    "top right": (0, 3),
    "bottom left": (3, 0),
    "bottom right": (3, 3),
    "top": (0, 2),
    "left": (2, 0),
    "right": (2, 4),
    "bottom": (4, 2),
    "in the middle": (2, 2),
}
"""First row and column of each part of the picture; corners are 2 x 2 cells, the others one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """One further photo: where in the picture the board should be, and which way it should face."""

    place: str
    tilt: str

    @property
    def text(self) -> str:
        """In words."""
        return f"board {self.place}, tilted {self.tilt}"


def advise(
    grid: NDArray[np.int64], tilts: Mapping[str, int], views: int, gates: tuple[Gate, ...]
) -> tuple[Advice, ...]:
    """Tell which photos to add; none where every gate is passed.

    Args:
        grid: corners in each cell of the picture [5, 5].
        tilts: views facing left, right, up, down.
        views: how many were used.
        gates: the answers to what was asked of the calibration.
    """
    failed = {gate.code for gate in gates if not gate.is_passed}
    if not failed:
        return ()
    places = _empty_places(grid)
    missing = [name for name, count in tilts.items() if not count]
    wanted = max(len(places) if "poor_coverage" in failed else 0, len(missing), 2)
    wanted = min(MOST_VIEWS, max(wanted, ADVISED_VIEWS - views))
    rarest = sorted(tilts, key=lambda name: tilts[name])
    tilt_order = [*missing, *rarest, *rarest] if missing else [*rarest, *rarest]
    places += [place for place in _by_count(grid) if place not in places]
    return tuple(
        Advice(place=place, tilt=tilt)
        for place, tilt in zip(places[:wanted], tilt_order, strict=False)
    )


def advice_text(advice: tuple[Advice, ...]) -> str:
    """Give the advice in one line, empty where there is none."""
    if not advice:
        return ""
    plural = "views" if len(advice) > 1 else "view"
    each = "; ".join(one.text for one in advice)
    return f"{NUMBERS[len(advice)]} more {plural}: {each}"


def _cells(grid: NDArray[np.int64], place: str) -> NDArray[np.int64]:
    row, column = REGIONS[place]
    size = 2 if " " in place and place != "in the middle" else 1
    return grid[row : min(row + size, CELLS), column : min(column + size, CELLS)]


def _empty_places(grid: NDArray[np.int64]) -> list[str]:
    """Parts of the picture of which at least half the cells show no corner."""
    return [place for place in REGIONS if (_cells(grid, place) == 0).mean() >= 0.5]


def _by_count(grid: NDArray[np.int64]) -> list[str]:
    return sorted(REGIONS, key=lambda place: float(_cells(grid, place).mean()))
