"""What is printed on a calibration board, and where its inner corners lie."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ConfigError

Kind = Literal["checker", "charuco"]

FEWEST, MOST = 3, 99
"""Inner corners along one side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A flat board of squares, chequered, with or without a marker in each white square.

    A checkerboard is named long side first: once it is turned, nothing tells 9x6 from 6x9. The
    markers of a ChArUco board tell its sides apart; it keeps the order it was printed in.
    """

    kind: Kind = "checker"
    columns: int  # inner corners along x
    rows: int  # inner corners along y
    square_m: float | None = None  # side of a square
    marker_m: float | None = None  # side of a marker
    dictionary: str | None = None  # of the markers, as OpenCV names it: DICT_6X6_250

    def __post_init__(self) -> None:
        least = 1 if self.kind == "charuco" else FEWEST
        if not (least <= min(self.size) and max(self.size) <= MOST):
            raise ConfigError(
                f"board {self.columns}x{self.rows} must have from {least} to {MOST} inner corners"
                " along each side"
            )
        for name, length in (("square", self.square_m), ("marker", self.marker_m)):
            if length is not None and not (math.isfinite(length) and length > 0):
                raise ConfigError(f"{name} is {length} m; a positive length is needed")
        if self.square_m and self.marker_m and self.marker_m >= self.square_m:
            raise ConfigError(
                f"marker {self.marker_m:g} m does not fit into a square of {self.square_m:g} m;"
                " give the side of its black frame"
            )

    @property
    def size(self) -> tuple[int, int]:
        """Inner corners along x and y."""
        return self.columns, self.rows

    @property
    def squares(self) -> tuple[int, int]:
        """Squares along x and y."""
        return self.columns + 1, self.rows + 1

    @property
    def corner_count(self) -> int:
        """How many inner corners there are."""
        return self.columns * self.rows

    @property
    def turns_onto_itself(self) -> bool:
        """Whether half a turn leaves the pattern as it is, so that no photo tells its ends apart.

        A half turn takes the first square to the last: of the same colour when the counts of
        squares are both even or both odd. Markers are never alike.
        """
        return self.kind == "checker" and (self.columns + self.rows) % 2 == 0

    def points(self) -> NDArray[np.float64]:
        """Give the inner corners in squares, z = 0 [rows * columns, 3], row by row along x."""
        y, x = np.mgrid[: self.rows, : self.columns].reshape(2, -1)
        return np.stack([x, y, np.zeros_like(x)], axis=-1).astype(np.float64)

    def __str__(self) -> str:
        if self.kind == "charuco":
            columns, rows = self.squares
            return f"ChArUco board of {columns}x{rows} squares ({self.dictionary})"
        return f"board of {self.columns}x{self.rows} inner corners"


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardRequest:
    """What is known of a board before the photos are seen; None where they shall tell."""

    kind: Kind | None = None
    size: tuple[int, int] | None = None  # inner corners in any order; of ChArUco squares along x, y
    square_m: float | None = None
    marker_m: float | None = None
    dictionary: str | None = None

    def __post_init__(self) -> None:
        if self.marker_m or self.dictionary:
            if self.kind == "checker":
                raise ConfigError("a checkerboard has no markers; leave them out, or say charuco")
            object.__setattr__(self, "kind", "charuco")
        size = self.size or (9, 6)
        if self.kind == "charuco":
            size = (size[0] - 1, size[1] - 1)
        Board(
            kind=self.kind or "checker",
            columns=size[0],
            rows=size[1],
            square_m=self.square_m,
            marker_m=self.marker_m,
        )

    @classmethod
    def of(cls, board: "tuple[int, int] | Board | BoardRequest | None") -> "BoardRequest":
        """Take a size, a board or a request for a request."""
        if isinstance(board, BoardRequest):
            return board
        if not isinstance(board, Board):
            return cls(size=board)
        return cls(
            kind=board.kind,
            size=board.squares if board.kind == "charuco" else board.size,
            square_m=board.square_m,
            marker_m=board.marker_m,
            dictionary=board.dictionary,
        )

    @property
    def marker_share(self) -> float | None:
        """Side of a marker over that of a square, where both are known."""
        if self.marker_m is None or self.square_m is None:
            return None
        return self.marker_m / self.square_m
