"""The streak's surroundings in blocks of pixels, and the moments of the opacity in them.

A straight streak of the disc of radius r that travels L in the picture has the variance r^2 / 4
across, and r^2 / 4 + L^2 / 12 along its path, whatever the scale of the opacity. [derived]
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.camera import Camera
from toolkit.view import StreakView

PER_HALF_WIDTH = 6
"""Blocks to a half width of the streak, where they are not too many."""
MAX_BLOCKS = 1200
"""To cover the streak's mask."""
REACH = 0.8
"""Half widths beyond the streak's mask up to which pixels are looked at, and 2 px more."""

Map = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocks:
    """Means over blocks of pixels about the streak, those where something was measured."""

    size: int  # px along a side
    half_width: float  # px, of the streak as it was found
    place: Tensor  # [N, 2] px in the picture, of the middles
    rays: Tensor  # [N, 3] unit
    change: Tensor  # [N, Q] signal - ground
    ground: Tensor  # [N, Q]
    variance: Tensor  # [N, Q] of the change, infinite where nothing was measured


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """What the moments of the opacity say of a straight streak."""

    centre: Tensor  # [2] px
    half_width: float  # px
    length: float  # px, of the travel
    direction: Tensor  # [2] unit


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
        place=place,
        rays=camera.unproject(place),
        change=mean[:, rows, columns].mT / count,
        ground=ground[:, rows, columns].mT / count,
        variance=torch.where(share > 0, variance[:, rows, columns].mT / count**2, torch.inf),
    )


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


def spread_of(blocks: Blocks, estimator: AlphaEstimator) -> Spread:
    """Describe the streak by the first and second moments of its opacity."""
    opacity = _opacity(blocks, estimator)
    centre = (opacity[:, None] * blocks.place).sum(0) / opacity.sum()
    apart = blocks.place - centre
    covariance = (opacity[:, None] * apart).mT @ apart / opacity.sum()
    covariance = covariance - torch.eye(2, dtype=torch.float64) * blocks.size**2 / 12
    (across, along), axes = torch.linalg.eigh(covariance)
    # the pixels looked at end not far beyond the streak: noise cannot make it much wider or thinner
    half_width = 2 * float(across.clamp_min(0).sqrt())
    half_width = min(max(half_width, 0.5 * blocks.half_width), 1.5 * blocks.half_width)
    length = float((12 * (along - half_width**2 / 4)).clamp_min(0).sqrt())
    return Spread(centre=centre, half_width=half_width, length=length, direction=axes[:, 1])


def _opacity(blocks: Blocks, estimator: AlphaEstimator) -> Tensor:
    """Give the opacity of every block, to a common factor where the ball's colour is open [N]."""
    weight = 1 / blocks.variance
    if estimator.unknowns():
        # all of the change has one direction, the ball's colour from the mean background
        contrast = (weight * blocks.change).sum(0) / weight.sum(0)
        contrast = contrast.expand_as(blocks.change)
    else:
        disc = Chord(offset=torch.zeros(1).double(), direction=torch.zeros(1).double())
        contrast = estimator.foreground(disc, None) - blocks.ground
    information = (weight * contrast * contrast).sum(-1)
    opacity: Tensor = (weight * contrast * blocks.change).sum(-1) / information.clamp_min(1e-12)
    # what was not measured at all says nothing
    return torch.where(information > 0, opacity, 0)
