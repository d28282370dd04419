"""Pixels that show the background, whatever part of the picture the ball covers."""

import cv2
import numpy as np
import torch
from torch import Tensor

from toolkit.background import scale_background
from toolkit.ranks import ranked_value
from toolkit.types import LinearImage, Streak

LARGE_DRIFT = 0.05
"""Relative change of the light beyond which a streak is not even looked for in the old one."""
CLEAR = 0.3
"""Share of the picture that shows the background behind any ball."""
SAMPLES = 20_000
"""Pixels in which that share is looked for."""
MARGINS = (1.0, 0.5, 0.25)
"""Half widths around the streak within which pixels do not count: the first that leaves enough."""
ENOUGH = 3000
"""px left."""


def roughly_lit(image: LinearImage, background: LinearImage, light: Tensor) -> LinearImage:
    """Give the background in another light where the shot clearly was taken in that.

    Without the streak the light is only roughly known: not worth following unless it stands out.
    A ball that hides most of what is bright is taken for another light; then more of the picture
    agrees with the background as it is.

    Args:
        image: the shot.
        background: the scene without the ball.
        light: of the shot over that of the background, [3].
    """
    if not bool(((light - 1).abs() > LARGE_DRIFT).any()):
        return background
    lit = scale_background(background, light)
    return lit if _disagreement(image, lit) < _disagreement(image, background) else background


def _disagreement(image: LinearImage, background: LinearImage) -> float:
    """Give the difference below which the clear share of the picture lies."""
    step = int((image.width * image.height / SAMPLES) ** 0.5) | 1  # odd: all sites of a mosaic
    sites = (..., slice(None, None, step), slice(None, None, step))
    difference = (image.recorded[sites] - background.recorded[sites]).abs()
    return float(ranked_value(difference.flatten().numpy(), CLEAR))


def around(streak: Streak) -> Tensor:
    """Mask the streak with a margin that leaves enough of the picture [B, 1, H, W]."""
    for share in MARGINS:
        ignored = grown(streak.mask, share * float(streak.half_width))
        if ignored.numel() - np.count_nonzero(ignored.numpy()) >= ENOUGH:
            break
    return ignored


def grown(mask: Tensor, reach: float) -> Tensor:
    """Mask with everything within `reach` px of it, on a grid coarse enough to be quick."""
    step = max(1, int(reach / 4))
    coarse = np.ascontiguousarray(mask[0, 0, ::step, ::step].numpy()).view(np.uint8)
    size = 2 * (1 + round(reach / step)) + 1  # one more for what lies between the places looked at
    wide = cv2.dilate(coarse, np.ones((size, size), np.uint8))
    large = cv2.resize(wide, None, fx=step, fy=step, interpolation=cv2.INTER_NEAREST)
    return torch.from_numpy(large.view(np.bool_))[None, None, : mask.shape[-2], : mask.shape[-1]]
