"""The lens as the renderers use it: rays on a grid finer than the pixels, and the point spread."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError

Array = NDArray[np.float32]

NODE_SPACING = 8
"""Pixels between the nodes where the distortion is inverted exactly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A rectangle of whole pixels; it may reach beyond the picture."""

    left: int
    top: int
    width: int
    height: int

    def grown(self, margin: int) -> "Window":
        """Give the window with `margin` px more on every side."""
        return Window(
            left=self.left - margin,
            top=self.top - margin,
            width=self.width + 2 * margin,
            height=self.height + 2 * margin,
        )


def normalised_grid(camera: Camera, window: Window, supersampling: int) -> Tensor:
    """Give the normalised coordinates (x/z, y/z) seen by a grid of sub-pixels.

    The distortion is inverted exactly on nodes 8 px apart and interpolated between them by local
    cubics; over that distance a lens is so smooth that the error stays below a ten-thousandth of a
    pixel even at the corner of a strongly distorted picture (tested).

    Args:
        camera: the camera.
        window: the pixels to cover.
        supersampling: sub-pixels along one side of a pixel.

    Returns:
        [2, height * supersampling, width * supersampling] float64.

    Raises:
        ConfigError: where the camera's distortion cannot be inverted.
    """
    columns, across = _nodes_and_weights(window.left, window.width, supersampling)
    rows, down = _nodes_and_weights(window.top, window.height, supersampling)
    y, x = torch.meshgrid(rows, columns, indexing="ij")
    nodes = camera.undistort(torch.stack([x, y], dim=-1)).movedim(-1, 0)
    if not bool(torch.isfinite(nodes).all()):
        raise ConfigError(
            "the camera's distortion cannot be inverted over the picture;"
            " use weaker distortion or a smaller picture"
        )
    grid: Tensor = down @ nodes @ across.mT
    return grid


def unit_rays(normalised: Tensor) -> Tensor:
    """Give the unit viewing rays [3, H, W] of normalised coordinates [2, H, W]."""
    rays = torch.cat([normalised, torch.ones_like(normalised[:1])])
    return torch.nn.functional.normalize(rays, dim=0)


def mean_over_pixels(samples: Array, supersampling: int) -> Array:
    """Average sub-pixels [C, H * s, W * s] over their pixels, [C, H, W]."""
    channels, height, width = samples.shape
    s = supersampling
    cells = samples.reshape(channels, height // s, s, width // s, s)
    means: Array = cells.mean(axis=(2, 4), dtype=np.float32)
    return means


def blur(samples: Array, sigma: float) -> Array:
    """Blur each channel [C, H, W] by a Gaussian of `sigma` samples; the border is repeated."""
    return _convolve(samples, _gaussian(sigma)) if sigma > 0 else samples


def blur_pixels(picture: Array, sigma: float, supersampling: int) -> Array:
    """Blur a picture that is constant within each pixel, exactly as `blur` on its sub-pixels would.

    Args:
        picture: [C, H, W].
        sigma: px.
        supersampling: of the equivalent sub-pixel grid.
    """
    if sigma <= 0:
        return picture
    s = supersampling
    fine = _gaussian(sigma * s)
    reach = len(fine) // 2
    box = np.ones(s)
    spread = np.convolve(np.convolve(fine, box), box) / s  # from sub-pixel to sub-pixel, pixel-wide
    pixels = math.ceil((reach + s) / s)
    centre = len(spread) // 2
    padded = np.pad(spread, pixels * s)
    kernel = padded[centre::s][: 2 * pixels + 1]
    return _convolve(picture, kernel)


def blur_reach(sigma: float) -> int:
    """Pixels beyond which the blur of `sigma` px carries no light."""
    return math.ceil(5 * sigma) + 1


def _gaussian(sigma: float) -> NDArray[np.float64]:
    reach = math.ceil(5 * sigma)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(kernel / kernel.sum())


def _convolve(picture: Array, kernel: NDArray[np.float64]) -> Array:
    border = cv2.BORDER_REPLICATE
    channels = [
        cv2.sepFilter2D(channel, cv2.CV_32F, kernel, kernel, borderType=border)
        for channel in picture
    ]
    return np.stack(channels).astype(np.float32)


def _nodes_and_weights(first: int, count: int, supersampling: int) -> tuple[Tensor, Tensor]:
    """Node coordinates [M] px, and cubic weights [count * supersampling, M] to the sub-pixels."""
    nodes = torch.arange(-1, math.ceil(count / NODE_SPACING) + 3) * NODE_SPACING + first - 0.5
    s = supersampling
    at = (torch.arange(count * s, dtype=torch.float64) + 0.5) / (s * NODE_SPACING)
    cell = at.floor().long()
    t = (at - cell)[:, None]
    cubic = torch.cat(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ],
        dim=1,
    )
    weights = torch.zeros(len(at), len(nodes), dtype=torch.float64)
    weights.scatter_(1, cell[:, None] + torch.arange(4), cubic)
    return nodes.double(), weights
