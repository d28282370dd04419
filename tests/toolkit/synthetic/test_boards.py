import cv2
import numpy as np
import pytest
import torch

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic import BoardPose, NoiseLevel, board_points, board_poses, render_board

BOARD, SQUARE = (9, 6), 0.025
LENS = (-0.12, 0.05, 5e-4, -3e-4, 0.0)
CAMERA = Camera(width=750, height=500, fx=800, fy=800, cx=378, cy=246, distortion=LENS)


def grey(image):
    return (255 * image.rgb[0, 1].clamp(0, 1)).round().byte().numpy()


def detect(picture):
    found, corners = cv2.findChessboardCorners(picture, BOARD)
    assert found
    spacing = np.linalg.norm(np.diff(corners.reshape(6, 9, 2), axis=1), axis=-1).min()
    window = max(2, int(0.35 * spacing))
    corners = cv2.cornerSubPix(picture, corners, (window, window), (-1, -1), (3, 50, 1e-4))
    corners = corners.reshape(-1, 2)
    # a board of 9 x 6 looks the same upside down but for its colours
    return corners if corners[0].sum() < corners[-1].sum() else corners[::-1]


@pytest.mark.parametrize("index", range(3))
def test_true_corners_are_where_opencv_finds_them(index):
    pose = board_poses(3, CAMERA, BOARD, SQUARE, seed=1)[index]
    board = render_board(CAMERA, BOARD, SQUARE, pose, noise=NoiseLevel(read=0.003), seed=index)
    difference = detect(grey(board.image)) - board.corners.numpy()
    assert np.sqrt((difference**2).sum(axis=1).mean()) < 0.1
    assert np.abs(difference.mean(axis=0)).max() < 0.02


def test_corners_follow_the_pose():
    pose = BoardPose(
        rotation=torch.eye(3, dtype=torch.float64),
        translation=torch.tensor([-0.1, -0.06, 0.4]).double(),
    )
    board = render_board(CAMERA, BOARD, SQUARE, pose, noise=NoiseLevel())
    matrix = np.array([[800, 0, 378], [0, 800, 246], [0, 0, 1.0]])
    expected, _ = cv2.projectPoints(
        board_points(BOARD, SQUARE).numpy(),
        np.zeros(3),
        pose.translation.numpy(),
        matrix,
        np.array(LENS),
    )
    assert np.allclose(board.corners.numpy(), expected.reshape(-1, 2), atol=1e-8)
    # the square before the first corner is black, its neighbour white, and the paper's margin too
    x, y = board.corners[0].round().int().tolist()
    picture = board.image.rgb[0, 1]
    assert picture[y - 20, x - 20] < 0.1 < 0.7 < picture[y - 20, x + 20]
    assert picture[y - 75, x - 20] > 0.7


def test_poses_lie_inside_the_picture_spread_out_and_tilt():
    poses = board_poses(12, CAMERA, BOARD, SQUARE, seed=2)
    points = board_points(BOARD, SQUARE)
    corners = torch.stack(
        [CAMERA.project(points @ pose.rotation.mT + pose.translation) for pose in poses]
    )
    assert corners.min() > 3
    assert (corners < torch.tensor([746, 496])).all()
    spread = corners.reshape(-1, 2).amax(dim=0) - corners.reshape(-1, 2).amin(dim=0)
    assert (spread > torch.tensor([600, 380])).all()
    tilts = torch.stack([pose.rotation[2, 2] for pose in poses]).acos().rad2deg()
    assert tilts.min() > 14
    assert tilts.max() - tilts.min() > 20


def test_poses_and_pictures_repeat_with_their_seed():
    one, two = (board_poses(2, CAMERA, BOARD, SQUARE, seed=7) for _ in range(2))
    assert torch.equal(one[1].translation, two[1].translation)
    pictures = [
        render_board(CAMERA, BOARD, SQUARE, pose[1], seed=4).image.rgb for pose in (one, two)
    ]
    assert torch.equal(*pictures)


def test_a_board_outside_the_picture_is_refused():
    pose = BoardPose(
        rotation=torch.eye(3, dtype=torch.float64),
        translation=torch.tensor([1.0, 0.0, 0.4]).double(),
    )
    with pytest.raises(ConfigError, match="outside the picture"):
        render_board(CAMERA, BOARD, SQUARE, pose)


def test_a_board_that_cannot_be_placed_is_refused():
    folding = Camera(
        width=750, height=500, fx=300, fy=300, cx=378, cy=246, distortion=(-9, 0, 0, 0)
    )
    with pytest.raises(ConfigError, match="cannot be placed"):
        board_poses(1, folding, BOARD, SQUARE)
