"""Shots with known truth: many sharp images of a ball, averaged, blurred and made noisy."""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.shapes import check_shape
from toolkit.synthetic.appearance import Appearance
from toolkit.synthetic.lens import Array, blur, blur_pixels, blur_reach, mean_over_pixels
from toolkit.synthetic.noise import NoiseLevel, add_noise
from toolkit.synthetic.paths import BallPath
from toolkit.synthetic.sharp import BallLight, expose_ball
from toolkit.synthetic.truth import true_contours
from toolkit.types import LinearImage

SHOT, BACKGROUND, SHARP = 0, 1, 2
"""Noise streams: the pictures never share their noise."""


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

    def __post_init__(self) -> None:
        check_shape("background", self.background, 3, self.camera.height, self.camera.width)
        if not (self.ball_radius > 0 and self.exposure > 0 and self.blur >= 0):
            raise ConfigError(
                f"ball radius {self.ball_radius} m and exposure {self.exposure} s must be positive,"
                f" blur {self.blur} px not negative"
            )


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
        """The ball's centre at mid-exposure, [3] m."""
        return self.scene.path.position(self._mid_exposure)[0]

    @property
    def velocity(self) -> Tensor:
        """The ball's velocity at mid-exposure, [3] m/s."""
        return self.scene.path.velocity(self._mid_exposure)[0]

    def contours(self, count: int = 200) -> Tensor:
        """Give the true left and right contour, [2, count, 2] px; see `true_contours`."""
        scene = self.scene
        return true_contours(scene.path, scene.camera, scene.ball_radius, scene.exposure, count)

    def with_noise(self, seed: int, noise: NoiseLevel | None = None) -> "RenderedShot":
        """Give the same shot with other noise, without rendering again."""
        return _finish(self.scene, self.alpha, self.clean_image, self.clean_background, seed, noise)

    @property
    def _mid_exposure(self) -> Tensor:
        return torch.tensor([self.scene.exposure / 2], dtype=torch.float64)


def render_shot(
    scene: Scene, *, seed: int = 0, step: float = 0.15, supersampling: int = 3
) -> RenderedShot:
    """Render a shot by brute force, with its background picture and the truth.

    C = blur(alpha F + (1 - alpha) B) where the picture of the background is blur(B), each with its
    own noise. The ball's part is taken on sub-pixels; B is constant within a pixel, which makes the
    blur of both consistent and exact.
    Source: Caglioti & Giusti 2007, eq. (1). Deviation: the lens's point spread and sensor noise are
    added.

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
        scene.ball_radius,
        scene.exposure,
        scene.appearance,
        step=step,
        supersampling=supersampling,
        margin=blur_reach(scene.blur),
    )
    sharp = scene.background.float().numpy()
    background = blur_pixels(sharp, scene.blur, supersampling)
    image = background + _paste(_ball_minus_background(ball, sharp, scene.blur), ball, sharp.shape)
    alpha = _paste(mean_over_pixels(ball.alpha[None], supersampling), ball, (1, *sharp.shape[1:]))
    return _finish(
        scene,
        torch.from_numpy(alpha[0]),
        torch.from_numpy(image),
        torch.from_numpy(background),
        seed,
        scene.noise,
    )


def _ball_minus_background(ball: BallLight, background: Array, sigma: float) -> Array:
    """What the ball adds to the blurred background within its window, on whole pixels [3, h, w]."""
    window = ball.window
    rows = np.arange(window.top, window.top + window.height)
    columns = np.arange(window.left, window.left + window.width)
    height, width = background.shape[1:]
    # beyond the picture the scene repeats its border, as in the blur of the background
    behind = background[:, rows.clip(0, height - 1)][:, :, columns.clip(0, width - 1)]
    s = ball.alpha.shape[0] // window.height
    fine = behind.repeat(s, axis=1).repeat(s, axis=2)
    difference = blur(ball.colour - ball.alpha * fine, sigma * s)
    return mean_over_pixels(difference, s)


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


def _finish(
    scene: Scene,
    alpha: Tensor,
    clean_image: Tensor,
    clean_background: Tensor,
    seed: int,
    noise: NoiseLevel | None,
) -> RenderedShot:
    """Expose both clean pictures on the sensor."""
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
