"""One photo of a board, and what was found in it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.board import Board

Pixels = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """One photo of the board: what was found, how well it fits, or why it is not used."""

    path: Path
    picture_size: tuple[int, int] | None = None  # width, height; None when it cannot be read
    board: tuple[int, int] | None = None  # inner corners: along the long and the short side, or,
    # of a ChArUco board, along x and y
    corners: Pixels | None = None  # [N, 2] px, row by row along x; of a partial view those found
    ids: NDArray[np.int64] | None = None  # [N] which of the board's points they are; None: all
    target: Board | None = None  # what is printed on the board; a checkerboard when None
    edge_px: tuple[float, float] | None = None  # 10 to 90 % width of the edges along x, along y
    edge_shift_px: float | None = None  # how far white squares reach into the dark ones
    clipped_share: float | None = None  # of the board's inner part
    rms_px: float | None = None  # distance of the corners from those the camera predicts
    T_cam_board: NDArray[np.float64] | None = None  # [4, 4], in squares, or metres when known
    reason: str = ""  # why it is not used; empty when it is

    @property
    def is_used(self) -> bool:
        """Whether the view takes part in the calibration."""
        return not self.reason

    @property
    def corner_count(self) -> int:
        """How many corners were found."""
        return 0 if self.corners is None else len(self.corners)

    @property
    def points(self) -> NDArray[np.float64]:
        """Where the found corners are on the board, in squares [N, 3]; none without a board."""
        if self.board is None:
            return np.zeros((0, 3))
        target = self.target or Board(columns=self.board[0], rows=self.board[1])
        return target.points() if self.ids is None else target.points()[self.ids]

    @property
    def grid(self) -> Pixels:
        """Corners as they stand on the board [R, C, 2] px, NaN where one was not found."""
        columns, rows = self.board or (0, 0)
        grid = np.full((rows * columns, 2), np.nan)
        if self.corners is not None:
            grid[slice(None) if self.ids is None else self.ids] = self.corners
        return grid.reshape(rows, columns, 2)
