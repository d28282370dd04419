"""Time to lay out the light of one ball and its mean colours, beside one cold profile fit.

Conditions: every figure comes from a fresh process on one thread, its imports not counted: the
light from a sharp ball on 129 x 129 nodes, with the mean colours along 100 lines of sight; the fit
of all profiles of a streak 300 x 60 px in the benchmark scene, from gathering their pixels on.
Rounds are interleaved; medians are printed.
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"

import argparse
import subprocess
import sys
import time

import numpy as np
import torch

from plugins.known_shading import KnownShading
from plugins.uniform import Uniform
from toolkit import Chord, Disc, SharpBall
from toolkit.profile_fit import fit_profiles
from toolkit.profiles import gather_profiles
from toolkit.synthetic import benchmark_scene, render_shot
from toolkit.view import observe_streak

NODES, LINES = 129, 100
WIDTH, LENGTH = 60, 300


def time_table() -> float:
    """Lay out a smoothly shaded ball's light; give the seconds it took."""
    place = torch.linspace(-1, 1, NODES)
    shade = (0.6 - 0.3 * place[:, None] - 0.2 * place).expand(3, NODES, NODES)
    disc = Disc(centre=(50.0, 50.0), semi_axes=(30.0, 30.0), angle=0.0, std=0.1)
    estimator = KnownShading(ball=SharpBall(disc=disc, rgb=shade.clone()))
    line = torch.linspace(0, 1, LINES)[:, None]
    chord = Chord(offset=torch.zeros(LINES, 1), direction=line)
    start = time.perf_counter()
    estimator.foreground_and_slope(chord)
    return time.perf_counter() - start


def time_fit() -> float:
    """Gather and fit all profiles for the first time; give the seconds it took."""
    scene = benchmark_scene(width_px=WIDTH, length_widths=LENGTH / WIDTH, seed=1)
    shot = render_shot(scene, seed=1, step=1.0)
    estimator = Uniform(colour=scene.appearance.colour)
    view = observe_streak(shot.image, shot.background, estimator)
    start = time.perf_counter()
    profiles = gather_profiles(
        view.observation, view.clipped, view.streak.axis, 0.8 * WIDTH, corner=view.corner
    )
    fit_profiles(profiles, estimator, half_width=view.streak.half_width)
    return time.perf_counter() - start


TASKS = {"table": time_table, "fit": time_fit}


def cold(task: str) -> float:
    """Run a task in a fresh process; give the seconds it tells."""
    command = [sys.executable, __file__, "--only", task]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout)


def main() -> None:
    """Print both times and their ratio."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=list(TASKS), help="one task, once, in this process")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.only:
        print(TASKS[arguments.only]())
        return
    times = np.array([[cold(task) for task in TASKS] for _ in range(arguments.rounds)])
    table, fit = np.median(times, axis=0)
    ratio = np.median(times[:, 0] / times[:, 1])
    print(f"light {1000 * table:.0f} ms, cold profile fit {1000 * fit:.0f} ms, ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
