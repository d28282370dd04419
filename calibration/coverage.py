"""Where in the picture the board was, and which way it leaned."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CELLS = 5
"""The picture is divided into CELLS x CELLS."""
LEAST_TILT = 12.0
"""Degrees from facing the camera from which a view counts as tilted."""
DIRECTIONS = ("left", "right", "up", "down")
"""Where a tilted board faces, as seen in the picture."""


def count_cells(corners: Sequence[Array], picture_size: tuple[int, int]) -> NDArray[np.int64]:
    """Count the corners in each cell of the picture, [CELLS, CELLS], row by row from the top."""
    size = np.array(picture_size)
    every = np.concatenate(list(corners))
    cells = np.clip(((every + 0.5) / size * CELLS).astype(int), 0, CELLS - 1)
    counts = np.zeros((CELLS, CELLS), dtype=np.int64)
    np.add.at(counts, (cells[:, 1], cells[:, 0]), 1)
    return counts


def facing(rotation: Array) -> Array:
    """Give how boards lean against the picture: degrees to the right and down they face, [V, 2].

    Against the picture, not the line of sight: a board that is parallel to the sensor tells nothing
    of the focal length wherever it is.

    Args:
        rotation: board to camera [V, 3, 3].
    """
    normal = rotation[..., 2]
    towards = np.where(normal[:, 2:] > 0, -normal, normal)  # to the camera
    angle = np.degrees(np.arccos(np.clip(-towards[:, 2], 0, 1)))
    across = towards[:, :2]
    length = np.maximum(np.linalg.norm(across, axis=-1), 1e-12)
    return np.asarray((angle / length)[:, None] * across)


def tilt_counts(lean: Array) -> dict[str, int]:
    """Count the views whose boards face each of `DIRECTIONS`; a slanting one counts for two."""
    right, down = lean[:, 0], lean[:, 1]
    return {
        "left": int((right < -LEAST_TILT).sum()),
        "right": int((right > LEAST_TILT).sum()),
        "up": int((down < -LEAST_TILT).sum()),
        "down": int((down > LEAST_TILT).sum()),
    }
