"""Pictures reduced to the means of their blocks."""

import math
from dataclasses import replace

import cv2
import numpy as np
import torch

from toolkit.demosaicing import superpixels
from toolkit.types import LinearImage


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
        planes = [
            cv2.resize(plane, (width, height), interpolation=cv2.INTER_AREA)
            for plane in image.rgb[area][0].numpy()
        ]
        rgb = np.stack(planes)
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
