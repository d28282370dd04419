"""Whether the shots of `sweep_scenes` are rendered finely enough to judge an exact measurement.

    python benchmarks/sweep_rendering.py [--shots N]

Each is rendered again with sharp images three times closer and three times as many rays along a
pixel's side. Printed are the largest and the rms difference over the streak's pixels, in 1e-4 of
white, and by what share of the shot's Cramer-Rao bound that moves the likeliest x, y, z and speed.
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import time

import numpy as np
from sweep_bound import slopes_by_rendering
from sweep_scenes import draw_scene, facts, fineness
from sweep_score import AXES, single_threaded

from toolkit.synthetic import RenderedShot, render_shot

FINER = 3


def ball_light(shot: RenderedShot) -> np.ndarray:
    """What the ball adds to the background's picture; the scene behind is the same for both."""
    return (shot.clean_image - shot.clean_background).double().numpy()


def main() -> None:
    """Print a row for each shot, and the largest and the rms of all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    single_threaded()
    print(
        "    seed  width px  widths  blur px   most    rms  seconds    shift in bounds:"
        + "".join(f"{axis:>8}" for axis in AXES)
    )
    shifts = []
    for seed in range(arguments.seed * 100_000, arguments.seed * 100_000 + arguments.shots):
        scene = draw_scene(seed)
        since = time.perf_counter()
        step, rays = fineness(scene)
        shot = render_shot(scene, step=step, supersampling=rays)
        seconds = time.perf_counter() - since
        finer = render_shot(scene, step=step / FINER, supersampling=FINER * rays)
        change = ball_light(shot) - ball_light(finer)
        on_ball = change[:, shot.alpha.numpy() > 0]
        slopes = slopes_by_rendering(scene, is_colour_known=False, gain_std=0.02, offset_std=0.005)
        shifts.append(slopes.shift(change) / slopes.std)
        told = facts(shot)
        print(
            f"{seed:8}{told['width_px']:10.1f}{told['length_widths']:8.2f}{scene.blur:9.2f}"
            f"{1e4 * np.abs(change).max():7.2f}{1e4 * np.sqrt((on_ball**2).mean()):7.2f}"
            f"{seconds:9.2f}{'':20}" + "".join(f"{value:8.3f}" for value in shifts[-1]),
            flush=True,
        )
    for name, value in (
        ("most", np.abs(shifts).max(axis=0)),
        ("rms", np.sqrt(np.mean(np.square(shifts), axis=0))),
    ):
        print(f"{name:78}" + "".join(f"{number:8.3f}" for number in value))


if __name__ == "__main__":
    main()
