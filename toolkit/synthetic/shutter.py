"""When each row of the sensor is exposed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Shutter:
    """Row y is exposed from y * row_delay on; all together where that is 0."""

    exposure: float  # s, of each row
    row_delay: float  # s from one row's start to the next one's
    rows: int  # of the picture

    @property
    def is_rolling(self) -> bool:
        """Whether rows are exposed at different times."""
        return self.row_delay > 0

    @property
    def end(self) -> float:
        """When the last row's exposure ends, s."""
        return (self.rows - 1) * self.row_delay + self.exposure

    def exposes(self, time: Tensor, top: Tensor, bottom: Tensor) -> Tensor:
        """Say whether any row from `top` to `bottom` is exposed at each time [T]."""
        first, last = top.clamp_min(0), bottom.clamp_max(self.rows - 1)
        starts, stops = first * self.row_delay, last * self.row_delay + self.exposure
        return (first <= last) & (time >= starts) & (time <= stops)

    def shares(self, rows: range, time: float, length: float) -> NDArray[np.float64]:
        """Give the share of a slice of time, around `time` s, during which each row is exposed.

        Rows beyond the picture follow the same rule.
        """
        start = np.arange(rows.start, rows.stop) * self.row_delay
        opened = np.maximum(start, time - length / 2)
        closed = np.minimum(start + self.exposure, time + length / 2)
        shares: NDArray[np.float64] = np.clip((closed - opened) / length, 0, 1)
        # a whole slice counts in full, whatever its bounds were rounded to
        return np.where(shares > 1 - 1e-9, 1, shares)
