"""The pixels about a streak: what was observed there, with its noise, and where each one looks."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.sweep.opacity import PIXEL_VARIANCE
from toolkit.sweep.passage import Rays
from toolkit.view import StreakView

Array = NDArray[np.float64]

ROOM = 3.0
"""px beyond the ball's image within which pixels may see it, and what the path is uncertain by."""
BESIDE = 1.3
"""Half widths beyond these within which pixels tell of the background's light, and 8 px more."""
OUTLIER = 3.5
"""Standard deviations beyond which such a pixel's difference counts linearly."""
COARSE = 16
"""px between the places whose derivative of the ray is found; between them it is interpolated."""
LITTLE = 0.03
"""px by which interpolated rays may miss their pixels for one step to bring them there."""
MOST_STEPS = 3
NOISELESS = 10**9
"""Frames of a background whose noise counts for nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """What the pixels beside the streak say of gain and offset: a quadratic about (1, 0)."""

    cost: float
    gradient: Tensor  # [2 Q] half of the cost's
    information: Tensor  # [2 Q, 2 Q]

    @classmethod
    def of(cls, signal: Tensor, ground: Tensor, shot: Tensor, empty: Tensor) -> "Beside":
        """Sum up pixels [Q, N] that the ball never covers; of the backgrounds the likeliest."""
        residual = signal - ground
        precision = 1 / (shot + empty)
        size = residual.abs() * precision.sqrt()
        weight = precision * (OUTLIER / size.clamp_min(OUTLIER))
        likeliest = ground + empty * residual * precision
        of_gain, of_both, of_offset = ((weight * likeliest**power).sum(-1) for power in (2, 1, 0))
        pull_gain, pull_offset = ((weight * residual * likeliest**n).sum(-1) for n in (1, 0))
        information = torch.cat(
            [
                torch.cat([torch.diag(of_gain), torch.diag(of_both)], dim=1),
                torch.cat([torch.diag(of_both), torch.diag(of_offset)], dim=1),
            ]
        )
        return cls(
            cost=float((weight * residual**2).sum()),
            gradient=-torch.cat([pull_gain, pull_offset]),
            information=information,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StreakPixels:
    """N pixels, or squares of them, that the ball may cover, with Q signal channels."""

    place: Tensor  # [N, 2] px in the picture
    rays: Rays
    signal: Tensor  # [Q, N]
    ground: Tensor  # [Q, N]
    shot_variance: Tensor  # [Q, N], infinite where nothing was measured
    ground_variance: Tensor  # [Q, N]
    ground_slope: Tensor  # [2, Q, N] change of the ground to the right and downwards, per px
    beside: Beside
    mixed: Tensor  # [Q, N] what the lens adds where the ball's rim lies before a varying ground
    side: int = 1  # px of each square
    excess: float = 1.0  # by which the variances exceed the camera's noise

    @property
    def area_variance(self) -> float:
        """Variance of a place within a square along its side, px^2."""
        return PIXEL_VARIANCE * self.side**2

    def __len__(self) -> int:
        """Number of pixels."""
        return len(self.place)

    def behind_lens(self, opacity_slope: Tensor, spread: float) -> "StreakPixels":
        """Give the same where the lens mixes the ball's rim with the ground beside it.

        Over a pixel's spread both opacity and ground change; what is left of the ground's light is
        the mean of a product, other than the product of the means by their joint change. [derived]

        Args:
            opacity_slope: change of the opacity to the right and downwards [2, N], per px.
            spread: variance of lens and single pixel, px^2.
        """
        spread = spread + self.area_variance - PIXEL_VARIANCE
        return replace(self, mixed=-spread * (opacity_slope[:, None] * self.ground_slope).sum(0))


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
    excess: float = 1.0
    """By which the variances exceed the camera's noise, since the model misses by as much."""

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

    def noisier(self, factor: float) -> "Frame":
        """Give the same with all variances multiplied."""
        return replace(
            self,
            shot_variance=self.shot_variance * factor,
            ground_variance=self.ground_variance * factor,
            excess=self.excess * factor,
        )

    def about(
        self, path_px: Tensor, half_width: Tensor | float, *, side: int = 1, doubt: float = 0.0
    ) -> StreakPixels:
        """Take the pixels about a path in the picture.

        Args:
            path_px: points of the path [T, 2] px.
            half_width: of the ball's image at each of them [T], or at all, px.
            side: of the squares whose pixels are averaged.
            doubt: px by which the path and the half width may be off.
        """
        height, width = self.usable.shape
        rows, columns = height // side, width // side
        corner = np.array(self.corner, dtype=np.float64)
        middle = (path_px.numpy() - corner + 0.5) / side - 0.5
        size = np.broadcast_to(np.asarray(half_width, dtype=np.float64), len(middle))
        reach = (size + ROOM + doubt) / side + 1
        near = _band(middle, reach, rows, columns)
        ring = _band(middle, reach + (BESIDE * size + 8) / side, rows, columns) - near
        usable = self.usable[None]
        maps: tuple[Tensor, ...]
        maps = (self.signal, self.ground, self.shot_variance, self.ground_variance)
        if side > 1:
            maps = _binned(maps, usable, side)
            usable = torch.isfinite(maps[2]).any(0)[None]
        inside, beside = (
            torch.from_numpy(np.flatnonzero(mask & usable[0].numpy())) for mask in (near, ring)
        )
        place = torch.stack([inside % columns, inside // columns], dim=-1).double()
        place = (place + 0.5) * side - 0.5 + torch.from_numpy(corner)
        signal, ground, shot, empty = (m.flatten(1)[:, inside].double() for m in maps)
        return StreakPixels(
            place=place,
            rays=find_rays(self.camera, place),
            signal=signal,
            ground=ground,
            shot_variance=shot,
            ground_variance=empty,
            ground_slope=_slopes(maps[1]).flatten(2)[..., inside].double() / side,
            mixed=torch.zeros_like(signal),
            beside=Beside.of(*(m.flatten(1)[:, beside].double() for m in maps)),
            side=side,
            excess=self.excess,
        )


def _band(middle: Array, reach: Array, rows: int, columns: int) -> NDArray[np.uint8]:
    """Mark all within reach [T] of a line [T, 2], its places in squares."""
    mask = np.zeros((rows, columns), np.uint8)
    points = np.round(middle * 8).astype(np.int32)
    widths = np.maximum(1, np.ceil(2 * np.maximum(reach[:-1], reach[1:]))).astype(np.int32)
    for first, last, width in zip(points[:-1], points[1:], widths, strict=True):
        cv2.line(mask, first.tolist(), last.tolist(), 1, thickness=int(width), shift=3)
    return mask


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


def _slopes(maps: Tensor) -> Tensor:
    """Give the change of each map [Q, H, W] to the right and downwards, per element [2, Q, H, W].

    Across the difference three elements are averaged, since noise changes from one to the next.
    """
    wide = torch.nn.functional.pad(maps[None], (1, 1, 1, 1), mode="replicate")[0]
    right = (wide[..., 2:] - wide[..., :-2]) / 2
    down = (wide[..., 2:, :] - wide[..., :-2, :]) / 2
    return torch.stack(
        [
            (right[:, :-2] + 2 * right[:, 1:-1] + right[:, 2:]) / 4,
            (down[..., :-2] + 2 * down[..., 1:-1] + down[..., 2:]) / 4,
        ]
    )


def _block_mean(values: Tensor, side: int) -> Tensor:
    return torch.nn.functional.avg_pool2d(values[None], side)[0]


def find_rays(camera: Camera, place: Tensor) -> Rays:
    """Give the rays of pixels [N, 2] and how they change from one to the next, distortion inside.

    The derivatives are found on a coarse grid and interpolated; with their help one step, behind a
    wide lens two, makes the interpolated rays exact to a millionth of a px.
    """
    low, high = place.amin(0), place.amax(0) + 1e-9
    counts = ((high - low) / COARSE).ceil().long() + 1
    counts = counts.clamp_min(2)
    x, y = (
        torch.linspace(float(a), float(b), int(n), dtype=torch.float64)
        for a, b, n in zip(low, high, counts, strict=True)
    )
    grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    rays, J = camera.unproject(grid), camera.J_unproject(grid)
    fine = _interpolated(torch.cat([rays, J.mT.flatten(-2)], dim=-1), (place - low) / (high - low))
    unit, right, down = fine.reshape(3, 3, -1)
    for _ in range(MOST_STEPS):
        missing = (place - camera.project(unit.mT)).mT
        unit = unit + missing[0] * right + missing[1] * down
        unit = unit * (unit * unit).sum(0).rsqrt()
        if not float(missing.abs().max()) > LITTLE:
            break
    return Rays(unit=unit, right=right, down=down)


def _interpolated(grid: Tensor, share: Tensor) -> Tensor:
    """Interpolate a grid [Y, X, C] at places [N, 2] from 0 to 1, bilinearly: [C, N]."""
    rows, columns, channels = grid.shape
    at = share.mT * torch.tensor([[columns - 1.0], [rows - 1.0]], dtype=share.dtype)
    left = at[0].long().clamp_max(columns - 2)
    top = at[1].long().clamp_max(rows - 2)
    x, y = at[0] - left, at[1] - top
    flat = grid.reshape(-1, channels).mT.contiguous()
    first = top * columns + left
    upper = torch.lerp(flat[:, first], flat[:, first + 1], x)
    lower = torch.lerp(flat[:, first + columns], flat[:, first + columns + 1], x)
    return torch.lerp(upper, lower, y)
