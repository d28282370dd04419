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
the path that was found in the largest of the pictures, and what the noise alone makes one expect of
it (drawn from the Cramer-Rao bound about the true path); distance from the true path, the same of
it, what the stated standard deviations make one expect, and its largest value; the paper's figure
for the first, and how many times less ours is. The last column says what was reached: both at most
a tenth of the paper's figure, or at most 1.2 times what the bound leaves.
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import dataclasses
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from sweep_scenes import render
from sweep_score import single_threaded

from plugins.uniform import Uniform
from toolkit import Camera, Measurement, ToolkitError, measure
from toolkit.guarded import guarded
from toolkit.sweep.fit import outline
from toolkit.sweep.likelihood import compare
from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import PARABOLA, BouncePath, SweepPath
from toolkit.sweep.pixels import Frame
from toolkit.synthetic import (
    BouncingPath,
    NoiseLevel,
    PlainBall,
    RenderedShot,
    Scene,
    textured_background,
)
from toolkit.view import observe_streak

Array = NDArray[np.float64]

PAPER = {100: 0.126, 75: 0.130, 50: 0.152, 25: 0.240}
"""Mean distance from the plane, R, by scale in percent."""
BALL_RADIUS, FOCAL, SIZE = 0.02, 3750.0, (3008, 2000)
EXPOSURE = {"bounce": 1.0, "arc": 0.5}
TABLE = 0.17
"""Height of the ball's centre when it touches the table, m below the optical axis."""
WHITE, WALL = (0.9, 0.9, 0.9), (0.12, 0.12, 0.12)
PATH_POINTS = 20_001
SAMPLES, DRAWS = 41, 200
"""Points of a path drawn from the bound, and how many are drawn."""
PIXEL_BLUR = 0.1
"""px^2, of a picture without a lens's blur."""
ALLOWED = 1.2
"""Times the bound that counts as reached."""


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


def kind_of_path(scene: Scene) -> SweepPath:
    """Give the kind of path that a flight is."""
    instant = scene.path.bounce_time / scene.exposure - 0.5
    return BouncePath((instant,)) if instant < 0.5 else PARABOLA


def drawn_paths(shot: RenderedShot, seed: int) -> Array:
    """Draw paths [D, T, 3] m from the Cramer-Rao bound about the true one: none errs less.

    Blur, gain and offset of the light are as unknown as they are to the measurement.
    """
    scene = shot.scene
    estimator = guarded(Uniform(colour=scene.appearance.colour)).seen_through(scene.camera)
    view = observe_streak(shot.image, shot.background, estimator)
    model = SweepModel(
        path=kind_of_path(scene),
        estimator=estimator,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
    )
    time = torch.linspace(-0.5, 0.5, SAMPLES, dtype=torch.float64)
    shape = model.path.through(time, scene.path.position((time + 0.5) * scene.exposure))
    light = torch.cat([torch.full((1,), PIXEL_BLUR), torch.ones(3), torch.zeros(3)]).double()
    x = torch.cat([shape, light])
    middle, half_width = outline(model, x)
    pixels = Frame.of(view, estimator, scene.camera).about(middle, half_width)
    covariance = torch.linalg.inv(compare(model, x, pixels).information)[: len(shape), : len(shape)]
    generator = np.random.default_rng([seed, 37])
    draws = generator.multivariate_normal(shape.numpy(), covariance.numpy(), size=DRAWS)
    return np.stack([model.path.arcs(torch.from_numpy(d)).at(time)[0].numpy() for d in draws])


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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """What one shot gave, in R."""

    off_plane: float
    off_plane_bound: float
    error: float
    error_bound: float
    told: float
    largest: float
    seconds: float


def measure_shot(
    shot: RenderedShot, seed: int, stage: str, planes: list[tuple[Array, float]]
) -> Row:
    """Measure a shot; `planes` holds those of the largest picture, found and drawn, once known."""
    result = find_path(shot, stage)
    path, drawn = np.array(result.trajectory.position_m), drawn_paths(shot, seed)
    if not planes:
        planes.extend(upright_plane(each) for each in (path, *drawn))
    off_plane, *off_planes = (
        float(np.abs(each @ normal - distance).mean()) / BALL_RADIUS
        for each, (normal, distance) in zip((path, *drawn), planes, strict=True)
    )
    near = gaps(path, shot.scene)
    return Row(
        off_plane=off_plane,
        off_plane_bound=float(np.mean(off_planes)),
        error=float(near.mean()),
        error_bound=float(np.mean([gaps(each, shot.scene).mean() for each in drawn[::10]])),
        told=expected(result),
        largest=float(near.max()),
        seconds=sum(result.timing_s.values()),
    )


def run(name: str, scales: list[int], shots: int, cache: Path | None, stage: str) -> None:
    """Print a row for each scale."""
    found: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for seed in range(shots):
        planes: list[tuple[Array, float]] = []
        for scale in scales:
            # each picture has noise of its own, lest one bad draw shows in every row
            noise_seed = 1000 * seed + 2 * scale + (name == "arc")
            shot = render(draw_scene(name, scale, seed), noise_seed, cache)
            try:
                row = measure_shot(shot, seed, stage, planes)
            except ToolkitError as refusal:
                print(f"{name} {scale} %, shot {seed}, refused: {refusal}", flush=True)
                continue
            found[scale].append(dataclasses.astuple(row))
    for scale in scales:
        if found[scale]:
            row = Row(**dict(zip(Row.__annotations__, np.mean(found[scale], axis=0), strict=True)))
            print_row(name, scale, f"{len(found[scale])}/{shots}", row)


def print_row(name: str, scale: int, count: str, row: Row) -> None:
    """Print one line of the table."""
    width, height = (side * scale // 100 for side in SIZE)
    tenth = PAPER[scale] / 10
    reached = "a tenth" if max(row.off_plane, row.error) <= tenth else "missed"
    is_near = row.off_plane <= max(tenth, ALLOWED * row.off_plane_bound)
    if reached == "missed" and is_near and row.error <= max(tenth, ALLOWED * row.error_bound):
        reached = "the bound"
    print(
        f"{name:8}{width:6} x {height:<6}{count:>5}{row.off_plane:11.4f}{row.off_plane_bound:8.4f}"
        f"{row.error:12.4f}{row.error_bound:8.4f}{row.told:8.4f}{row.largest:8.4f}"
        f"{PAPER[scale]:8.3f}{PAPER[scale] / row.off_plane:7.0f}{row.seconds:9.1f}  {reached}",
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
        "flight  picture        shots  off plane   bound  path error   bound    told    most"
        "   paper  times  seconds  reached"
    )
    for name in arguments.flight:
        run(name, arguments.scale, arguments.shots, arguments.cache, arguments.stage)


if __name__ == "__main__":
    main()
