"""The streak's surroundings in blocks of pixels: few numbers that say nearly as much."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.view import StreakView

PER_HALF_WIDTH = 6
"""Blocks to a half width of the streak, where they are not too many."""
MAX_BLOCKS = 1200
"""To cover the streak's mask."""
REACH = 0.8
"""Half widths beyond the streak's mask up to which pixels are looked at, and 2 px more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocks:
    """Means over blocks of pixels about the streak, those where something was measured."""

    size: int  # px along a side
    half_width: float  # px, of the streak as it was found
    half_angle: float  # radians, the same
    place: Tensor  # [N, 2] px in the picture, of the middles
    rays: Tensor  # [N, 3] unit
    change: Tensor  # [N, Q] signal - ground
    ground: Tensor  # [N, Q]
    variance: Tensor  # [N, Q] of the change, infinite where nothing was measured


def block_pixels(view: StreakView, camera: Camera) -> Blocks:
    """Average what was observed about the streak over blocks."""
    half_width = float(view.streak.half_width)
    enough = (float(view.streak.mask.sum()) / MAX_BLOCKS) ** 0.5
    size = max(1, round(max(half_width / PER_HALF_WIDTH, enough)))
    seen = view.observation
    near = _near(view, REACH * half_width + 2)
    usable = near & ~view.clipped[0] & torch.isfinite(seen.variance[0])  # [Q, h, w]
    weight = _sums(usable.double(), size)
    mean, ground, variance = (
        _sums(torch.where(usable, values[0].double(), 0), size)
        for values in (seen.signal - seen.ground, seen.ground, seen.variance)
    )
    rows, columns = (weight.amax(0) > 0).nonzero(as_tuple=True)
    share = weight[:, rows, columns].mT
    count = share.clamp_min(1)
    left, top = view.corner
    place = torch.stack([columns, rows], dim=-1) * size + (size - 1) / 2
    place = place.double() + torch.tensor([left, top], dtype=torch.float64)
    return Blocks(
        size=size,
        half_width=half_width,
        half_angle=_angle(camera, place.mean(0), half_width),
        place=place,
        rays=camera.unproject(place),
        change=mean[:, rows, columns].mT / count,
        ground=ground[:, rows, columns].mT / count,
        variance=torch.where(share > 0, variance[:, rows, columns].mT / count**2, torch.inf),
    )


def _angle(camera: Camera, place: Tensor, half_width: float) -> float:
    """Give the angle of half a width about a place [2] px."""
    aside = torch.tensor([half_width, 0.0], dtype=place.dtype)
    left, right = camera.unproject(torch.stack([place - aside, place + aside]))
    return float((torch.linalg.vector_norm(right - left) / 2).asin())


def _near(view: StreakView, reach: float) -> Tensor:
    """Tell which pixels of the window lie within `reach` px of the streak's mask [1, h, w]."""
    left, top = view.corner
    height, width = view.clipped.shape[-2:]
    mask = view.streak.mask[0, 0, top : top + height, left : left + width].numpy()
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return torch.from_numpy(distance <= reach)[None]


def _sums(values: Tensor, size: int) -> Tensor:
    """Add up blocks of [Q, h, w]; an incomplete last block is left out."""
    height, width = (side // size for side in values.shape[-2:])
    whole = values[:, : height * size, : width * size]
    return whole.reshape(-1, height, size, width, size).sum((2, 4))
