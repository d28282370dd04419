from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.board import Board
from calibration.intrinsics import calibrate_views
from calibration.view import View

BOARD = Board(kind="charuco", columns=8, rows=6, dictionary="DICT_5X5_250")


def partial_views(count, camera, *, noise=0.1, seed=0):
    """Views of a ChArUco board that mostly reaches over the picture's edge."""
    generator = np.random.default_rng(seed)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    views = []
    for index in range(count):
        turn = 0.5 * np.array([np.cos(2.4 * index), np.sin(2.4 * index), 0.3])
        middle = cv2.Rodrigues(turn)[0] @ np.array([3.5, 2.5, 0])
        depth = generator.uniform(7, 12)
        place = generator.uniform(-1, 1, 2) * [0.4, 0.3] * depth
        shift = np.array([*place, depth]) - middle
        lens = matrix, np.array(camera.distortion)
        seen = cv2.projectPoints(BOARD.points(), turn, shift, *lens)[0][:, 0]
        seen = seen + generator.normal(0, noise, seen.shape)
        size = camera.width, camera.height
        ids = np.flatnonzero(((seen > 3) & (seen < np.array(size) - 4)).all(axis=1))
        views.append(
            View(
                path=Path(f"{index}.png"),
                picture_size=size,
                board=BOARD.size,
                target=BOARD,
                corners=seen[ids],
                ids=ids,
            )
        )
    return views


def test_parts_of_a_board_calibrate_a_camera(camera):
    views = [view for view in partial_views(16, camera) if view.corner_count >= 8]
    assert min(view.corner_count for view in views) < 40
    result = calibrate_views(views)
    assert len(result.used) == len(views)
    assert result.board == (8, 6)
    assert result.rms_px == pytest.approx(0.141, rel=0.1)
    std = result.camera.covariance.diagonal().sqrt().numpy()
    error = (result.camera.parameters - camera.parameters).numpy()
    assert (np.abs(error) < 4 * std)[:4].all()
    assert std[0] < 0.6
