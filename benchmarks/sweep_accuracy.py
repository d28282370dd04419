"""Accuracy and honesty of the exact stage on straight streaks, against the Cramer-Rao bound.

The shots, rendered by brute force, are those of `sweep_scenes`: widths 30 to 150 px, lengths 0.5
to 8 widths, distances 15 to 100 R, tilts up to 60 degrees, noise 0.5 to 3 % of white, point spread
0 to 1.2 px, distortion, off the axis, the ball's colour unknown.

    python benchmarks/sweep_accuracy.py [--shots N] [--workers 2] [--cache DIR] [--save FILE]

Lines of the table, for x, y, z at mid-exposure and the speed: rms of the error over the `bound`
that the result states; of the error over the standard deviation that it states, its median and
mean; share of the truths within 1.96 stated standard deviations. The sign of the motion is taken to
be that nearest to the truth. Shots whose bound on the speed exceeds a tenth of it are counted
apart: their interval has to hold the truth, or the upper limit where none is stated. NEES is
e' P^-1 e of the six of position and velocity, 6 on average where the covariance P is right.

With --row-delay S the sensor reads its rows one after the other, S seconds apart (10e-6: 20 ms
for 2000 rows). One sign of the motion may then fit better; how often that is the true one is told.

    python benchmarks/sweep_accuracy.py --check-bound N

takes N of the shots and compares the `bound` stated with one from renderings alone (`sweep_bound`).
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sweep_bound import slopes_by_rendering
from sweep_scenes import draw_scene, facts, sweep_shot
from sweep_score import (
    AXES,
    Row,
    in_processes,
    load_rows,
    save_rows,
    score,
    summary,
)

from plugins.uniform import Uniform


def run_shot(
    seed: int, *, cache: Path | None, stage: str, is_colour_known: bool, row_delay: float
) -> Row:
    """Render and measure the seed's shot."""
    shot = sweep_shot(seed, cache, row_delay)
    estimator = Uniform(colour=shot.scene.appearance.colour) if is_colour_known else Uniform()
    return {"seed": seed, **facts(shot), **score(shot, estimator, stage=stage)}


def check_bound(seed: int, *, is_colour_known: bool, row_delay: float, **options: Any) -> Row:
    """Add the bound from renderings alone."""
    from toolkit.sweep.likelihood import GAIN_STD, OFFSET_STD

    row = run_shot(seed, is_colour_known=is_colour_known, row_delay=row_delay, **options)
    slopes = slopes_by_rendering(
        draw_scene(seed, row_delay),
        is_colour_known=is_colour_known,
        gain_std=GAIN_STD,
        offset_std=OFFSET_STD,
    )
    return row | {"bound_by_rendering": slopes.std.tolist()}


def print_bounds(rows: list[Row]) -> None:
    """Print the bound stated over that from renderings, shot by shot."""
    print(f"{'seed':>8}{'width px':>10}{'widths':>8}" + "".join(f"{axis:>9}" for axis in AXES))
    ratios = []
    for row in rows:
        if row["refused"] is not None or row["bound"] is None:
            print(f"{row['seed']:8} no bound: {row['refused'] or 'of stage ' + row['stage']}")
            continue
        ratio = np.array(row["bound"], dtype=float) / np.array(row["bound_by_rendering"])
        ratios.append(ratio)
        print(
            f"{row['seed']:8}{row['width_px']:10.1f}{row['length_widths']:8.2f}"
            + "".join(f"{value:9.3f}" for value in ratio),
            flush=True,
        )
    if ratios:
        print(f"{'mean':26}" + "".join(f"{value:9.3f}" for value in np.mean(ratios, axis=0)))


def main() -> None:
    """Run the shots, or sum up rows that were saved."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1, help="of the run: shots are SEED00000 on")
    parser.add_argument("--only", type=int, nargs="+", help="these shots, as they are named")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--stage", default="sweep", choices=["contours", "sweep"])
    parser.add_argument("--colour-known", action="store_true")
    parser.add_argument("--row-delay", type=float, default=0.0)
    parser.add_argument("--cache", type=Path, help="folder that keeps what was rendered")
    parser.add_argument("--save", type=Path, help="file for one row of JSON a shot")
    parser.add_argument("--load", type=Path, help="sum up rows saved before instead")
    parser.add_argument("--check-bound", type=int, metavar="N")
    arguments = parser.parse_args()
    if arguments.load is not None:
        print(summary(load_rows(arguments.load)))
        return
    count = arguments.check_bound or arguments.shots
    seeds = arguments.only or [arguments.seed * 100_000 + index for index in range(count)]
    work = partial(
        check_bound if arguments.check_bound else run_shot,
        cache=arguments.cache,
        stage=arguments.stage,
        is_colour_known=arguments.colour_known,
        row_delay=arguments.row_delay,
    )
    rows = list(in_processes(work, seeds, arguments.workers))
    if arguments.save is not None:
        save_rows(arguments.save, rows)
    if arguments.check_bound:
        print_bounds(rows)
    else:
        print(summary(rows))


if __name__ == "__main__":
    main()
