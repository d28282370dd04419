"""Pixels that show the background, whatever part of the picture the ball covers."""

import math

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.background import MEDIAN_STD, scale_background
from toolkit.block_means import block_means, whole_periods
from toolkit.ranks import HALF_OF_NORMAL, ranked_value
from toolkit.types import LinearImage, Streak

DRIFT = 0.003
"""Relative change of the light since the background beyond which the background follows it."""
CERTAIN = 4.0
"""Its standard deviations beyond which a change is none of noise alone."""
CLEAR = 0.3
"""Share of the picture that shows the background behind any ball."""
BLOCKS = 1000
"""Of the picture, whose means are looked at."""
FEWEST = 20
"""Of them that are to agree."""
MOST_ROUNDS = 6
"""In which blocks that disagree with the light of most are left out."""
FAR = 2.5
"""Standard deviations beyond which a block does."""
SAMPLES = 20_000
"""Pixels in which that share is looked for."""
MARGINS = (1.0, 0.5, 0.25)
"""Half widths around the streak within which pixels do not count: the first that leaves enough."""
ENOUGH = 3000
"""px left."""


def clear_light(image: LinearImage, background: LinearImage) -> tuple[Tensor, Tensor]:
    """Give the ratio of shot to background where most agree on it, and its standard deviation, [3].

    The ball changes the places it covers by as many ratios as they are covered, the light all
    others by one: that about which places lie densest, however many the ball covers. Places are
    means of blocks, where a faint streak still stands out from noise. [derived]
    """
    side = max(1, int((image.width * image.height / BLOCKS) ** 0.5))
    factor = whole_periods(image, side)
    shot, ground = (block_means(picture, factor) for picture in (image, background))
    clear = ~(shot.clipped | ground.clipped)[0, 0].numpy()
    found = [
        _densest((seen[clear] - empty[clear]) / empty[clear].clip(1e-3))
        for seen, empty in zip(shot.rgb[0].numpy(), ground.rgb[0].numpy(), strict=True)
    ]
    change, std = torch.tensor(found, dtype=torch.float64).mT
    return 1 + change, std


def _densest(values: NDArray[np.float32]) -> tuple[float, float]:
    """Give where values lie densest, and the standard deviation of that."""
    ordered = np.sort(values.astype(np.float64))
    count = int(CLEAR * len(ordered))
    if count < FEWEST:
        return 0.0, math.inf
    first = int((ordered[count:] - ordered[:-count]).argmin())
    near = ordered[first : first + count + 1]
    for _ in range(MOST_ROUNDS):
        middle = float(ranked_value(near))
        spread = float(ranked_value(np.abs(near - middle))) / HALF_OF_NORMAL
        low, high = np.searchsorted(ordered, (middle - FAR * spread, middle + FAR * spread))
        if high - low <= len(near):
            break
        near = ordered[low:high]
    return middle, MEDIAN_STD * spread / len(near) ** 0.5


def is_changed(light: Tensor, std: Tensor) -> bool:
    """Say whether the light, [3], changed by more than noise alone makes of it, and worth while."""
    return bool(((light - 1).abs() > (CERTAIN * std).clamp_min(DRIFT)).any())


def is_lit_otherwise(
    image: LinearImage, background: LinearImage, light: Tensor, std: Tensor
) -> bool:
    """Say whether the shot clearly was taken in another light than the background.

    A ball that hides most of what is bright is taken for another light; then more of the picture
    agrees with the background as it is.

    Args:
        image: the shot.
        background: the scene without the ball.
        light: of the shot over that of the background, [3].
        std: its standard deviation, [3].
    """
    if not is_changed(light, std):
        return False
    lit = scale_background(background, light)
    return _disagreement(image, lit) < _disagreement(image, background)


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
    large = wide.repeat(step, 1).repeat(step, 0)
    return torch.from_numpy(large.view(np.bool_))[None, None, : mask.shape[-2], : mask.shape[-1]]
