"""Rendered photos of a checkerboard, with the true place of every inner corner."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic.backgrounds import textured_background
from toolkit.synthetic.lens import Array, Window, blur, mean_over_pixels, normalised_grid
from toolkit.synthetic.noise import NoiseLevel, add_noise
from toolkit.synthetic.paths import turned
from toolkit.types import LinearImage

WHITE, BLACK = 0.75, 0.05
"""Light from paper and from ink, share of sensor white."""
BORDER = 1
"""White paper around the squares, in squares."""
MARGIN = 8
"""Pixels around the board's outermost points that are rendered too."""
BAND = 256
"""Rows rendered at a time, so that the memory stays small at any picture size."""
ATTEMPTS = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPose:
    """Where a board is: its point X lies at rotation X + translation in the camera frame."""

    rotation: Tensor  # [3, 3]
    translation: Tensor  # [3] m


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedBoard:
    """A photo of a board and the truth about it."""

    image: LinearImage
    corners: Tensor  # [R * C, 2] px, row by row along the board's columns
    pose: BoardPose


def board_points(board: tuple[int, int], square: float) -> Tensor:
    """Give the inner corners of a board of (columns, rows) of them, [rows * columns, 3] m.

    The first corner is the origin; x runs along a row, y from row to row, z away from the viewer.
    """
    columns, rows = board
    y, x = torch.meshgrid(
        torch.arange(rows, dtype=torch.float64),
        torch.arange(columns, dtype=torch.float64),
        indexing="ij",
    )
    return square * torch.stack([x, y, torch.zeros_like(x)], dim=-1).reshape(-1, 3)


def render_board(
    camera: Camera,
    board: tuple[int, int],
    square: float,
    pose: BoardPose,
    *,
    blur_px: float = 0.7,
    noise: NoiseLevel | None = None,
    supersampling: int = 3,
    exposure: float = 0.01,
    seed: int = 0,
) -> RenderedBoard:
    """Render a photo of a checkerboard: every sub-pixel's ray is followed to the board.

    Args:
        camera: the camera, with its distortion.
        board: inner corners (columns, rows).
        square: side of a square, metre.
        pose: where the board is.
        blur_px: standard deviation of the lens's point spread, px.
        noise: of the sensor; 1 % of white when None.
        supersampling: rays along one side of a pixel.
        exposure: exposure time the picture carries, second.
        seed: draws noise and background.

    Raises:
        ConfigError: when a corner lies outside the picture.
    """
    points = board_points(board, square) @ pose.rotation.mT + pose.translation
    corners = camera.project(points)
    size = torch.tensor([camera.width, camera.height])
    if not bool(((corners > -0.5) & (corners < size - 0.5)).all() and (points[:, 2] > 0).all()):
        raise ConfigError("a corner of the board lies outside the picture; choose another pose")
    grey = textured_background(camera.width, camera.height, contrast=0.08, seed=seed).numpy()
    sharp = _lay_board(grey, camera, board, square, pose, supersampling)
    clean = torch.from_numpy(blur(sharp, blur_px))
    rgb = add_noise(clean, noise or NoiseLevel(read=0.01), seed)[None]
    image = LinearImage(
        rgb=rgb,
        clipped=(rgb >= 1).any(dim=1, keepdim=True),
        exposure=torch.tensor([exposure], dtype=torch.float64),
    )
    return RenderedBoard(image=image, corners=corners, pose=pose)


def board_poses(
    count: int, camera: Camera, board: tuple[int, int], square: float, *, seed: int = 0
) -> list[BoardPose]:
    """Draw poses that tilt the board every way and spread it over the picture, wholly inside it.

    Args:
        count: how many.
        camera: the camera that will look.
        board: inner corners (columns, rows).
        square: side of a square, metre.
        seed: equal seeds give equal poses.

    Raises:
        ConfigError: when the board cannot be placed inside the picture.
    """
    generator = np.random.default_rng([seed, 301])
    return [_draw_pose(index, camera, board, square, generator) for index in range(count)]


def _draw_pose(
    index: int,
    camera: Camera,
    board: tuple[int, int],
    square: float,
    generator: np.random.Generator,
) -> BoardPose:
    """Try places near one of nine targets until the board is inside; shrink it as attempts fail."""
    # tilts of 15 to 45 degrees, their axes a golden angle apart: no two views look alike
    lean = math.radians(15 + 30 * ((index * 0.618) % 1))
    azimuth = index * math.pi * (3 - math.sqrt(5))
    target = np.array([index % 3 - 1, (index * 2 // 3) % 3 - 1]) * 0.3
    for attempt in range(ATTEMPTS):
        share = generator.uniform(0.5, 0.95) * 0.3 ** (attempt / ATTEMPTS)
        turn = generator.uniform(-0.3, 0.3)
        place = target + generator.uniform(-0.15, 0.15, size=2)
        pose = _pose(camera, board, square, lean, azimuth, turn, share, place)
        if _is_inside(camera, board, square, pose):
            return pose
    raise ConfigError(
        f"a board of {board[0]}x{board[1]} corners cannot be placed inside the picture;"
        " use less distortion"
    )


def _pose(
    camera: Camera,
    board: tuple[int, int],
    square: float,
    lean: float,
    azimuth: float,
    turn: float,
    share: float,
    place: NDArray[np.float64],
) -> BoardPose:
    """A board that fills `share` of the picture, its middle at `place`, -0.5..0.5 of the sides."""
    axis = torch.tensor([math.cos(azimuth), math.sin(azimuth), 0.0], dtype=torch.float64)
    rotation = _rotation(axis * lean) @ _rotation(
        torch.tensor([0.0, 0.0, turn], dtype=torch.float64)
    )
    length = square * torch.tensor([board[0] + 1, board[1] + 1], dtype=torch.float64)
    picture = torch.tensor([camera.width / camera.fx, camera.height / camera.fy]).double()
    depth = float((length / picture).max()) / share
    centre = torch.tensor(
        [
            (camera.width * (0.5 + place[0]) - camera.cx) / camera.fx,
            (camera.height * (0.5 + place[1]) - camera.cy) / camera.fy,
            1.0,
        ],
        dtype=torch.float64,
    )
    middle = board_points(board, square).mean(dim=0)
    return BoardPose(rotation=rotation, translation=centre * depth - rotation @ middle)


def _outline(board: tuple[int, int], square: float, pose: BoardPose, squares: int) -> Tensor:
    """The board's corners and those of `squares` squares around them, camera frame [N, 3] m."""
    columns, rows = board
    corner = torch.tensor([square * squares, square * squares, 0.0])
    points = board_points((columns + 2 * squares, rows + 2 * squares), square) - corner
    outline: Tensor = points @ pose.rotation.mT + pose.translation
    return outline


def _is_seen(camera: Camera, points: Tensor) -> bool:
    """Whether all points are where the lens can be inverted; past that it shows them elsewhere."""
    if bool((points[:, 2] <= 0).any()):
        return False
    back = camera.undistort(camera.project(points)) - points[:, :2] / points[:, 2:]
    return bool((back.abs() < 1e-6).all())


def _is_inside(camera: Camera, board: tuple[int, int], square: float, pose: BoardPose) -> bool:
    """Whether all squares lie in the picture."""
    points = _outline(board, square, pose, squares=1)
    pixels = camera.project(points)
    size = torch.tensor([camera.width, camera.height])
    is_within = bool(((pixels > 3) & (pixels < size - 4)).all())
    return is_within and _is_seen(camera, points)


def _lay_board(
    grey: Array,
    camera: Camera,
    board: tuple[int, int],
    square: float,
    pose: BoardPose,
    supersampling: int,
) -> Array:
    """Give the background [3, H, W] with the sharp board in front of it."""
    paper = _outline(board, square, pose, squares=1 + BORDER)
    size = torch.tensor([camera.width, camera.height])
    low, high = 0 * size, size
    if _is_seen(camera, paper):  # its edges curve by less than the margin between its points
        pixels = camera.project(paper)
        low = (pixels.amin(dim=0) - MARGIN).long().clamp_min(0)
        high = torch.minimum((pixels.amax(dim=0) + MARGIN).long(), size)
    (left, top), (right, bottom) = low.tolist(), high.tolist()
    picture = grey.copy()
    for row in range(top, bottom, BAND):
        height = min(BAND, bottom - row)
        window = Window(left=left, top=row, width=right - left, height=height)
        light, covered = _look_up(camera, window, board, square, pose, supersampling)
        part = picture[:, row : row + height, left:right]
        part *= 1 - covered
        part += light
    return picture


def _look_up(
    camera: Camera,
    window: Window,
    board: tuple[int, int],
    square: float,
    pose: BoardPose,
    supersampling: int,
) -> tuple[Array, Array]:
    """The board's light in a window, and the share of each pixel that it covers, both [h, w]."""
    x, y = normalised_grid(camera, window, supersampling).float().numpy()
    r, t = pose.rotation.numpy(), pose.translation.numpy()
    # from the board's plane to the ray: [r1 r2 t]; its inverse leads from the ray to the plane
    H = np.linalg.inv(np.stack([r[:, 0], r[:, 1], t], axis=1)).astype(np.float32)
    scale = 1 / (np.float32(square) * (H[2, 0] * x + H[2, 1] * y + H[2, 2]))
    column = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) * scale
    row = (H[1, 0] * x + H[1, 1] * y + H[1, 2]) * scale
    ink, paper = _ink_and_paper(column, row, scale > 0, board)
    light = np.where(ink, np.float32(BLACK), np.float32(WHITE) * paper)
    shares = mean_over_pixels(np.stack([light, paper.astype(np.float32)]), supersampling)
    return shares[0], shares[1]


def _ink_and_paper(
    column: Array,
    row: Array,
    is_in_front: NDArray[np.bool_],
    board: tuple[int, int],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which places on the plane, in squares from the first corner, are ink, and which paper."""
    columns, rows = board
    from_edge = np.minimum(
        np.minimum(column + 1, columns - column), np.minimum(row + 1, rows - row)
    )
    is_square = (from_edge > 0) & is_in_front
    ink = is_square & ((np.floor(column) + np.floor(row)) % 2 == 0)
    return ink, (from_edge > -BORDER) & is_in_front


def _rotation(vector: Tensor) -> Tensor:
    """Rotation matrix [3, 3] about `vector` [3] by its length, rad."""
    identity = torch.eye(3, dtype=torch.float64)
    angle = torch.linalg.vector_norm(vector)
    return torch.cat([turned(column, vector, angle[None]) for column in identity]).mT
