"""A ball's radius from sharp pictures at known distances: its error against the one stated.

Conditions: the benchmark scene (smooth coloured texture, noise 1 % of white, lens point spread
0.7 px, one background picture) with the ball at rest, 20 to 60 px in radius, up to 2 radii off the
axis, at 12 to 25 radii. Each set has three pictures by one camera, whose file errs as its
covariance says: 0.2 % of the focal length, alike in both directions, and 1 px of the centre; the
distances told err by one draw of 0.2 % for all and no more. Balls: plain, matt, shiny, and, before
a lamp, with stripes or a football's panels, turned otherwise in each picture.

Then, in sets of four, one distance is told 10 % too large: how often that picture is named, and how
many others with it.

    python benchmarks/ball_pictures.py [--sets N] [--seed N]

Columns: rms of the error, % of the radius; rms of error over standard deviation; share of intervals
of 95 % that hold the truth; wrong distances named of those told, good ones lost.
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"

import argparse
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from toolkit import CalibrationError
from toolkit.ball import Disc
from toolkit.ball_size import SizeInView, find_radius, size_in_view
from toolkit.camera import Camera
from toolkit.disc import view_ball
from toolkit.synthetic import (
    LambertBall,
    LitBall,
    PanelledBall,
    Scene,
    StripedBall,
    benchmark_scene,
    render_sharp,
    render_shot,
)

FOCAL_STD, CENTRE_STD, DISTANCE_STD = 0.002, 1.0, 0.002
WRONG = 1.1
BLUE = (0.1, 0.2, 0.6)
Colour = tuple[float, float, float]
Look = Callable[[Colour, np.random.Generator], object]


def direction(generator: np.random.Generator) -> Colour:
    x, y, z = generator.standard_normal(3)
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


LOOKS: dict[str, Look | None] = {
    "plain": None,
    "matt": lambda colour, _: LambertBall(colour=colour),
    "shiny": lambda colour, _: LambertBall(colour=colour, highlight=0.3),
    "stripes": lambda colour, draw: LitBall(
        pattern=StripedBall(colours=(colour, BLUE), pole=direction(draw))
    ),
    "football": lambda colour, draw: LitBall(pattern=PanelledBall(colours=(colour, BLUE))),
}


def covariance(camera: Camera) -> torch.Tensor:
    """Of fx fy cx cy: one error of both focal lengths, and of the centre."""
    found = torch.diag(torch.tensor([0, 0, CENTRE_STD**2, CENTRE_STD**2], dtype=torch.float64))
    found[:2, :2] = (FOCAL_STD * camera.fx) ** 2
    return found


def picture(
    look: Look | None, generator: np.random.Generator, count: int
) -> tuple[Scene, list[tuple[Disc, float]]]:
    """Render sharp views of one ball, with their distances; those refused are drawn anew."""
    seed = int(generator.integers(1 << 30))
    radius_px = generator.uniform(30, 60)
    scene = benchmark_scene(
        width_px=2 * radius_px, length_widths=1, distance_R=12, size=(400, 380), seed=seed
    )
    colour = scene.appearance.colour
    empty = render_shot(scene, seed=seed, step=3.0, supersampling=1).background
    views: list[tuple[Disc, float]] = []
    while len(views) < count:
        if look is not None:
            scene = replace(scene, appearance=look(colour, generator))
        away = generator.uniform(12, 12 * radius_px / 20 if radius_px < 40 else 25)
        x, y = generator.uniform(-2, 2, 2)
        place = tuple(scene.ball_radius * v for v in (x, y, away))
        sharp = render_sharp(scene, seed=int(generator.integers(1 << 30)), position=place)
        try:
            views.append((view_ball(sharp.image, empty).picture_disc, math.hypot(*place)))
        except CalibrationError as error:
            print(f"  refused: {error}")
    return scene, views


def one_set(
    look: Look | None, generator: np.random.Generator, count: int
) -> tuple[list[SizeInView], list[float], Camera, float]:
    """Give sizes as a camera file that errs tells them, and distances as told."""
    scene, views = picture(look, generator, count)
    camera = replace(scene.camera, covariance=covariance(scene.camera))
    focal = 1 + FOCAL_STD * generator.standard_normal()
    x, y = CENTRE_STD * generator.standard_normal(2)
    erring = replace(
        camera, fx=camera.fx * focal, fy=camera.fy * focal, cx=camera.cx + x, cy=camera.cy + y
    )
    error = 1 + DISTANCE_STD * generator.standard_normal()
    sizes = [size_in_view(disc, erring) for disc, _ in views]
    return sizes, [error * away for _, away in views], erring, scene.ball_radius


def run(name: str, sets: int, seed: int) -> None:
    generator = np.random.default_rng([seed, list(LOOKS).index(name)])
    errors, stated, named, lost = [], [], 0, 0
    for _ in range(sets):
        sizes, distances, camera, true = one_set(LOOKS[name], generator, 4)
        std = DISTANCE_STD * distances[0]
        found = find_radius(sizes[:3], distances[:3], std, camera)
        errors.append(found.radius / true - 1)
        stated.append(found.std / true)
        lost += len(found.contradicting)
        told = [*distances[:3], WRONG * distances[3]]
        wrong = find_radius(sizes, told, std, camera)
        named += 3 in wrong.contradicting
        lost += len(set(wrong.contradicting) - {3})
    error, std_ = np.array(errors), np.array(stated)
    print(
        f"{name:9s} {100 * np.sqrt((error**2).mean()):6.3f} % "
        f"{np.sqrt(((error / std_) ** 2).mean()):6.2f} {(abs(error) < 1.96 * std_).mean():6.2f} "
        f"{named:4d} of {sets}, lost {lost} of {6 * sets}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Radius from sharp pictures.")
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", nargs="+", choices=LOOKS, default=list(LOOKS))
    options = parser.parse_args()
    torch.set_num_threads(1)
    print("ball       error    / std  in 95 %  wrong distances named")
    for name in options.kind:
        run(name, options.sets, options.seed)


if __name__ == "__main__":
    main()
