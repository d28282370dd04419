"""What an uncertain lens does to where a fixed point of the scene is seen, in pixels."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.camera import Camera

Array = NDArray[np.float64]

COLUMNS, ROWS = 24, 18
"""Places at which the picture is sampled."""


def sample_pixels(camera: Camera, columns: int = COLUMNS, rows: int = ROWS) -> Tensor:
    """Give pixels spread over the picture from edge to edge, [rows, columns, 2]."""
    x = torch.linspace(0, camera.width - 1, columns, dtype=torch.float64)
    y = torch.linspace(0, camera.height - 1, rows, dtype=torch.float64)
    down, across = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([across, down], dim=-1)


def projection_std(camera: Camera, columns: int = COLUMNS, rows: int = ROWS) -> Array:
    """Give the standard deviation of where the camera shows fixed points of the scene.

    What a turn of the whole camera would undo is taken out first: it moves all points alike, and no
    photo of a board tells it from a turn of the board. Source: derived; as mrcal's projection
    uncertainty at infinity.

    Args:
        camera: with its covariance.
        columns: places across the picture.
        rows: places down the picture.

    Returns:
        px over both coordinates (root of the sum of variances), [rows, columns]; NaN where the
        distortion cannot be inverted, or everywhere without a covariance.
    """
    if camera.covariance is None:
        return np.full((rows, columns), np.nan)
    J, is_seen = _without_turn(camera, sample_pixels(camera, columns, rows).reshape(-1, 2))
    variance = np.full(rows * columns, np.nan)
    spread = np.einsum("nik,kl,nil->n", J, camera.covariance.numpy(), J)
    variance[is_seen] = np.maximum(spread, 0)
    return np.asarray(np.sqrt(variance).reshape(rows, columns))


def _without_turn(camera: Camera, pixels: Tensor) -> tuple[Array, NDArray[np.bool_]]:
    """Derivative of the pixels in the camera's numbers, less the turn that fits it best."""
    rays = camera.unproject(pixels)
    is_seen = torch.isfinite(rays).all(dim=-1)
    rays = rays[is_seen]
    J = camera.J_parameters(rays).numpy()
    basis, _ = np.linalg.qr(_J_turn(camera, rays).reshape(-1, 3))
    flat = J.reshape(-1, J.shape[-1])
    return (flat - basis @ (basis.T @ flat)).reshape(J.shape), is_seen.numpy()


def _J_turn(camera: Camera, rays: Tensor) -> Array:
    """Derivative of where rays [N, 3] are seen in a small turn of the camera, [N, 2, 3]."""
    J = camera.J_project(rays).numpy()
    return np.cross(rays.numpy()[:, None], J)


def projection_difference(camera: Camera, other: Camera) -> Array:
    """Give by how many pixels two cameras of one picture size show the scene elsewhere.

    The turn between them that fits best is taken out.

    Returns:
        px [ROWS * COLUMNS]; NaN where a distortion cannot be inverted.
    """
    pixels = sample_pixels(camera).reshape(-1, 2)
    rays = camera.unproject(pixels)
    shift = (other.project(rays) - pixels).numpy()
    is_seen = np.isfinite(shift).all(axis=-1)
    result = np.full(len(shift), np.nan)
    if is_seen.sum() < 3:
        return result
    turn = _J_turn(camera, rays[torch.from_numpy(is_seen)]).reshape(-1, 3)
    moved = shift[is_seen].reshape(-1)
    left = moved - turn @ np.linalg.lstsq(turn, moved, rcond=None)[0]
    result[is_seen] = np.linalg.norm(left.reshape(-1, 2), axis=-1)
    return result
