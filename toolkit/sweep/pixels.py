"""The pixels about a streak: what was observed there, with its noise, and where each one looks."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.errors import StreakError
from toolkit.sweep.rays import RayGrid, Rays
from toolkit.sweep.squares import Squares
from toolkit.view import StreakView

Array = NDArray[np.float64]

ROOM = 3.0
"""px beyond the ball's image within which pixels may see it, and what the path is uncertain by."""
BESIDE = 1.3
"""Half widths beyond these within which pixels tell of the background's light, and 8 px more."""
OUTLIER = 3.5
"""Standard deviations beyond which such a pixel's difference counts linearly."""
BESIDE_SIDE = 2
"""px along the side of the squares in which these are summed up, at least."""
LARGEST = 1e30
"""Finite variance in place of an infinite one."""
EVEN = 0.05
"""Variance of the ground within such a square over the squared contrast of ball and ground."""
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

    squares: tuple[Squares, ...]  # of several sizes, N in all, in the window
    place: Tensor  # [N, 2] px in the picture
    rays: Rays
    signal: Tensor  # [Q, N]
    ground: Tensor  # [Q, N]
    shot_variance: Tensor  # [Q, N], infinite where nothing was measured
    ground_variance: Tensor  # [Q, N]
    ground_slope: Tensor  # [2, Q, N] change of the ground to the right and downwards, per px
    beside: Beside
    mixed: Tensor  # [Q, N] what the lens adds where the ball's rim lies before a varying ground
    excess: float = 1.0  # by which the variances exceed the camera's noise

    def __len__(self) -> int:
        """Number of pixels."""
        return len(self.place)

    def mean_of(self, image: Tensor) -> Tensor:
        """Give what each shows in another image of the window [Q, H, W]: [Q, N]."""
        picked = (squares.pick(image)[0] for squares in self.squares)
        return torch.cat([values.mean(1) for values in picked], dim=-1).double()

    def behind_lens(self, opacity_slope: Tensor, spread: float) -> "StreakPixels":
        """Give the same where the lens mixes the ball's rim with the ground beside it.

        Over a pixel's spread both opacity and ground change; what is left of the ground's light is
        the mean of a product, other than the product of the means by their joint change. [derived]

        Args:
            opacity_slope: change of the opacity to the right and downwards [2, N], per px.
            spread: variance of lens and single pixel, px^2.
        """
        joint = (opacity_slope[:, None] * self.ground_slope).sum(0)
        return replace(self, mixed=-(spread + self.rays.blur) * joint)


@dataclass(frozen=True, kw_only=True)
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
        # what is infinite in both leaves no number
        ground_variance = (both - own).nan_to_num(0.0).clamp_min(0)
        return cls(
            corner=view.corner,
            usable=~view.clipped[0, 0] & (both.amin(0) < torch.inf),
            signal=seen.signal[0].contiguous(),
            ground=seen.ground[0].contiguous(),
            shot_variance=own.contiguous(),
            ground_variance=ground_variance,
            camera=camera,
        )

    @cached_property
    def measured(self) -> Tensor:
        """1 where a channel of a pixel can be used, else 0 [Q, H, W]."""
        return (self.usable & (self.shot_variance < torch.inf)).to(self.signal)

    @cached_property
    def _is_whole(self) -> bool:
        return bool(self.measured.min() > 0)

    def noisier(self, factor: float) -> "Frame":
        """Give the same with all variances multiplied."""
        return replace(
            self,
            shot_variance=self.shot_variance * factor,
            ground_variance=self.ground_variance * factor,
            excess=self.excess * factor,
        )

    def about(
        self,
        path_px: Tensor,
        half_width: Tensor | float,
        *,
        side: int = 1,
        doubt: float = 0.0,
        wide: Squares | None = None,
    ) -> StreakPixels:
        """Take the pixels about a path in the picture.

        Args:
            path_px: points of the path [T, 2] px.
            half_width: of the ball's image at each of them [T], or at all, px.
            side: of the squares whose pixels are averaged.
            doubt: px by which the path and the half width may be off.
            wide: larger squares that stand for their pixels, where single pixels are taken.

        Raises:
            StreakError: when nothing was measured there.
        """
        reach = np.asarray(half_width, dtype=np.float64) + ROOM + doubt
        near = self._band(path_px, reach, side)
        groups = []
        if wide is not None:
            near.reshape(-1)[wide.index().numpy()] = 0
            groups.append(self._read(wide))
        groups.insert(0, self._read(self._squares(near, side)))
        if not any(len(g.squares) for g in groups):
            raise StreakError(
                "the exact streak leads to where nothing was measured: out of the picture, or "
                "to clipped pixels alone; name a region that holds the whole streak"
            )
        signal, ground, shot, empty = (
            torch.cat(maps, dim=-1) for maps in zip(*(g.maps for g in groups), strict=True)
        )
        squares = tuple(g.squares for g in groups)
        slopes = [each.slope(self.ground) for each in squares]
        return StreakPixels(
            squares=squares,
            place=torch.cat([self._place(each) for each in squares]),
            rays=self.rays(*squares),
            signal=signal,
            ground=ground,
            shot_variance=shot,
            ground_variance=empty,
            ground_slope=torch.cat(slopes, dim=-1).double(),
            mixed=torch.zeros_like(signal),
            beside=Beside.of(
                *self.read_beside(path_px, half_width, side=max(side, BESIDE_SIDE), doubt=doubt)
            ),
            excess=self.excess,
        )

    def read_beside(
        self, path_px: Tensor, half_width: Tensor | float, *, side: int, doubt: float = 0.0
    ) -> tuple[Tensor, ...]:
        """Average the squares beside a streak, where nothing but the background is seen.

        Args:
            path_px: points of the path [T, 2] px.
            half_width: of the ball's image at each of them [T], or at all, px.
            side: of the squares, px.
            doubt: px by which the path and the half width may be off.

        Returns:
            Signal, ground and the variances of both [Q, M].
        """
        size = np.asarray(half_width, dtype=np.float64)
        reach = size + ROOM + doubt
        ring = self._band(path_px, reach + BESIDE * size + 8, side)
        ring[self._band(path_px, reach, side) > 0] = 0
        return self._read(self._squares(ring, side)).maps

    def even_squares(
        self, path_px: Tensor, half_width: Tensor, side: int, contrast: float
    ) -> Squares:
        """Find the squares about a path that are all measured, before an even ground.

        Args:
            path_px: points of the path [T, 2] px.
            half_width: of the ball's image at each of them [T], px.
            side: of the squares, px.
            contrast: of ball and ground, light, against which the ground must not vary.
        """
        squares = self._squares(self._band(path_px, half_width.numpy() - side, side), side)
        used, ground = squares.pick(self.measured, self.ground)
        varies = ((ground * ground).mean(1) - ground.mean(1) ** 2).sum(0)
        return squares[(used.amin(1).amin(0) > 0) & (varies < EVEN * contrast**2)]

    def rays(self, *squares: Squares) -> Rays:
        """Give the rays of squares of several sizes, one after another."""
        place = torch.cat([self._place(each) for each in squares])
        return self._ray_grid.rays(place, torch.cat([each.blur for each in squares]))

    @cached_property
    def _ray_grid(self) -> RayGrid:
        height, width = self.usable.shape
        corner = torch.tensor(self.corner, dtype=torch.float64)
        size = torch.tensor([width, height], dtype=torch.float64)
        return RayGrid.over(self.camera, corner, corner + size - 1)

    def _place(self, squares: Squares) -> Tensor:
        """Give the middles of squares in the picture [M, 2] px."""
        return squares.place + torch.tensor(self.corner)

    def _band(self, path_px: Tensor, reach: Array, side: int) -> NDArray[np.uint8]:
        """Mark all squares of the window within reach [T] of a path [T, 2], px."""
        height, width = self.usable.shape
        middle = (path_px.numpy() - np.array(self.corner) + 0.5) / side - 0.5
        reach = np.broadcast_to(reach / side + 1, len(middle))
        return _band(middle, reach, height // side, width // side)

    def _squares(self, mask: NDArray[np.uint8], side: int) -> Squares:
        height, width = self.usable.shape
        return Squares.of(mask, side, (height, width))

    def _read(self, squares: Squares) -> "_Reading":
        """Average what squares show, over the pixels where something was measured."""
        maps = (self.signal, self.ground, self.shot_variance, self.ground_variance)
        if self._is_whole:
            size = squares.side**2
            signal, ground, shot, empty = (
                values.mean(1).double() for values in squares.pick(*maps)
            )
            return _Reading(squares, (signal, ground, shot / size, empty / size))
        used, signal, ground, shot, empty = squares.pick(self.measured, *maps)
        count = used.sum(1)
        is_seen = count.amax(0) > 0
        share = used / count.clamp_min(1)[:, None]
        # an infinite variance is left out as well
        shot = (shot.clamp_max(LARGEST) * share * share).sum(1)
        means = (
            (signal * share).sum(1),
            (ground * share).sum(1),
            torch.where(count > 0, shot, torch.inf),
            (empty * share * share).sum(1),
        )
        return _Reading(squares[is_seen], tuple(each[:, is_seen].double() for each in means))


@dataclass(frozen=True, slots=True)
class _Reading:
    """What was measured in M squares: signal, ground, and the variances of both [Q, M]."""

    squares: Squares
    maps: tuple[Tensor, ...]


def _band(middle: Array, reach: Array, rows: int, columns: int) -> NDArray[np.uint8]:
    """Mark all within reach [T] of a line [T, 2], its places in squares."""
    mask = np.zeros((rows, columns), np.uint8)
    points = np.round(middle * 8).astype(np.int32)
    widths = np.ceil(2 * np.maximum(reach[:-1], reach[1:])).astype(np.int32)
    for first, last, width in zip(points[:-1], points[1:], widths, strict=True):
        if width > 0:
            cv2.line(mask, first.tolist(), last.tolist(), 1, thickness=int(width), shift=3)
    return mask
