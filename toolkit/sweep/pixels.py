"""The pixels about a streak: what was observed there, with its noise, and where each one looks."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.sweep.opacity import PIXEL_VARIANCE, Rays
from toolkit.view import StreakView

ROOM = 1.3
"""Half widths about the path within which pixels are looked at, and some px more."""
MORE_ROOM = 8.0
"""px."""
COARSE = 16
"""px between the places whose derivative of the ray is found; between them it is interpolated."""
NOISELESS = 10**9
"""Frames of a background whose noise counts for nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreakPixels:
    """N pixels, or squares of them, with Q signal channels."""

    place: Tensor  # [N, 2] px in the picture
    rays: Rays
    signal: Tensor  # [N, Q]
    ground: Tensor  # [N, Q]
    shot_variance: Tensor  # [N, Q], infinite where nothing was measured
    ground_variance: Tensor  # [N, Q]
    area_variance: float = PIXEL_VARIANCE  # px^2, of a place within a pixel or a square

    def __len__(self) -> int:
        """Number of pixels."""
        return len(self.place)

    def __getitem__(self, index: Tensor) -> "StreakPixels":
        """Give those with some indices."""
        return replace(
            self,
            place=self.place[index],
            rays=self.rays[index],
            signal=self.signal[index],
            ground=self.ground[index],
            shot_variance=self.shot_variance[index],
            ground_variance=self.ground_variance[index],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """The whole window about a streak, as maps; pixels are taken from it."""

    corner: tuple[int, int]  # (x, y) px in the picture
    usable: Tensor  # [H, W] bool
    signal: Tensor  # [Q, H, W]
    ground: Tensor
    shot_variance: Tensor
    ground_variance: Tensor
    camera: Camera

    @classmethod
    def of(cls, view: StreakView, estimator: AlphaEstimator, camera: Camera) -> "Frame":
        """Take the window of a view; what noise is the shot's own, the estimator says itself."""
        seen = view.observation
        quiet = replace(view.background, frames=NOISELESS)
        own = estimator.observe(view.shot, quiet, view.noise).variance[0]
        both = seen.variance[0]
        is_measured = torch.isfinite(both)
        ground_variance = torch.where(is_measured, (both - own).clamp_min(0), 0)
        return cls(
            corner=view.corner,
            usable=~view.clipped[0, 0] & is_measured.any(0),
            signal=seen.signal[0],
            ground=seen.ground[0],
            shot_variance=own,
            ground_variance=ground_variance,
            camera=camera,
        )

    def about(self, path_px: Tensor, half_width: float, bin_px: int = 1) -> StreakPixels:
        """Take the pixels about a path in the picture.

        Args:
            path_px: points of the path [T, 2] px.
            half_width: of the ball's image, px, the largest.
            bin_px: side of the squares whose pixels are averaged.
        """
        height, width = self.usable.shape
        rows, columns = height // bin_px, width // bin_px
        corner = np.array(self.corner, dtype=np.float64)
        middle = (path_px.numpy() - corner + 0.5) / bin_px - 0.5
        reach = (ROOM * half_width + MORE_ROOM) / bin_px
        mask = np.zeros((rows, columns), np.uint8)
        points = np.round(middle * 8).astype(np.int32)[:, None]
        thickness = max(1, round(2 * reach))
        cv2.polylines(mask, [points], False, 1, thickness=thickness, shift=3)
        y, x = np.nonzero(mask)
        index = torch.from_numpy(y * columns + x)
        usable = self.usable[None]
        maps = (self.signal, self.ground, self.shot_variance, self.ground_variance)
        if bin_px > 1:
            maps = _binned(maps, usable, bin_px)
            usable = torch.isfinite(maps[2]).any(0)[None]
        keep = usable.flatten()[index]
        index = index[keep]
        place = torch.stack([index % columns, index // columns], dim=-1).double()
        place = (place + 0.5) * bin_px - 0.5 + torch.from_numpy(corner)
        signal, ground, shot, empty = (m.flatten(1)[:, index].mT.double() for m in maps)
        return StreakPixels(
            place=place,
            rays=find_rays(self.camera, place),
            signal=signal,
            ground=ground,
            shot_variance=shot,
            ground_variance=empty,
            area_variance=bin_px**2 / 12,
        )


def _binned(maps: tuple[Tensor, ...], usable: Tensor, side: int) -> tuple[Tensor, ...]:
    """Average squares of pixels, each by the precision of what was measured there."""
    signal, ground, shot, empty = maps
    total = shot + empty
    weight = torch.where(usable & torch.isfinite(total), 1 / total, 0)
    shot = torch.where(weight > 0, shot, 0)
    count = side**2
    norm = _block_mean(weight, side) * count
    safe = norm.clamp_min(1e-30)

    def mean(values: Tensor, power: int = 1) -> Tensor:
        return _block_mean(values * weight**power, side) * count / safe**power

    return (
        mean(signal),
        mean(ground),
        torch.where(norm > 0, mean(shot, 2), torch.inf),
        mean(empty, 2),
    )


def _block_mean(values: Tensor, side: int) -> Tensor:
    return torch.nn.functional.avg_pool2d(values[None], side)[0]


def find_rays(camera: Camera, place: Tensor) -> Rays:
    """Give the rays of pixels [N, 2] and how they change from one to the next, distortion inside.

    The derivatives are found on a coarse grid and interpolated; with their help one step makes the
    interpolated rays exact to a millionth of a px.
    """
    low, high = place.amin(0), place.amax(0) + 1e-9
    counts = ((high - low) / COARSE).ceil().long() + 1
    counts = counts.clamp_min(2)
    x, y = (
        torch.linspace(float(a), float(b), int(n), dtype=torch.float64)
        for a, b, n in zip(low, high, counts, strict=True)
    )
    grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    coarse = torch.cat([camera.unproject(grid), camera.J_unproject(grid).flatten(-2)], dim=-1)
    fine = _interpolated(coarse, (place - low) / (high - low))
    J = fine[:, 3:].unflatten(-1, (3, 2))
    missing = place - camera.project(fine[:, :3])
    unit = torch.nn.functional.normalize(fine[:, :3] + (J @ missing[..., None])[..., 0], dim=-1)
    return Rays(unit=unit, right=J[..., 0].contiguous(), down=J[..., 1].contiguous())


def _interpolated(grid: Tensor, share: Tensor) -> Tensor:
    """Interpolate a grid [Y, X, C] at places [N, 2] from 0 to 1, bilinearly."""
    rows, columns = grid.shape[:2]
    at = share * torch.tensor([columns - 1, rows - 1], dtype=share.dtype)
    cell = at.long()
    cell[:, 0].clamp_(max=columns - 2)
    cell[:, 1].clamp_(max=rows - 2)
    (x, y), first = (at - cell)[:, :, None].unbind(1), cell[:, 1] * columns + cell[:, 0]
    flat = grid.flatten(0, 1)
    top = flat[first] + x * (flat[first + 1] - flat[first])
    bottom = flat[first + columns] + x * (flat[first + columns + 1] - flat[first + columns])
    return top + y * (bottom - top)
