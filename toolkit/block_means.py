"""Pictures reduced to the means of their blocks."""

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from toolkit.demosaicing import superpixels
from toolkit.types import LinearImage

Planes = NDArray[np.floating[Any]]


def whole_periods(image: LinearImage, factor: int) -> int:
    """Give the next factor that reduces a mosaic by whole periods of its pattern."""
    period = 1 if image.pattern is None else len(image.pattern)
    return math.ceil(factor / period) * period


def block_means(image: LinearImage, factor: int) -> LinearImage:
    """Average blocks of factor x factor px; an incomplete last block is cut off.

    A block that met white anywhere counts as clipped. A mosaic reduced by whole periods of its
    pattern is not filled in for it.
    """
    if factor == 1:
        return image
    width, height = image.width // factor, image.height // factor
    area = (..., slice(height * factor), slice(width * factor))
    if image.mosaic is not None and image.pattern and factor % len(image.pattern) == 0:
        rgb = superpixels(image.mosaic[0, 0].numpy(), image.pattern, factor)
    else:
        rgb = _means(image.rgb[area][0].numpy(), factor)
    met_white = np.zeros((height, width), np.bool_)
    clipped = image.clipped[area][0, 0].numpy()
    if clipped.any():
        # the largest of the block that starts at a pixel
        block = np.ones((factor, factor), np.uint8)
        largest = cv2.dilate(clipped.view(np.uint8), block, anchor=(0, 0))
        met_white = largest[::factor, ::factor] > 0
    return replace(
        image,
        rgb=torch.from_numpy(rgb)[None],
        clipped=torch.from_numpy(met_white)[None, None],
        mosaic=None,
        pattern=None,
    )


def _means(picture: Planes, factor: int) -> Planes:
    """Average blocks of each channel of a picture [3, H, W] made of whole ones."""
    height, width = (side // factor for side in picture.shape[1:])
    means = np.empty((len(picture), height, width), picture.dtype)
    # OpenCV is quickest at halves; in memory that all channels share they stay in the cache
    is_halved = factor % 4 == 0
    half = np.empty([side // 2 for side in picture.shape[1:]] if is_halved else 0, picture.dtype)
    for plane, mean in zip(picture, means, strict=True):
        if is_halved:
            cv2.resize(plane, half.shape[::-1], half, interpolation=cv2.INTER_AREA)
        cv2.resize(half if is_halved else plane, (width, height), mean, 0, 0, cv2.INTER_AREA)
    return means
