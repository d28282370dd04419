"""Shots with known truth: many sharp images of a ball, averaged, blurred and made noisy."""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.shapes import check_shape
from toolkit.synthetic.appearance import Appearance
from toolkit.synthetic.exposure import Ball, BallLight, Layer
from toolkit.synthetic.lens import (
    Array,
    blur,
    blur_pixels,
    blur_reach,
    blur_rows,
    mean_over_pixels,
)
from toolkit.synthetic.noise import NoiseLevel, add_noise
from toolkit.synthetic.paths import BallPath
from toolkit.synthetic.sharp import expose_ball
from toolkit.synthetic.shutter import Shutter
from toolkit.synthetic.truth import true_contours
from toolkit.types import LinearImage

SHOT, BACKGROUND, SHARP = 0, 1, 2
"""Noise streams: the pictures never share their noise."""
BISECTIONS = 60


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything a rendered shot depends on, but for the seed of its noise."""

    camera: Camera
    path: BallPath
    ball_radius: float
    """Metre."""
    exposure: float
    """Second."""
    appearance: Appearance
    background: Tensor
    """The sharp scene behind the ball, linear light, [3, H, W]."""
    blur: float = 0.7
    """Standard deviation of the lens's point spread, px."""
    noise: NoiseLevel = field(default_factory=NoiseLevel)
    readout: float = 0.0
    """From the start of the first row's exposure to that of the last row's, s."""

    def __post_init__(self) -> None:
        check_shape("background", self.background, 3, self.camera.height, self.camera.width)
        if not (self.ball_radius > 0 and self.exposure > 0 and self.blur >= 0):
            raise ConfigError(
                f"ball radius {self.ball_radius} m and exposure {self.exposure} s must be positive,"
                f" blur {self.blur} px not negative"
            )
        if not self.readout >= 0:
            raise ConfigError(f"readout is {self.readout} s; zero or a positive number is needed")

    @property
    def shutter(self) -> Shutter:
        """When each row is exposed."""
        rows = self.camera.height
        delay = self.readout / max(1, rows - 1)
        return Shutter(exposure=self.exposure, row_delay=delay, rows=rows)

    def own_time(self, share: float = 0.5) -> float:
        """Give when the row that then shows the ball's centre is exposed for this share, s.

        With a global shutter that is `share` of the exposure.
        """
        shutter = self.shutter
        if not shutter.is_rolling:
            return share * self.exposure
        low, high = 0.0, shutter.end
        for _ in range(BISECTIONS):
            time = (low + high) / 2
            start = self._row(time) * shutter.row_delay
            low, high = (time, high) if time < start + share * self.exposure else (low, time)
        return (low + high) / 2

    def _row(self, time: float) -> float:
        """The row of the picture nearest the ball's centre at a time, s."""
        centre = self.path.position(torch.tensor([time], dtype=torch.float64))
        row = float(self.camera.project(centre)[0, 1])
        return min(max(row, 0.0), self.camera.height - 1.0)


@dataclass(frozen=True, kw_only=True)
class RenderedShot:
    """A shot, its background, and the truth about both."""

    image: LinearImage
    background: LinearImage
    scene: Scene
    alpha: (
        Tensor  # [H, W] share of the exposure during which the ball covers the pixel; no lens blur
    )
    clean_image: Tensor  # [3, H, W] before noise
    clean_background: Tensor  # [3, H, W] before noise

    @property
    def position(self) -> Tensor:
        """The ball's centre at mid-exposure of the first row, [3] m."""
        return self.position_at(self.scene.exposure / 2)

    @property
    def velocity(self) -> Tensor:
        """The ball's velocity at mid-exposure of the first row, [3] m/s."""
        return self.velocity_at(self.scene.exposure / 2)

    def position_at(self, time: float) -> Tensor:
        """Give the ball's centre at a time, s, [3] m; t = 0 is the start of the first row."""
        return self.scene.path.position(torch.tensor([time], dtype=torch.float64))[0]

    def velocity_at(self, time: float) -> Tensor:
        """Give the ball's velocity at a time, s, [3] m/s."""
        return self.scene.path.velocity(torch.tensor([time], dtype=torch.float64))[0]

    def contours(self, count: int = 200) -> Tensor:
        """Give the true left and right contour, [2, count, 2] px; see `true_contours`."""
        scene = self.scene
        return true_contours(
            scene.path,
            scene.camera,
            scene.ball_radius,
            scene.own_time(1.0),
            count,
            start=scene.own_time(0.0),
        )

    def with_noise(self, seed: int, noise: NoiseLevel | None = None) -> "RenderedShot":
        """Give the same shot with other noise, without rendering again."""
        return expose_sensor(
            self.scene, self.alpha, self.clean_image, self.clean_background, seed, noise
        )


def render_shot(
    scene: Scene, *, seed: int = 0, step: float = 0.15, supersampling: int = 3
) -> RenderedShot:
    """Render a shot by brute force, with its background picture and the truth.

    C = blur(alpha F + (1 - alpha) B) where the picture of the background is blur(B), each with its
    own noise. The ball's part is taken on sub-pixels; B is constant within a pixel, which makes the
    blur of both consistent and exact. With a readout, each sharp image adds to the rows that are
    being exposed, as the lens shows it there.
    Source: Caglioti & Giusti 2007, eq. (1). Deviation: the lens's point spread, the readout and
    sensor noise are added.

    Args:
        scene: what to render.
        seed: of the noise.
        step: the ball's outline moves by at most this many px between two sharp images.
        supersampling: rays along one side of a pixel.

    Raises:
        ConfigError: when the ball is out of the picture, or touches the camera's plane.

    Example:
        >>> from toolkit.synthetic import benchmark_scene
        >>> shot = render_shot(benchmark_scene(width_px=12, length_widths=3), seed=1)
        >>> round(float(shot.alpha.max()), 1)
        0.3
    """
    ball = expose_ball(
        scene.camera,
        scene.path,
        Ball(radius=scene.ball_radius, appearance=scene.appearance),
        scene.shutter,
        step=step,
        supersampling=supersampling,
        reach=blur_reach(scene.blur),
    )
    sharp = scene.background.float().numpy()
    background = blur_pixels(sharp, scene.blur, supersampling)
    image = background + _paste(_ball_minus_background(ball, sharp, scene.blur), ball, sharp.shape)
    alpha = mean_over_pixels(ball.layer().alpha[None], supersampling)
    return expose_sensor(
        scene,
        torch.from_numpy(_paste(alpha, ball, (1, *sharp.shape[1:]))[0]),
        torch.from_numpy(image),
        torch.from_numpy(background),
        seed,
        scene.noise,
    )


def _ball_minus_background(ball: BallLight, background: Array, sigma: float) -> Array:
    """What the ball adds to the blurred background within its window, on whole pixels [3, h, w]."""
    window, s = ball.window, ball.supersampling
    rows = np.arange(window.top, window.top + window.height)
    columns = np.arange(window.left, window.left + window.width)
    height, width = background.shape[1:]
    # beyond the picture the scene repeats its border, as in the blur of the background
    behind = background[:, rows.clip(0, height - 1)][:, :, columns.clip(0, width - 1)]
    fine = behind.repeat(s, axis=1).repeat(s, axis=2)

    def difference(layer: Layer) -> Array:
        return layer.colour - layer.alpha * fine

    if ball.reach == 0:
        return mean_over_pixels(blur(difference(ball.layer()), sigma * s), s)
    total = np.zeros((3, window.height, window.width), dtype=np.float32)
    for lag in range(-ball.reach, ball.reach + 1):
        total += blur_rows(difference(ball.layer(lag)), sigma, s, lag)
    return total


def _paste(patch: Array, ball: BallLight, shape: tuple[int, ...]) -> Array:
    """Put the window's pixels into an empty picture, cutting off what lies outside."""
    window = ball.window
    top, left = max(0, window.top), max(0, window.left)
    bottom = min(shape[1], window.top + window.height)
    right = min(shape[2], window.left + window.width)
    picture = np.zeros(shape, dtype=np.float32)
    picture[:, top:bottom, left:right] = patch[
        :, top - window.top : bottom - window.top, left - window.left : right - window.left
    ]
    return picture


def expose_sensor(
    scene: Scene,
    alpha: Tensor,
    clean_image: Tensor,
    clean_background: Tensor,
    seed: int,
    noise: NoiseLevel | None = None,
) -> RenderedShot:
    """Give the shot that a sensor makes of the light of both pictures, rendered before.

    Args:
        scene: that was rendered.
        alpha: share of the exposure during which the ball covers each pixel [H, W].
        clean_image: light of the shot [3, H, W].
        clean_background: the same without the ball.
        seed: of the noise.
        noise: instead of the scene's.
    """
    level = scene.noise if noise is None else noise
    return RenderedShot(
        image=record(add_noise(clean_image, level, seed, SHOT), scene.exposure),
        background=record(add_noise(clean_background, level, seed, BACKGROUND), scene.exposure),
        scene=scene,
        alpha=alpha,
        clean_image=clean_image,
        clean_background=clean_background,
    )


def record(light: Tensor, exposure: float) -> LinearImage:
    """Give the picture that a sensor hands on of its light [3, H, W]."""
    rgb = light[None]
    return LinearImage(
        rgb=rgb,
        clipped=(rgb >= 1).any(dim=1, keepdim=True),
        exposure=torch.tensor([exposure], dtype=torch.float64),
    )
