"""The benchmark scene, against which every accuracy is quoted."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic.appearance import PlainBall
from toolkit.synthetic.backgrounds import Colour, textured_background
from toolkit.synthetic.noise import NoiseLevel
from toolkit.synthetic.paths import ParabolicPath, StraightPath, Vector
from toolkit.synthetic.render import Scene

BENCHMARK_NOISE = NoiseLevel(read=0.01)
WARM: Vector = (0.8, 0.45, -0.4)
"""Direction in colour space from the grey background to the ball's orange."""


def benchmark_scene(
    *,
    width_px: float = 60.0,
    length_widths: float = 5.0,
    distance_R: float = 50.0,
    tilt: float = 0.0,
    heading: float | None = None,
    sagitta_widths: float = 0.0,
    contrast: float = 0.4,
    noise: NoiseLevel = BENCHMARK_NOISE,
    blur: float = 0.7,
    distortion: tuple[float, ...] = (),
    size: tuple[int, int] | None = None,
    ball_radius: float = 0.05,
    exposure: float = 0.02,
    seed: int = 0,
) -> Scene:
    """Give the scene against which every accuracy is quoted: an orange ball before a grey texture.

    Args:
        width_px: diameter of the ball's image at mid-exposure.
        length_widths: travel of the ball's centre in the image, in widths.
        distance_R: distance at mid-exposure, in ball radii.
        tilt: angle of the motion out of the image plane, rad; positive moves away.
        heading: direction of the motion in the image, rad; None draws it from the seed.
        sagitta_widths: height of the path's arc over its chord, in widths; 0 is straight.
        contrast: least |ball colour - background| over the picture, norm over the three channels.
        noise: 1 % of sensor white at every level unless told.
        blur: lens point spread, px.
        distortion: of the lens, OpenCV order.
        size: width and height of the picture; None makes it just large enough.
        ball_radius: metre.
        exposure: second.
        seed: draws the texture, the heading and the ball's place within a few pixels of the centre.

    Raises:
        ConfigError: when the ball would not fit the picture or the colour would leave 0..1.
    """
    generator = np.random.default_rng([seed, 201])
    drawn_heading, shift_x, shift_y = generator.uniform(size=3) * [2 * math.pi, 8.0, 8.0]
    angle = drawn_heading if heading is None else heading
    camera = _camera_for(width_px, length_widths, distance_R, sagitta_widths, distortion, size)
    offset = ((shift_x - 4) / camera.fx, (shift_y - 4) / camera.fy)
    path = _path_through(
        middle=_on_ray(offset, distance_R * ball_radius),
        travel=_travel(width_px * length_widths / camera.fx, distance_R * ball_radius, tilt),
        direction=_direction(angle, tilt),
        bend=(-math.sin(angle), math.cos(angle), 0.0),
        sagitta=2 * ball_radius * sagitta_widths,
        exposure=exposure,
    )
    background = textured_background(camera.width, camera.height, contrast=0.1, seed=seed)
    return Scene(
        camera=camera,
        path=path,
        ball_radius=ball_radius,
        exposure=exposure,
        appearance=PlainBall(colour=contrasting_colour(background, contrast)),
        background=background,
        blur=blur,
        noise=noise,
    )


def contrasting_colour(background: Tensor, contrast: float) -> Colour:
    """Give an orange at least `contrast` (Euclidean norm) from each pixel of background [3, H, W].

    Raises:
        ConfigError: when that colour leaves 0..1.
    """
    direction = torch.nn.functional.normalize(torch.tensor(WARM), dim=0)
    mean = background.mean(dim=(1, 2))
    spread = torch.einsum("c,chw->hw", direction, background - mean[:, None, None]).max()
    red, green, blue = (mean + (contrast + spread) * direction).tolist()
    if not (0 <= min(red, green, blue) and max(red, green, blue) <= 1):
        raise ConfigError(
            f"a ball colour at contrast {contrast} from this background leaves 0..1;"
            " ask for less contrast"
        )
    return (red, green, blue)


def _camera_for(
    width_px: float,
    length_widths: float,
    distance_R: float,
    sagitta_widths: float,
    distortion: tuple[float, ...],
    size: tuple[int, int] | None,
) -> Camera:
    """A camera with the ball `width_px` wide at the distance asked for."""
    if distance_R <= 1:
        raise ConfigError(f"a ball {distance_R} radii away holds the camera; put it farther away")
    # the cone that touches the ball has the half angle asin(R / distance)
    focal = width_px / 2 * math.sqrt(distance_R**2 - 1)
    side = math.ceil(1.05 * width_px * (length_widths + 1 + sagitta_widths)) + 60
    width, height = size or (side, side)
    return Camera.centred(width, height, focal, distortion)


def _on_ray(normalised: tuple[float, float], distance: float) -> Vector:
    x, y = normalised
    scale = distance / math.sqrt(x * x + y * y + 1)
    return (x * scale, y * scale, scale)


def _direction(heading: float, tilt: float) -> Vector:
    flat = math.cos(tilt)
    return (flat * math.cos(heading), flat * math.sin(heading), math.sin(tilt))


def _travel(image_travel: float, distance: float, tilt: float) -> float:
    """Length of the path in metres whose centre moves by `image_travel` in normalised coordinates.

    With s half the travel: image_travel = 2 s cos(tilt) distance / (distance^2 - s^2 sin(tilt)^2),
    solved for s.
    """
    flat, deep = math.cos(tilt) * distance, image_travel * math.sin(tilt)
    return 2 * image_travel * distance**2 / (flat + math.hypot(flat, deep * distance))


def _path_through(
    *,
    middle: Vector,
    travel: float,
    direction: Vector,
    bend: Vector,
    sagitta: float,
    exposure: float,
) -> StraightPath | ParabolicPath:
    """The path through `middle` at mid-exposure, moving along `direction`, bent towards `bend`."""
    m, d, b = (np.array(vector) for vector in (middle, direction, bend))
    speed = travel / exposure
    if sagitta == 0:
        return StraightPath(start=_vector(m - d * travel / 2), start_velocity=_vector(d * speed))
    acceleration = b * (8 * sagitta / exposure**2)
    return ParabolicPath(
        start=_vector(m - d * travel / 2 + acceleration * (exposure**2 / 8)),
        start_velocity=_vector(d * speed - acceleration * (exposure / 2)),
        acceleration=_vector(acceleration),
    )


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)
