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
    kernel = _row_shares(sigma, supersampling).sum(axis=1)
    return _convolve(picture, kernel)


def blur_rows(samples: Array, sigma: float, supersampling: int, lag: int) -> Array:
    """Blur sub-pixels and average them over pixels, but hand on only the light of some rows.

    Summed over all lags from -blur_reach(sigma) to blur_reach(sigma) it is the whole picture.

    Args:
        samples: [C, H * s, W * s].
        sigma: px.
        supersampling: s.
        lag: a row of pixels receives light from the row this far below it alone.

    Returns:
        [C, H, W].
    """
    channels, height, width = samples.shape
    s = supersampling
    across = _convolve(samples, _gaussian(sigma * s), np.ones(1)) if sigma > 0 else samples
    cells = across.reshape(channels, height // s, s, width // s, s).mean(axis=4)
    shares = _row_shares(sigma, s)
    sent = np.einsum("chsw,s->chw", cells, shares[lag + len(shares) // 2].astype(np.float32))
    received: Array = np.zeros_like(sent)
    target = slice(max(0, -lag), height // s - max(0, lag))
    received[:, target] = sent[:, target.start + lag : target.stop + lag]
    return received


def blur_reach(sigma: float) -> int:
    """Pixels beyond which the blur of `sigma` px carries no light."""
    return math.ceil(5 * sigma) + 1 if sigma > 0 else 0


def _row_shares(sigma: float, supersampling: int) -> NDArray[np.float64]:
    """Shares of its light that a sub-pixel hands to the pixel 0, [2 reach + 1, s].

    The sub-pixels are those of the pixels from -reach to reach of one row or column.
    """
    s, reach = supersampling, blur_reach(sigma)
    fine = _gaussian(sigma * s) if sigma > 0 else np.ones(1)
    spread = np.convolve(fine, np.ones(s)) / s  # centred on the middle of pixel 0
    padding = ((2 * reach + 1) * s - len(spread)) // 2
    return np.pad(spread, padding).reshape(2 * reach + 1, s)


def _gaussian(sigma: float) -> NDArray[np.float64]:
    """Weights on samples one apart, whose spread is `sigma` samples to the last digit."""
    reach = max(1, math.ceil(5 * sigma))
    offset = np.arange(-reach, reach + 1)
    # a Gaussian narrower than the samples' spacing has less spread once it is sampled
    low, high = 0.5 * sigma, sigma + 0.5
    for _ in range(60):
        middle = (low + high) / 2
        kernel = np.exp(-0.5 * (offset / middle) ** 2)
        kernel /= kernel.sum()
        low, high = (middle, high) if kernel @ offset**2 < sigma**2 else (low, middle)
    return np.asarray(kernel)


def _convolve(
    picture: Array, across: NDArray[np.float64], down: NDArray[np.float64] | None = None
) -> Array:
    """Filter each channel along its rows, and likewise along its columns unless told otherwise."""
    border = cv2.BORDER_REPLICATE
    down = across if down is None else down
    channels = [
        cv2.sepFilter2D(channel, cv2.CV_32F, across, down, borderType=border) for channel in picture
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
