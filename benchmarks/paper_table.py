"""The paper's Table 1 re-enacted: a bouncing ball, exposed for a second, at four resolutions.

Caglioti & Giusti 2007 photographed a table-tennis ball (here R = 20 mm) from about 50 R, in
pictures of 3008 x 2000 px, where its streak was 150 to 130 px wide, and scaled these to 75, 50 and
25 %. The part of the streak between two bounces lay in a vertical plane; their figure is the mean
distance of the path found from the plane fitted at full resolution.

Here the same is rendered: the ball rises from the table, falls, bounces once, rises and falls again
within the second, and moves from 47 to 54 R away meanwhile. Each resolution is rendered anew, with
noise of 1 % of white in each channel of every picture. The ball is white (0.9), its colour given,
the wall behind dark, a texture of at most 0.05 about 0.12. At its fastest the ball covers a pixel
for 1.5 % of the exposure: there the streak is as faint as the noise.

    python benchmarks/paper_table.py [--shots N] [--flight bounce arc] [--scale 100 75 50 25]

"arc" exposes the flight before the bounce alone, 0.5 s. Each shot starts anew, a little elsewhere.
Columns, in R, means over the path and over the shots: distance from the vertical plane fitted to
the path that was found in the largest of the pictures; distance from the true path; its largest
value; what the stated standard deviations make one expect of it; the paper's figure for the first,
and how many times less ours is.
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from sweep_scenes import render
from sweep_score import single_threaded

from plugins.uniform import Uniform
from toolkit import Camera, Measurement, ToolkitError, measure
from toolkit.synthetic import (
    BouncingPath,
    NoiseLevel,
    PlainBall,
    RenderedShot,
    Scene,
    textured_background,
)

Array = NDArray[np.float64]

PAPER = {100: 0.126, 75: 0.130, 50: 0.152, 25: 0.240}
"""Mean distance from the plane, R, by scale in percent."""
BALL_RADIUS, FOCAL, SIZE = 0.02, 3750.0, (3008, 2000)
EXPOSURE = {"bounce": 1.0, "arc": 0.5}
TABLE = 0.17
"""Height of the ball's centre when it touches the table, m below the optical axis."""
WHITE, WALL = (0.9, 0.9, 0.9), (0.12, 0.12, 0.12)
PATH_POINTS = 20_001


def flight(seed: int) -> BouncingPath:
    """Rise from the table for 0.28 s, fall, bounce after 0.56 s, and rise and fall again."""
    away = np.random.default_rng([seed, 36]).uniform(-1, 1, size=3) * [0.01, 0.01, 0.02]
    x, z, vx = away.tolist()
    return BouncingPath(
        start=(x - 0.31, TABLE - 0.005, 0.94 + z),
        start_velocity=(0.62 + vx, -2.75, 0.14),
        contact_height=TABLE,
    )


def draw_scene(name: str, scale: int, seed: int) -> Scene:
    """Give a shot of a flight at a scale, percent."""
    width, height = (side * scale // 100 for side in SIZE)
    full = Camera.centred(*SIZE, FOCAL)
    wall = textured_background(width, height, colour=WALL, contrast=0.05, seed=seed)
    return Scene(
        camera=full.resized(width, height),
        path=flight(seed),
        ball_radius=BALL_RADIUS,
        exposure=EXPOSURE[name],
        appearance=PlainBall(colour=WHITE),
        background=wall,
        noise=NoiseLevel(read=0.01),
    )


def find_path(shot: RenderedShot, stage: str) -> Measurement:
    """Measure a shot, the ball's colour given."""
    scene = shot.scene
    return measure(
        shot.image,
        shot.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=Uniform(colour=scene.appearance.colour),
        stage=stage,
    )


def upright_plane(path: Array) -> tuple[Array, float]:
    """Fit a vertical plane to points [N, 3] m: its unit normal and distance from the origin."""
    level = path[:, [0, 2]]
    _, _, axes = np.linalg.svd(level - level.mean(axis=0))
    normal = np.array([axes[1, 0], 0.0, axes[1, 1]])
    return normal, float(normal @ path.mean(axis=0))


def gaps(path: Array, scene: Scene) -> Array:
    """Give how far points [N, 3] m are from the true path, in R."""
    time = torch.linspace(0, scene.exposure, PATH_POINTS, dtype=torch.float64)
    true = scene.path.position(time).numpy()
    near = [np.linalg.norm(true - point, axis=-1).min() for point in path]
    return np.array(near) / BALL_RADIUS


def expected(result: Measurement) -> float:
    """Give the mean distance from the true path that the stated deviations make one expect, R.

    What they say along the path does not count; across it they are taken for independent.
    """
    std = np.array(result.trajectory.position_std_m)
    along = np.array(result.trajectory.velocity_m_s)
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    across = (std**2).sum(axis=-1) - ((std * along) ** 2).sum(axis=-1)
    # depth dominates: the mean of a normal number's size is 0.8 of its standard deviation
    return float(np.sqrt(2 / np.pi) * np.sqrt(across).mean()) / BALL_RADIUS


def run(name: str, scales: list[int], shots: int, cache: Path | None, stage: str) -> None:
    """Print a row for each scale."""
    found: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for seed in range(shots):
        plane = None
        for scale in scales:
            shot = render(draw_scene(name, scale, seed), seed, cache)
            try:
                result = find_path(shot, stage)
            except ToolkitError as refusal:
                print(f"{name} {scale} %, shot {seed}, refused: {refusal}", flush=True)
                continue
            path = np.array(result.trajectory.position_m)
            normal, distance = plane = plane or upright_plane(path)
            off_plane = float(np.abs(path @ normal - distance).mean()) / BALL_RADIUS
            near = gaps(path, shot.scene)
            seconds = sum(result.timing_s.values())
            found[scale].append((off_plane, near.mean(), near.max(), expected(result), seconds))
    for scale in scales:
        if found[scale]:
            off_plane, path_error, worst, told, seconds = np.mean(found[scale], axis=0)
            width, height = (side * scale // 100 for side in SIZE)
            print(
                f"{name:8}{width:6} x {height:<6}{len(found[scale]):4}/{shots:<4}{off_plane:9.4f}"
                f"{path_error:12.4f}{worst:9.4f}{told:10.4f}{PAPER[scale]:9.3f}"
                f"{PAPER[scale] / off_plane:10.0f}{seconds:10.1f}",
                flush=True,
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=5)
    parser.add_argument("--flight", nargs="+", choices=list(EXPOSURE), default=list(EXPOSURE))
    parser.add_argument("--scale", nargs="+", type=int, choices=list(PAPER), default=list(PAPER))
    parser.add_argument("--stage", default="sweep", choices=["contours", "sweep"])
    parser.add_argument("--cache", type=Path, help="folder that keeps what was rendered")
    arguments = parser.parse_args()
    single_threaded()
    print(
        "flight  picture          shots  off plane  path error     most  expected    paper"
        "  times less  seconds"
    )
    for name in arguments.flight:
        run(name, arguments.scale, arguments.shots, arguments.cache, arguments.stage)


if __name__ == "__main__":
    main()
