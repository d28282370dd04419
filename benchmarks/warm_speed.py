"""Time of one warm measurement, beside that of `import torch` in the same run.

Conditions: colour pictures of 1632 x 1224 px (2.0 megapixels) already in memory, a straight streak
of 300 x 60 px from tip to tip in the benchmark scene (50 radii away, noise 1 % of white, point
spread 0.7 px), through a lens of five distortion coefficients; measured with the ball's colour
given and not given, through a camera file without and with a covariance of its parameters. One
thread for everything, and the first measurements are not counted: what is loaded and cached once
is warm. `import torch` runs in a process of its own, its bytecode and files warm in the system's
cache. Rounds are interleaved. Printed are medians: milliseconds of each stage and of the whole by
the clock, of processor time, and the median of each round's ratio of processor times.
"""

import os

# read when the libraries are first imported, hence before them; processes started inherit them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import torch

from plugins.uniform import Uniform
from toolkit import Camera, Measurement, measure
from toolkit.synthetic import RenderedShot, benchmark_scene, render_shot

SIZE = (1632, 1224)
LENGTH, WIDTH = 300, 60
DISTORTION = (-0.12, 0.05, 0.0005, -0.0003, 0.0)
CAMERA_STD = (1.5, 1.5, 1.0, 1.0, 3e-3, 1e-2, 1e-4, 1e-4, 1e-2)
"""Of [fx fy cx cy, distortion...], as a dozen pictures of a board leave them."""
IMPORT = [sys.executable, "-c", "import torch"]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One kind of measurement, and what its rounds took."""

    name: str
    run: Callable[[], Measurement]
    wall: list[float] = field(default_factory=list)  # s
    cpu: list[float] = field(default_factory=list)  # s
    stages: list[dict[str, float]] = field(default_factory=list)  # s

    def once(self) -> None:
        """Measure once and note the times."""
        wall, cpu = time.perf_counter(), time.process_time()
        result = self.run()
        self.cpu.append(time.process_time() - cpu)
        self.wall.append(time.perf_counter() - wall)
        self.stages.append(dict(result.timing_s))


def make_rows(shot: RenderedShot, stage: str) -> list[Row]:
    """Give all kinds of measurement of a shot."""
    scene = shot.scene
    colours = {"colour given": Uniform(colour=scene.appearance.colour), "colour open": Uniform()}
    covariance = torch.diag(torch.tensor(CAMERA_STD, dtype=torch.float64) ** 2)
    cameras = {"": scene.camera, ", camera too": replace(scene.camera, covariance=covariance)}
    return [
        Row(name=colour + suffix, run=measurement(shot, camera, estimator, stage))
        for suffix, camera in cameras.items()
        for colour, estimator in colours.items()
    ]


def measurement(
    shot: RenderedShot, camera: Camera, estimator: Uniform, stage: str
) -> Callable[[], Measurement]:
    """Give the call that is timed."""
    scene = shot.scene

    def run() -> Measurement:
        return measure(
            shot.image,
            shot.background,
            camera=camera,
            ball_radius=scene.ball_radius,
            exposure=scene.exposure,
            estimator=estimator,
            stage=stage,
        )

    return run


def import_torch() -> tuple[float, float]:
    """Give wall and processor time of `import torch` in a new process, s."""
    wall, before = time.perf_counter(), os.times()
    subprocess.run(IMPORT, check=True)
    after = os.times()
    cpu = sum(after[2:4]) - sum(before[2:4])
    return time.perf_counter() - wall, cpu


def print_table(rows: list[Row], imports: list[tuple[float, float]]) -> None:
    """Print medians in ms, and ratios."""
    stages = list(dict.fromkeys(name for row in rows for name in row.stages[0]))
    wall, cpu = np.median(imports, axis=0)
    print(f"import torch: {1000 * wall:.0f} ms by the clock, {1000 * cpu:.0f} ms processor time")
    heads = [*stages, "whole", "processor"]
    print(" " * 26 + "".join(f"{head:>13}" for head in heads) + "   of import torch")
    for row in rows:
        parts = [float(np.median([times[name] for times in row.stages])) for name in stages]
        parts += [float(np.median(row.wall)), float(np.median(row.cpu))]
        ratio = float(np.median(np.array(row.cpu) / np.array(imports)[:, 1]))
        numbers = "".join(f"{1000 * part:13.1f}" for part in parts)
        print(f"{row.name:26}{numbers}{ratio:18.3f}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--stage", default="sweep", help="the last stage of the measurement")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    scene = benchmark_scene(
        width_px=WIDTH,
        length_widths=LENGTH / WIDTH - 1,
        distortion=DISTORTION,
        size=SIZE,
        seed=arguments.seed,
    )
    rows = make_rows(render_shot(scene, seed=arguments.seed), arguments.stage)
    for row in rows * 3:
        row.run()
    import_torch()
    imports = []
    for _ in range(arguments.rounds):
        imports.append(import_torch())
        for row in rows:
            row.once()
    print_table(rows, imports)


if __name__ == "__main__":
    main()
