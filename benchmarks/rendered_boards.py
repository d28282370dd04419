"""Photos of a bent board, rendered quickly with truth, and the corners found in them.

The edges of the squares are smoothed analytically: in each pixel the board is the product of two
square waves, each blurred by the point spread and the pixel's own area as Gaussians. Inner corners
stay saddle points at their true place; where the two edges are not square to each other, the shade
right at the corner differs from exact blur, alike on opposite sides.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from calibration.corners import find_corners
from toolkit.camera import Camera
from toolkit.files import write_text
from toolkit.synthetic.boards import BoardPose, board_points, board_poses

Array = NDArray[np.float64]

BOARD, SQUARE = (9, 6), 0.03
BLUR, NOISE = 0.7, 0.01
"""Standard deviation of the point spread, px, and of the noise, share of sensor white."""
WHITE, BLACK, GROUND = 0.75, 0.05, 0.35
LENSES = {
    "plain": Camera(
        width=1024,
        height=768,
        fx=1105.0,
        fy=1101.0,
        cx=523.0,
        cy=377.0,
        distortion=(-0.19, 0.07, 6e-4, -4e-4),
    ),
    "wide": Camera(
        width=1024,
        height=768,
        fx=604.0,
        fy=602.5,
        cx=503.0,
        cy=391.0,
        distortion=(-0.27, 0.095, -3e-4, 5e-4, -0.0165),
    ),
    "fisheye": Camera(
        width=1024,
        height=768,
        fx=452.0,
        fy=451.0,
        cx=517.0,
        cy=389.0,
        distortion=(-0.021, 0.006, -0.004, 0.0007),
        model="fisheye",
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardSet:
    """The corners found in photos of one board, and the truth."""

    lens: str
    corners: list[Array]  # [54, 2] px
    true: list[Array]  # [54, 2] px


def bowl(seed: int, sag: float) -> Array:
    """Draw a bend z = a x^2 + b x y + c y^2 about the middle, m; from highest to lowest `sag` m."""
    generator = np.random.default_rng([seed, 7])
    turn, ratio = generator.uniform(0, math.pi), generator.uniform(-0.3, 1)
    axes = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    matrix = axes @ np.diag([1.0, ratio]) @ axes.T * generator.choice([-1, 1])
    shape = np.array([matrix[0, 0], 2 * matrix[0, 1], matrix[1, 1]])
    return shape * sag / np.ptp(bend(middled(board_points(BOARD, SQUARE).numpy()), shape))


def middled(points: Array) -> Array:
    """Give x and y from the board's middle."""
    columns, rows = BOARD
    return points[..., :2] - SQUARE * np.array([(columns - 1) / 2, (rows - 1) / 2])


def bend(xy: Array, shape: Array) -> Array:
    """Height of the bent board at x, y from its middle, m."""
    x, y = xy[..., 0], xy[..., 1]
    return np.asarray(shape[0] * x * x + shape[1] * x * y + shape[2] * y * y)


def render(camera: Camera, rays: Array, pose: BoardPose, shape: Array, seed: int) -> Array:
    """Render the light of one photo [H, W]; rays x/z, y/z [H, W, 2]."""
    light = np.full(rays.shape[:2], GROUND)
    window = _window(camera, pose, shape)
    place, is_front = _meet(rays[window], pose, shape)
    squares = place / SQUARE
    ink, board = np.ones(squares.shape[:2]), np.ones(squares.shape[:2])
    from_edge = np.full(squares.shape[:2], np.inf)
    for axis in (0, 1):
        value, count = squares[..., axis], BOARD[axis]
        steepness = np.hypot(*np.gradient(value)) * math.sqrt(BLUR**2 + 1 / 12)
        edge = np.clip(np.rint(value), 0, count - 1)  # the nearest inner one
        ink *= np.where(edge % 2 == 0, 1, -1) * _blurred(value - edge, steepness)
        board *= (1 + _blurred(value + 1, steepness)) * (1 + _blurred(count - value, steepness)) / 4
        from_edge = np.minimum(from_edge, np.minimum(value + 2, count + 1 - value))
    tone = WHITE - (WHITE - BLACK) * board * (1 + ink) / 2
    light[window] = np.where(is_front & (from_edge > 0), tone, GROUND)
    generator = np.random.default_rng([seed, 11])
    return np.asarray(light + NOISE * generator.standard_normal(light.shape))


def _window(camera: Camera, pose: BoardPose, shape: Array) -> tuple[slice, slice]:
    """The pixels that may show the board and its paper."""
    columns, rows = BOARD
    grid = np.mgrid[-2.0 : columns + 1.5 : 0.5, -2.0 : rows + 1.5 : 0.5].reshape(2, -1).T * SQUARE
    pixels = seen_points(camera, pose, shape, grid)
    low = np.clip(np.floor(pixels.min(0)) - 20, 0, None).astype(int)
    high = np.ceil(pixels.max(0)).astype(int) + 20
    return slice(low[1], high[1]), slice(low[0], high[0])


def _meet(rays: Array, pose: BoardPose, shape: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Where rays meet the bent board, x, y [H, W, 2] m, and whether in front of the camera."""
    r, t = pose.rotation.numpy(), pose.translation.numpy()
    direction = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ r  # board frame
    start, height = -t @ r, np.float64(0.0)
    for _ in range(4):  # the bend is slight
        along = (height - start[2]) / direction[..., 2]
        place = start[:2] + along[..., None] * direction[..., :2]
        height = np.clip(bend(middled(place), shape), -0.01, 0.01)
    return place, along > 0


def _blurred(distance: Array, width: Array) -> Array:
    """A step from -1 to 1, blurred by a Gaussian of `width`."""
    return torch.erf(torch.from_numpy(distance / (math.sqrt(2) * width + 1e-12))).numpy()


def seen_points(camera: Camera, pose: BoardPose, shape: Array, xy: Array) -> Array:
    """Give the pixels of places x, y on the bent board, [N, 2]."""
    points = np.concatenate([xy, bend(middled(xy), shape)[:, None]], axis=1)
    places = torch.from_numpy(points) @ pose.rotation.mT + pose.translation
    return camera.project(places).numpy()


def seen_corners(camera: Camera, pose: BoardPose, shape: Array) -> Array:
    """Give the true pixels of the inner corners, [54, 2]."""
    return seen_points(camera, pose, shape, board_points(BOARD, SQUARE).numpy()[:, :2])


def pixel_rays(camera: Camera) -> Array:
    """Give x/z, y/z of every pixel, [H, W, 2]; far off the axis where a fisheye shows none."""
    y, x = torch.meshgrid(
        torch.arange(camera.height).double(), torch.arange(camera.width).double(), indexing="ij"
    )
    return np.nan_to_num(camera.undistort(torch.stack([x, y], dim=-1)).numpy(), nan=1e6)


def make_set(seed: int, rays: dict[str, Array], *, views: int, sag: float) -> BoardSet:
    """Render a set of photos of one board by one lens, and find the corners."""
    name = list(LENSES)[seed % len(LENSES)]
    camera, shape = LENSES[name], bowl(seed, sag)
    found, true = [], []
    for index, pose in enumerate(board_poses(views, camera, BOARD, SQUARE, seed=seed)):
        light = render(camera, rays[name], pose, shape, 1000 * seed + index)
        grey = (255 * np.sqrt(np.clip(light, 0, 1))).astype(np.float32)
        boards = find_corners(grey, BOARD)
        if boards:
            found.append(boards[0].reshape(-1, 2))
            true.append(seen_corners(camera, pose, shape))
    return BoardSet(lens=name, corners=found, true=true)


def load_set(
    seed: int, rays: dict[str, Array], *, views: int, sag: float, folder: Path
) -> BoardSet:
    """Give a set from the folder, or make it and put it there."""
    path = folder / f"set-{seed}-{views}-{sag * 1000:g}.json"
    if path.is_file():
        kept = json.loads(path.read_text(encoding="utf-8"))
        return BoardSet(
            lens=kept["lens"],
            corners=[np.array(view) for view in kept["corners"]],
            true=[np.array(view) for view in kept["true"]],
        )
    result = make_set(seed, rays, views=views, sag=sag)
    folder.mkdir(parents=True, exist_ok=True)
    plain = {
        "lens": result.lens,
        "corners": [view.tolist() for view in result.corners],
        "true": [view.tolist() for view in result.true],
    }
    write_text(path, json.dumps(plain))
    return result
