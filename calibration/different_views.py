"""Views from the same place tell nothing new: how many differ."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.corners import View

Array = NDArray[np.float64]

SAME_VIEW_SHARE = 0.01
"""Views whose corners moved less than this share of the picture's diagonal count as one."""


def count_different(views: Sequence[View]) -> int:
    """Count views of which no two show the board at the same place."""
    different: list[Array] = []
    for view in views:
        corners = view.corners
        if corners is None or view.picture_size is None:
            continue
        limit = SAME_VIEW_SHARE * math.hypot(*view.picture_size)
        if all(_distance(corners, other, limit) > limit for other in different):
            different.append(corners)
    return len(different)


def _distance(corners: Array, other: Array, limit: float) -> float:
    """Mean distance of two views' corners, px, whichever end comes first; exact below `limit`."""
    if len(corners) != len(other):
        return math.inf  # partial views of different parts
    apart = float(np.hypot(*(corners.mean(axis=0) - other.mean(axis=0))))
    if apart > limit:
        return apart  # a lower bound, and quicker
    turned = (np.linalg.norm(corners - o, axis=-1).mean() for o in (other, other[::-1]))
    return float(min(turned))
