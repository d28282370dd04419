"""The light that a sensor's rows collect of a moving ball, one sharp image after the other."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.synthetic.appearance import Appearance, PlainBall
from toolkit.synthetic.lens import Array, Window
from toolkit.synthetic.shutter import Shutter


@dataclass(frozen=True, slots=True, kw_only=True)
class Ball:
    """How large a ball is, and what it looks like."""

    radius: float  # m
    appearance: Appearance


@dataclass(frozen=True, slots=True, kw_only=True)
class Instant:
    """A slice of time, and where the ball is in the middle of it."""

    time: float  # s
    length: float  # s
    centre: NDArray[np.float64]  # [3] m
    box: tuple[int, int, int, int]  # px that hold the ball: left, top, right, bottom (excluded)
    sub_pixel: float  # rad: the side of a sub-pixel at the ball


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """The ball's part of the light on sub-pixels, averaged over an exposure, before any blur."""

    alpha: Array  # [H * s, W * s] share of the exposure during which the ball covers it
    colour: Array  # [3, H * s, W * s]


@dataclass(frozen=True, slots=True, kw_only=True)
class BallLight:
    """What the ball adds to a window of the picture.

    The lens spreads light to rows that a rolling shutter exposes at another time. Therefore the
    layer of a lag holds, in each row y, the light that fell there while row y - lag was exposed.
    With a global shutter all are the same.
    """

    window: Window
    supersampling: int
    sums: Array  # [lags + 1, h, s, w * s, 1 or 4] alpha and RGB; the last is common to all lags
    slices: float  # in an exposure
    plain: tuple[float, ...] | None  # the colour of a plain ball, whose light follows from alpha

    @property
    def reach(self) -> int:
        """The largest lag that has a layer of its own, either way."""
        return max(0, (len(self.sums) - 2) // 2)

    def layer(self, lag: int = 0) -> Layer:
        """Give the layer of one lag."""
        sums = self.sums[-1]
        if len(self.sums) > 1:
            sums = sums + self.sums[self.reach + lag]
        height, s, width, channels = sums.shape
        means = np.moveaxis(sums.reshape(height * s, width, channels), -1, 0)
        means = means / np.float32(self.slices)
        if self.plain is None:
            return Layer(alpha=means[0], colour=means[1:])
        colour = np.array(self.plain, dtype=np.float32)[:, None, None]
        return Layer(alpha=means[0], colour=colour * means)


class Exposure:
    """Running sums over the sharp images, on the sub-pixels of one window."""

    def __init__(
        self, rays: Tensor, window: Window, ball: Ball, shutter: Shutter, reach: int
    ) -> None:
        # relative to one ray the others are small numbers, so that 32 bits lose nothing
        self.origin: NDArray[np.float64] = rays[:, rays.shape[1] // 2, rays.shape[2] // 2].numpy()
        self.rays: Array = (rays.numpy() - self.origin[:, None, None]).astype(np.float32)
        self.window, self.ball, self.shutter, self.reach = window, ball, shutter, reach
        self.supersampling = rays.shape[1] // window.height
        self.slices = math.nan
        look = ball.appearance
        self.plain = look.colour if isinstance(look, PlainBall) else None
        channels = 4 if self.plain is None else 1
        layers = 2 * reach + 2 if shutter.is_rolling else 1
        shape = (layers, window.height, self.supersampling, rays.shape[2], channels)
        self.sums: Array = np.zeros(shape, dtype=np.float32)

    def add(self, instant: Instant) -> None:
        """Add the sharp image of the ball at one instant."""
        self.slices = self.shutter.exposure / instant.length
        rows, columns = self._pixels(instant.box)
        sharp = self._sharp(instant, rows, columns)
        if not self.shutter.is_rolling:
            self.sums[0, rows, :, columns] += sharp
            return
        first = self.window.top + rows.start
        shares = self.shutter.shares(
            range(first - self.reach, self.window.top + rows.stop + self.reach),
            instant.time,
            instant.length,
        )
        # [row, lag]: the share of row - lag, where the lags run from -reach to reach
        by_lag = np.lib.stride_tricks.sliding_window_view(shares, 2 * self.reach + 1)[:, ::-1]
        is_common = by_lag.min(axis=1) == 1
        self._add_rows(self.sums[-1, rows, :, columns], sharp, is_common.astype(np.float32))
        for layer, share in zip(self.sums, by_lag.T.astype(np.float32), strict=False):
            self._add_rows(layer[rows, :, columns], sharp, np.where(is_common, 0, share))

    def light(self) -> BallLight:
        """Give what was collected."""
        return BallLight(
            window=self.window,
            supersampling=self.supersampling,
            sums=self.sums,
            slices=self.slices,
            plain=self.plain,
        )

    def _add_rows(self, sums: Array, sharp: Array, share: NDArray[np.floating]) -> None:
        used = np.flatnonzero(share)
        if len(used):
            sums[used] += share[used, None, None, None] * sharp[used]

    def _pixels(self, box: tuple[int, int, int, int]) -> tuple[slice, slice]:
        """Rows of pixels and columns of sub-pixels of the window that the box covers."""
        left, top, right, bottom = box
        s, window = self.supersampling, self.window
        left, right = (min(max(0, x - window.left), window.width) for x in (left, right))
        top, bottom = (min(max(0, y - window.top), window.height) for y in (top, bottom))
        return slice(top, bottom), slice(left * s, right * s)

    def _sharp(self, instant: Instant, rows: slice, columns: slice) -> Array:
        """How much of each sub-pixel the ball covers, and its light [rows, s, columns, 1 or 4]."""
        s, centre = self.supersampling, instant.centre
        u = self.rays[:, rows.start * s : rows.stop * s, columns]
        x, y, z = centre.astype(np.float32)
        tangent = math.sqrt(float(centre @ centre) - self.ball.radius**2)
        # u.C - tangent, from small numbers only
        depth = u[0] * x
        depth += u[1] * y
        depth += u[2] * z
        depth += np.float32(float(self.origin @ centre) - tangent)
        # it rises by R for each radian from the rim inwards, and is linear in the area there
        cover = depth * np.float32(1 / (self.ball.radius * instant.sub_pixel))
        cover += np.float32(0.5)
        np.clip(cover, 0, 1, out=cover)
        shape = (rows.stop - rows.start, s, cover.shape[1], self.sums.shape[-1])
        light: Array
        if self.plain is not None:
            light = cover.reshape(shape)
            return light
        inside = np.flatnonzero(cover)
        normal = self._normals(
            u.reshape(3, -1).take(inside, axis=1), depth.take(inside), tangent, centre
        )
        # flat indices and whole rows of memory: twice as fast as picking pixels by row, column
        light = np.zeros((cover.size, 4), dtype=np.float32)
        colour = self.ball.appearance(torch.from_numpy(normal.T), instant.time).numpy()
        light[:, 0] = cover.ravel()
        light[inside, 1:] = light[inside, :1] * colour
        return light.reshape(shape)

    def _normals(
        self, rays: Array, depth: Array, tangent: float, centre: NDArray[np.float64]
    ) -> Array:
        """Outward normals [3, N] where rays enter the ball; `depth` is u.C - tangent there.

        A ray that just misses the ball, but whose sub-pixel does not, has the normal of the rim.
        """
        missed = depth < 0
        depth = np.maximum(depth, 0)
        u: Array = rays + self.origin.astype(np.float32)[:, None]
        # (u.C)^2 - tangent^2, in the form that keeps its digits near the rim
        half_chord = np.sqrt(depth * (depth + np.float32(2 * tangent)))
        u *= depth - half_chord + np.float32(tangent)
        u -= centre.astype(np.float32)[:, None]
        u /= np.float32(self.ball.radius)
        u[:, missed] /= np.linalg.norm(u[:, missed], axis=0)
        return u
