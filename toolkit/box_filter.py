"""Running means of pictures."""

import cv2
import numpy as np
import torch
from torch import Tensor


def box_mean(picture: Tensor, size: int) -> Tensor:
    """Average each channel over size x size px; the border is continued outwards.

    Args:
        picture: [B, C, H, W].
        size: odd, px.

    Returns:
        Same shape and type.
    """
    planes = picture.flatten(0, 1).contiguous().numpy()
    means = np.empty_like(planes)
    for plane, mean in zip(planes, means, strict=True):
        cv2.blur(plane, (size, size), mean, borderType=cv2.BORDER_REPLICATE)
    return torch.from_numpy(means).reshape(picture.shape)


def ring_mean(picture: Tensor) -> Tensor:
    """Average over 7 x 7 pixels without the inner 3 x 3, where demosaicing spreads own noise."""
    return box_mean(picture, 7).mul_(49).sub_(box_mean(picture, 3), alpha=9).div_(40)
