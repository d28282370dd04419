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
    planes = [
        cv2.blur(np.ascontiguousarray(plane), (size, size), borderType=cv2.BORDER_REPLICATE)
        for plane in picture.flatten(0, 1).numpy()
    ]
    return torch.from_numpy(np.stack(planes)).reshape(picture.shape)
