from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.corners import View
from calibration.lens_fit import board_points
from toolkit.camera import Camera
from toolkit.imaging import write_png16
from toolkit.synthetic.boards import board_poses, render_board
from toolkit.synthetic.noise import NoiseLevel

SHARED = Path(__file__).resolve().parents[2].parent / "shared/data/checkerboard"
BOARD, SQUARE = (9, 6), 0.03
CAMERA = Camera(
    width=640,
    height=480,
    fx=560.0,
    fy=556.0,
    cx=331.0,
    cy=236.0,
    distortion=(-0.24, 0.08, 8e-4, -5e-4),
)


@dataclass(frozen=True)
class Photos:
    """Rendered photos of a board and the truth about them."""

    paths: list[Path]
    corners: list[np.ndarray]  # [54, 2] px each
    pictures: list[np.ndarray]  # [3, H, W] linear light each
    poses: list[np.ndarray]  # [4, 4], metre


@pytest.fixture(scope="session")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chess [1]")
    result = Photos(paths=[], corners=[], pictures=[], poses=[])
    for index, pose in enumerate(board_poses(6, CAMERA, BOARD, SQUARE)):
        # 3 x 3 samples a pixel would move edges by up to a sixth of a pixel
        shot = render_board(
            CAMERA, BOARD, SQUARE, pose, noise=NoiseLevel(read=0.005), seed=index, supersampling=6
        )
        path = folder / f"view{index}.png"
        picture = shot.image.rgb[0].clamp(0, 1).numpy()
        write_png16(path, picture)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = pose.rotation.numpy(), pose.translation.numpy()
        result.paths.append(path)
        result.corners.append(shot.corners.numpy())
        result.pictures.append(picture)
        result.poses.append(matrix)
    return result


@pytest.fixture(scope="session")
def opencv_left():
    return real_photos("opencv_left")


@pytest.fixture(scope="session")
def gopro_wide():
    return real_photos("gopro_wide")


@pytest.fixture(scope="session")
def charuco():
    return real_photos("charuco")


@pytest.fixture(scope="session")
def camera():
    """The camera of the rendered photos and of `make_views`."""
    return CAMERA


@pytest.fixture(scope="session")
def make_views():
    return _make_views


@pytest.fixture(scope="session")
def tilted_poses():
    return _tilted_poses


def real_photos(name):
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"the real photos of {name} are not beside the project")
    return sorted(folder.glob("*.jpg"))


def _make_views(poses, *, camera=CAMERA, noise=0.1, seed=0):
    """Views as corner finding gives them; a pose is a rotation vector and a shift in squares."""
    generator = np.random.default_rng(seed)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    views = []
    for index, (turn, shift) in enumerate(poses):
        seen = cv2.projectPoints(
            board_points(BOARD),
            np.array(turn),
            np.array(shift),
            matrix,
            np.array(camera.distortion),
        )[0][:, 0]
        corners = seen + generator.normal(0, noise, seen.shape)
        size = (camera.width, camera.height)
        views.append(
            View(path=Path(f"v{index}.png"), picture_size=size, board=BOARD, corners=corners)
        )
    return views


def _tilted_poses(count, *, lean=0.5, seed=0):
    """Poses of a board tilted every way, spread over the picture, all in view."""
    generator = np.random.default_rng(seed)
    poses = []
    for index in range(count):
        turn = lean * np.array([np.cos(2.4 * index), np.sin(2.4 * index), 0.3])
        middle = cv2.Rodrigues(turn)[0] @ np.array([4.0, 2.5, 0])
        depth = generator.uniform(11, 16)
        place = generator.uniform(-1, 1, 2) * [0.15, 0.12] * depth
        poses.append((turn, np.array([*place, depth]) - middle))
    return poses
