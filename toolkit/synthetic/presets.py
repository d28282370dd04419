"""Scenes that look like somebody's shot: each kind of motion and of ball, through a real lens."""

import math

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic.appearance import Appearance, LitBall, PlainBall, StripedBall
from toolkit.synthetic.backgrounds import Colour, textured_background
from toolkit.synthetic.noise import NoiseLevel
from toolkit.synthetic.paths import (
    BallPath,
    BouncingPath,
    CircularPath,
    ParabolicPath,
    StraightPath,
    Vector,
)
from toolkit.synthetic.render import Scene
from toolkit.synthetic.scenes import contrasting_colour

BALL_RADIUS = 0.05
"""Metre; at 2.5 m, 50 radii away, the ball is 64 px wide in a picture of 1500 x 1000."""
FOCAL_LENGTH = 1600.0
"""Pixels, for a picture of 1500 x 1000."""
DISTORTION = (-0.12, 0.05, 0.0005, -0.0003, 0.0)
"""A fair photo lens: 3 % of barrel distortion in the picture's corners."""

LEMON: Colour = (0.9, 0.8, 0.03)
RED: Colour = (0.95, 0.04, 0.03)
"""Both far from the grey background, and so is the plane through them and black."""
LAMP: Vector = (-0.5, -0.6, -0.8)

_STRAIGHT = StraightPath(start=(-0.30, -0.10, 2.45), start_velocity=(30.0, 10.0, 5.0)), 0.02

PRESETS: dict[str, tuple[BallPath, float]] = {
    # path, exposure s
    "straight": _STRAIGHT,
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
    "shaded": _STRAIGHT,
    "striped": _STRAIGHT,
}

BALLS: dict[str, Appearance] = {
    # other presets show an orange ball in even light
    "shaded": LitBall(pattern=PlainBall(colour=LEMON), light=LAMP, ambient=0.4, highlight=0.06),
    "striped": LitBall(
        # two and a half turns within the exposure
        pattern=StripedBall(
            colours=(LEMON, RED), pole=(1.0, 0.5, -0.5), spin=(300.0, 600.0, 400.0)
        ),
        light=LAMP,
        ambient=0.5,
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
    """Give a scene by name: a motion of an orange ball, or a shaded or striped one in flight.

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
        appearance=BALLS.get(name) or PlainBall(colour=contrasting_colour(background, 0.4)),
        background=background,
        noise=noise or NoiseLevel(read=0.01),
    )
