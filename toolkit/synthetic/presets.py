"""Scenes that look like somebody's shot: one of each kind of motion, through a real lens."""

import math

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic.appearance import PlainBall
from toolkit.synthetic.backgrounds import textured_background
from toolkit.synthetic.noise import NoiseLevel
from toolkit.synthetic.paths import (
    BallPath,
    BouncingPath,
    CircularPath,
    ParabolicPath,
    StraightPath,
)
from toolkit.synthetic.render import Scene
from toolkit.synthetic.scenes import contrasting_colour

BALL_RADIUS = 0.05
"""Metre; at 2.5 m, 50 radii away, the ball is 64 px wide in a picture of 1500 x 1000."""
FOCAL_LENGTH = 1600.0
"""Pixels, for a picture of 1500 x 1000."""
DISTORTION = (-0.12, 0.05, 0.0005, -0.0003, 0.0)
"""A fair photo lens: 3 % of barrel distortion in the picture's corners."""

PRESETS: dict[str, tuple[BallPath, float]] = {
    # path, exposure s
    "straight": (
        StraightPath(start=(-0.30, -0.10, 2.45), start_velocity=(30.0, 10.0, 5.0)),
        0.02,
    ),
    "parabola": (
        ParabolicPath(start=(-0.35, 0.05, 2.45), start_velocity=(2.8, -1.3, 0.3)),
        0.25,
    ),
    "bounce": (
        BouncingPath(
            start=(-0.30, -0.25, 2.5),
            start_velocity=(2.4, 1.6, 0.2),
            contact_height=0.2,
            tangential_loss=0.1,
        ),
        0.25,
    ),
    "circle": (
        CircularPath(
            centre=(0.0, -0.45, 2.5),
            arm=(-0.5 * math.sin(0.6), 0.5 * math.cos(0.6), 0.05),
            axis=(0.1, 0.2, -1.0),
            rate=12.0,
        ),
        0.1,
    ),
}


def preset_camera(width: int, height: int) -> Camera:
    """Give the camera of the presets, its focal length fitted to the picture's size in pixels."""
    scale = min(width / 1500, height / 1000)
    return Camera(
        width=width,
        height=height,
        fx=FOCAL_LENGTH * scale,
        fy=FOCAL_LENGTH * scale,
        # the optical axis of a real lens misses the picture's middle
        cx=(width - 1) / 2 + 5.3 * scale,
        cy=(height - 1) / 2 - 7.9 * scale,
        distortion=DISTORTION,
    )


def preset_scene(
    name: str,
    *,
    size: tuple[int, int] = (1500, 1000),
    noise: NoiseLevel | None = None,
    seed: int = 0,
) -> Scene:
    """Give a scene by name: straight, parabola, bounce or circle.

    Args:
        name: one of `PRESETS`.
        size: width and height of the picture.
        noise: of the sensor; 1 % of white when None.
        seed: draws the background.

    Raises:
        ConfigError: when there is no such preset.
    """
    if name not in PRESETS:
        raise ConfigError(f"no preset '{name}'; there are {', '.join(PRESETS)}")
    path, exposure = PRESETS[name]
    background = textured_background(*size, seed=seed)
    return Scene(
        camera=preset_camera(*size),
        path=path,
        ball_radius=BALL_RADIUS,
        exposure=exposure,
        appearance=PlainBall(colour=contrasting_colour(background, 0.4)),
        background=background,
        noise=noise or NoiseLevel(read=0.01),
    )
