"""The least-squares fit of one lens to the corners of many views, and how well it is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import CalibrationError
from toolkit.files import one_line

Array = NDArray[np.float64]

FOLDS = 5
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-12)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensFit:
    """A lens and the pose of the board in each view; V views, N corners, K coefficients."""

    matrix: Array  # [3, 3] px
    distortion: Array  # [K]: k1 k2 p1 p2 [k3]
    rotation: Array  # [V, 3] rotation vectors, board to camera
    translation: Array  # [V, 3] squares
    view_rms: Array  # [V] px
    rms_px: float


def board_points(board: tuple[int, int]) -> Array:
    """Give the corners of a flat board of unit squares, z = 0 [R * C, 3], row by row."""
    columns, rows = board
    grid = np.mgrid[:rows, :columns].reshape(2, -1)
    return np.stack([grid[1], grid[0], np.zeros(rows * columns)], axis=-1).astype(np.float64)


def fit_lens(
    points: Array, views: Sequence[Array], picture_size: tuple[int, int], *, with_k3: bool
) -> LensFit:
    """Fit focal lengths, principal point, distortion and poses to the corners.

    Source: Zhang 2000, as in OpenCV's calibrateCameraExtended.

    Args:
        points: corners on the board [N, 3], squares.
        views: corners in each picture [N, 2] px.
        picture_size: width, height px.
        with_k3: fit k1 k2 p1 p2 k3, else k1 k2 p1 p2.

    Raises:
        CalibrationError: when the views do not determine a lens.
    """
    try:
        rms, matrix, distortion, turns, shifts, _, _, each = cv2.calibrateCameraExtended(
            [points.astype(np.float32)] * len(views),
            [corners.astype(np.float32) for corners in views],
            picture_size,
            np.eye(3),
            np.zeros(5),
            flags=0 if with_k3 else cv2.CALIB_FIX_K3,
            criteria=STOP,
        )
    except cv2.error as error:
        raise CalibrationError(
            f"the views do not determine a lens ({one_line(error)}); tilt the board more"
        ) from None
    return LensFit(
        matrix=np.asarray(matrix, dtype=np.float64),
        distortion=np.ravel(distortion)[: 5 if with_k3 else 4].astype(np.float64),
        rotation=np.reshape(turns, (-1, 3)).astype(np.float64),
        translation=np.reshape(shifts, (-1, 3)).astype(np.float64),
        view_rms=np.ravel(each).astype(np.float64),
        rms_px=float(rms),
    )


def left_out_rms(
    points: Array, views: Sequence[Array], picture_size: tuple[int, int], *, with_k3: bool
) -> float:
    """Give how well a lens predicts views it was not fitted to, px; only their poses are fitted.

    Five rounds, each leaving out every fifth view.
    """
    squares = 0.0
    for left_out in range(FOLDS):
        kept = [view for i, view in enumerate(views) if i % FOLDS != left_out]
        lens = fit_lens(points, kept, picture_size, with_k3=with_k3)
        for corners in views[left_out::FOLDS]:
            _, turn, shift = cv2.solvePnP(points, corners, lens.matrix, lens.distortion)
            turn, shift = cv2.solvePnPRefineLM(
                points, corners, lens.matrix, lens.distortion, turn, shift
            )
            seen = cv2.projectPoints(points, turn, shift, lens.matrix, lens.distortion)[0]
            squares += float(((seen[:, 0] - corners) ** 2).sum())
    return float(np.sqrt(squares / (len(views) * len(points))))


def lens_covariance(points: Array, views: Sequence[Array], lens: LensFit) -> Array:
    """Give the covariance of [fx fy cx cy, distortion...] with the poses unknown, [4 + K, 4 + K].

    The poses are removed view by view: what a pose can imitate says nothing about the lens. That
    equals the Schur complement of J'J without squaring the condition number. Scaled by the variance
    of the residuals, it takes corner errors as independent; systematic ones (a bowed board) are not
    in it. Source: derived.

    Raises:
        CalibrationError: when a parameter is not determined at all.
    """
    rows, squares = [], 0.0
    for corners, turn, shift in zip(views, lens.rotation, lens.translation, strict=True):
        seen, jacobian = cv2.projectPoints(points, turn, shift, lens.matrix, lens.distortion)
        squares += float(((seen[:, 0] - corners) ** 2).sum())
        basis, _ = np.linalg.qr(jacobian[:, :6])  # columns: rotation, translation, f, c, distortion
        rows.append(jacobian[:, 6:] - basis @ (basis.T @ jacobian[:, 6:]))
    J = np.concatenate(rows)
    scale = np.linalg.norm(J, axis=0)  # focal lengths and k2 differ by orders of magnitude
    strengths, turned = np.linalg.svd(J / scale, full_matrices=False)[1:]
    if strengths[-1] < 1e-10 * strengths[0]:
        raise CalibrationError(
            "the views leave a lens parameter open; tilt the board more, in several directions"
        )
    root = turned.T / strengths / scale[:, None]
    freedom = len(J) - J.shape[1] - 6 * len(views)
    return np.asarray(root @ root.T * (squares / freedom), dtype=np.float64)
