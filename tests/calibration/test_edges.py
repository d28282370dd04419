import cv2
import numpy as np
import pytest

from calibration.edges import clipped_share, edges_of

ROWS, COLUMNS, SQUARE = 5, 6, 40


def board(*, blur=1.0, motion=0, level=200.0, noise=0.0):
    """A straight board and its corners [5, 6, 2]; motion smears along x."""
    y, x = np.mgrid[: (ROWS + 1) * SQUARE * 4, : (COLUMNS + 1) * SQUARE * 4] // (4 * SQUARE)
    ink = np.where((x + y) % 2, level, 30.0).astype(np.float32)
    picture = cv2.resize(ink, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    if motion:
        picture = cv2.blur(picture, (motion, 1))
    picture = cv2.GaussianBlur(picture, (0, 0), blur)
    picture = picture + np.random.default_rng(0).normal(0, noise, picture.shape)
    grid = np.stack(np.meshgrid(np.arange(1, COLUMNS + 1), np.arange(1, ROWS + 1)), axis=-1)
    return np.clip(picture, 0, 255).astype(np.float32), grid * SQUARE - 0.5


@pytest.mark.parametrize("blur", [1.0, 2.0, 4.0])
def test_the_width_is_that_of_a_gaussian_edge(blur):
    edges = edges_of(*board(blur=blur))
    assert edges.widths == pytest.approx((2.563 * blur, 2.563 * blur), rel=0.08)
    assert abs(edges.shift) < 0.05


def test_noise_hardly_changes_a_width():
    clean, noisy = edges_of(*board(blur=1.5)), edges_of(*board(blur=1.5, noise=4.0))
    assert noisy.widths == pytest.approx(clean.widths, rel=0.08)


def test_motion_widens_only_the_edges_across_it():
    along, down = edges_of(*board(blur=0.8, motion=9)).widths
    assert down == pytest.approx(0.8 * 9, rel=0.15)
    assert along < 2.5


def test_opencv_says_the_same():
    picture, grid = board(blur=1.8)
    corners = grid.reshape(-1, 1, 2).astype(np.float32)
    theirs = [
        cv2.estimateChessboardSharpness(
            picture.astype(np.uint8), (COLUMNS, ROWS), corners, 0.8, vertical
        )[0][0]
        for vertical in (False, True)
    ]
    assert edges_of(picture, grid).widths == pytest.approx(theirs, rel=0.1)


def test_clipped_white_reaches_into_the_dark():
    picture, grid = board(blur=1.5, level=900.0)
    unclipped = edges_of(*board(blur=1.5)).shift
    assert edges_of(picture, grid).shift > unclipped + 0.8
    assert clipped_share(picture >= 255, grid.reshape(-1, 2)) > 0.5
    assert clipped_share(board(blur=1.5)[0] >= 255, grid.reshape(-1, 2)) == 0


def test_missing_corners_leave_the_other_edges():
    picture, grid = board()
    part = grid.astype(float).copy()
    part[:2] = np.nan
    part[3, 3] = np.nan
    assert edges_of(picture, part).widths == pytest.approx(edges_of(picture, grid).widths, rel=0.05)


def test_a_picture_without_edges_says_nothing():
    _, grid = board()
    edges = edges_of(np.full((240, 280), 90.0, dtype=np.float32), grid)
    assert np.isnan([*edges.widths, edges.shift]).all()


def test_the_clipped_share_counts_the_board_alone():
    clipped = np.zeros((100, 100), dtype=bool)
    clipped[:, :50] = True
    corners = np.array([[30, 30], [69, 30], [69, 69], [30, 69]], dtype=float)
    assert clipped_share(clipped, corners) == pytest.approx(0.5, abs=0.02)
    assert clipped_share(clipped, corners - 25) > 0.95
