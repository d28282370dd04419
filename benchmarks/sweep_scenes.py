"""The shots on which the exact stage is judged: drawn from a seed, rendered by brute force.

A ball of one colour flies straight. Drawn evenly within their ranges are

- its width, 30 to 150 px, and the travel of its centre, 0.5 to 8 widths, both as seen straight on,
- its distance at mid-exposure, 15 to 100 radii (evenly in the logarithm),
- the heading in the picture, and the tilt out of it, up to 60 degrees to or from the viewer,
- its place on the sensor, up to 25 degrees off the optical axis; the picture is cut out of it,
- the lens, known exactly: k1 -0.15 to 0.08, k2 -0.03 to 0.05, a little tangential distortion; its
  point spread, 0 to 1.2 px, is not known,
- the noise, 0.5 to 3 % of white in each channel at half of white, part of it that of light itself,
- the background, a texture of at most 0.1 about a colour of 0.2 to 0.4 in each channel, and the
  ball's colour, 0.05 to 0.85 in each and at least 0.4 (norm of three) from every pixel of it.

One background picture is given, and not the ball's colour.
"""

import hashlib
import math
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit import Camera
from toolkit.files import write_whole
from toolkit.synthetic import (
    NoiseLevel,
    PlainBall,
    RenderedShot,
    Scene,
    StraightPath,
    render_shot,
    textured_background,
)
from toolkit.synthetic.lens import blur_pixels
from toolkit.synthetic.render import expose_sensor
from toolkit.synthetic.sharp import project_limb

Array = NDArray[np.float64]
Generator = np.random.Generator
Colour = tuple[float, float, float]

WIDTH_PX, LENGTH_WIDTHS, DISTANCE_R = (30.0, 150.0), (0.5, 8.0), (15.0, 100.0)
TILT, OFF_AXIS = math.radians(60), math.radians(25)
OFF_AXIS_PX = 1500.0
"""Half the sensor's width at most."""
K1, K2, TANGENTIAL = (-0.15, 0.08), (-0.03, 0.05), 5e-4
BORDER = 24
"""px around the picture that the lens shows too."""
BLUR_PX, NOISE = (0.0, 1.2), (0.005, 0.03)
GREY, TEXTURE, BALL_COLOUR, CONTRAST = (0.2, 0.4), 0.1, (0.05, 0.85), 0.4
BALL_RADIUS, EXPOSURE = 0.05, 0.02
GROWTH = 0.6
"""Widths by which a streak may grow where rows are read one after the other."""
FINE, COARSE, LARGE_PX = (0.5, 3), (1.0, 2), 60.0
"""px between sharp images, and rays along a pixel's side, for balls narrower than this and wider.

Pictures err by some 1e-5 of white, which moves nothing by 0.01 of its bound (`sweep_rendering`).
"""
FINE_LOOK, COARSE_LOOK = (1.0, 3), (2.0, 2)
"""The same for balls that are not plain, whose looks take most of the time."""


def draw_scene(seed: int, row_delay: float = 0.0) -> Scene:
    """Give the seed's scene, its rows read one after the other if told by how much, s.

    They are read faster where the streak would grow out of its picture otherwise.
    """
    scene = _draw(seed)
    if row_delay == 0:
        return scene
    time = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64) * scene.exposure
    first, middle, last = scene.camera.project(scene.path.position(time))[:, 1].tolist()
    room = GROWTH * _width(scene) * scene.exposure / (last - first) ** 2
    delay = min(row_delay, room)
    start = np.array(scene.path.start) - delay * middle * np.array(scene.path.start_velocity)
    x, y, z = start.tolist()
    path = replace(scene.path, start=(x, y, z))
    return replace(scene, path=path, readout=delay * (scene.camera.height - 1))


def _draw(seed: int) -> Scene:
    generator = np.random.default_rng([seed, 31])
    width = generator.uniform(*WIDTH_PX)
    distance = math.exp(generator.uniform(*np.log(DISTANCE_R)))
    focal = width / 2 * math.sqrt(distance**2 - 1)
    ray = _ray(generator, min(OFF_AXIS, math.atan(OFF_AXIS_PX / focal)))
    path = _path(generator, ray, distance, generator.uniform(*LENGTH_WIDTHS))
    camera = _camera_about(generator, path, focal, 0.75 * width + 12)
    grey = _colour(generator, GREY)
    background = textured_background(
        camera.width, camera.height, colour=grey, contrast=TEXTURE, seed=seed
    )
    return Scene(
        camera=camera,
        path=path,
        ball_radius=BALL_RADIUS,
        exposure=EXPOSURE,
        appearance=PlainBall(colour=_contrasting_colour(generator, background)),
        background=background,
        blur=generator.uniform(*BLUR_PX),
        noise=_noise(generator),
    )


def sweep_shot(seed: int, cache: Path | None = None, row_delay: float = 0.0) -> RenderedShot:
    """Give the seed's shot."""
    return render(draw_scene(seed, row_delay), seed, cache)


def render(scene: Scene, seed: int, cache: Path | None = None) -> RenderedShot:
    """Render a scene, or take what the cache holds of it, and add the seed's noise."""
    step, rays = fineness(scene)
    if cache is None:
        return render_shot(scene, seed=seed, step=step, supersampling=rays)
    sharp = scene.background.float().numpy()
    background = torch.from_numpy(blur_pixels(sharp, scene.blur, rays))
    file = cache / f"{_key(scene)}.zlib"
    if not file.exists():
        shot = render_shot(scene, step=step, supersampling=rays)
        _store(file, torch.cat([shot.clean_image - background, shot.alpha[None]]))
    kept = _stored(file, (4, *background.shape[1:]))
    return expose_sensor(scene, kept[3], background + kept[:3], background, seed)


def _store(file: Path, picture: Tensor) -> None:
    """Keep a picture that is 0 nearly everywhere."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with write_whole(file) as temporary:
        temporary.write_bytes(zlib.compress(picture.numpy().tobytes(), 1))


def _stored(file: Path, shape: tuple[int, ...]) -> Tensor:
    values = np.frombuffer(zlib.decompress(file.read_bytes()), dtype=np.float32)
    return torch.from_numpy(values.reshape(shape).copy())


def fineness(scene: Scene) -> tuple[float, int]:
    """Give the step, px, and the rays along a pixel's side with which to render a scene."""
    is_small = _width(scene) < LARGE_PX
    if isinstance(scene.appearance, PlainBall):
        return FINE if is_small else COARSE
    return FINE_LOOK if is_small else COARSE_LOOK


def _width(scene: Scene) -> float:
    """Width or height of the ball's image at mid-exposure, px, whichever is less."""
    middle = scene.path.position(torch.tensor([scene.own_time()], dtype=torch.float64))
    limb = project_limb(scene.camera, middle, scene.ball_radius)[0]
    return float((limb.amax(0) - limb.amin(0)).min())


def facts(shot: RenderedShot) -> dict[str, float]:
    """Say under which conditions a shot was made."""
    scene = shot.scene
    middle = scene.own_time()
    centre, velocity = shot.position_at(middle).numpy(), shot.velocity_at(middle).numpy()
    distance = float(np.linalg.norm(centre))
    ray, speed = centre / distance, float(np.linalg.norm(velocity))
    focal, sine = scene.camera.fx, scene.ball_radius / distance
    tilt = math.asin(float(velocity @ ray) / speed)
    half = velocity * scene.exposure / 2
    ends = np.array([centre - half, centre + half])
    cosine = float(ends[0] @ ends[1]) / float(np.prod(np.linalg.norm(ends, axis=-1)))
    return {
        "width_px": 2 * focal * math.tan(math.asin(sine)),
        "length_widths": math.acos(min(1.0, cosine)) / (2 * math.asin(sine)),
        "distance_R": distance / scene.ball_radius,
        "tilt_deg": math.degrees(tilt),
        "off_axis_deg": math.degrees(math.acos(float(ray[2]))),
        "blur_px": scene.blur,
        "noise": math.sqrt(scene.noise.read**2 + 0.5 * scene.noise.gain),
        "speed_m_s": speed,
    }


def _ray(generator: Generator, widest: float) -> Array:
    """A direction evenly drawn from the cone about the optical axis."""
    cosine = generator.uniform(math.cos(widest), 1)
    turn, sine = generator.uniform(0, math.tau), math.sqrt(1 - cosine**2)
    return np.array([sine * math.cos(turn), sine * math.sin(turn), cosine])


def _path(generator: Generator, ray: Array, distance: float, length: float) -> StraightPath:
    """Straight flight through `ray` at mid-exposure; its travel is `length` widths as seen there.

    With s half the travel, in radii, and the tilt's sine and cosine S and C, the centre moves in a
    picture taken along the ray by 2 s C distance / (distance^2 - s^2 S^2), solved for s.
    """
    heading, tilt = generator.uniform(0, math.tau), generator.uniform(-TILT, TILT)
    right = np.cross([0.0, 1.0, 0.0], ray)
    right /= np.linalg.norm(right)
    across = math.cos(heading) * right + math.sin(heading) * np.cross(ray, right)
    direction = math.cos(tilt) * across + math.sin(tilt) * ray
    seen = 2 * length / math.sqrt(distance**2 - 1)
    flat, deep = math.cos(tilt) * distance, seen * math.sin(tilt)
    travel = 2 * seen * distance**2 / (flat + math.hypot(flat, deep * distance)) * BALL_RADIUS
    start = ray * distance * BALL_RADIUS - direction * travel / 2
    x, y, z = start.tolist()
    vx, vy, vz = (direction * travel / EXPOSURE).tolist()
    return StraightPath(start=(x, y, z), start_velocity=(vx, vy, vz))


def _camera_about(generator: Generator, path: StraightPath, focal: float, margin: float) -> Camera:
    """The camera of the part of the sensor that holds the streak and `margin` px around.

    Its lens is drawn again where it would not show all of that part.
    """
    while True:
        lens = _lens(generator)
        sensor = Camera(width=1, height=1, fx=focal, fy=focal, cx=0.0, cy=0.0, distortion=lens)
        time = torch.linspace(0, EXPOSURE, 65, dtype=torch.float64)
        limb = project_limb(sensor, path.position(time), BALL_RADIUS).reshape(-1, 2)
        left, top = (limb.amin(0) - margin).floor().int().tolist()
        right, bottom = (limb.amax(0) + margin).ceil().int().tolist()
        corners = torch.cartesian_prod(
            torch.tensor([left - BORDER, right + BORDER]),
            torch.tensor([top - BORDER, bottom + BORDER]),
        )
        if bool(torch.isfinite(sensor.undistort(corners.double())).all()):
            size = len(sensor.parameters)
            known = replace(sensor, covariance=torch.zeros(size, size, dtype=torch.float64))
            return known.cropped(left, top, right - left, bottom - top)


def _lens(generator: Generator) -> tuple[float, ...]:
    p1, p2 = generator.uniform(-TANGENTIAL, TANGENTIAL, size=2).tolist()
    return (generator.uniform(*K1), generator.uniform(*K2), p1, p2)


def _colour(generator: Generator, limits: tuple[float, float]) -> Colour:
    red, green, blue = generator.uniform(*limits, size=3).tolist()
    return (red, green, blue)


def _contrasting_colour(generator: Generator, background: Tensor) -> Colour:
    while True:
        colour = _colour(generator, BALL_COLOUR)
        away = background - torch.tensor(colour)[:, None, None]
        if float(away.norm(dim=0).min()) >= CONTRAST:
            return colour


def _noise(generator: Generator) -> NoiseLevel:
    """Noise of the level drawn at half of white, a share of whose variance is that of light."""
    level, share = generator.uniform(*NOISE), generator.uniform()
    return NoiseLevel(read=level * math.sqrt(1 - share), gain=share * level**2 / 0.5)


def _key(scene: Scene) -> str:
    """Name of what a scene's rendering depends on, its noise left out."""
    parts = (scene.camera, scene.path, scene.ball_radius, scene.exposure, scene.appearance)
    text = repr((*parts, scene.blur, scene.readout, fineness(scene)))
    digest = hashlib.sha256(text.encode())
    digest.update(scene.background.numpy().tobytes())
    return digest.hexdigest()[:24]
