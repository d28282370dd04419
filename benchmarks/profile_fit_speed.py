"""Speed of fitting all profiles at once, beside a loop of scipy.optimize.least_squares.

Conditions: one rendered straight streak of 300 x 60 px between the ball's first and last image, in
the benchmark scene (noise 1 % of white, ball colour given): 300 profiles in one call of
`fit_profiles`. One thread for everything. All fit the same pixels of all three channels with the
same weights, the same semi-ellipse averaged over a blur of the same fixed width, the same Huber
loss at 3 standard deviations, from the same first guess. The path is straight: fit_profiles holds
the skew, its fourth parameter, to 0 by a prior of standard deviation 0.001, the loops leave it
out. The rows are

- fit_profiles: tolerance 0.05 (its default: a step below 5 % of every standard deviation) and
  0.002; its time holds the first guess, the covariances and the flags, which the loops lack.
- scipy trf: the defaults, a 2-point Jacobian and ftol = xtol = gtol = 1e-8; the residuals are
  numpy. Of costs about 150 a profile, ftol stops at a step of 0.002 standard deviations: the same
  tolerance.
- scipy lm: MINPACK with the analytic Jacobian and the same tolerances; it knows no robust loss,
  so the residuals are replaced by the signed roots of their Huber costs, which have the same
  minimum.

Rounds are interleaved; medians are printed. Agreement counts the profiles whose three parameters
all lie within 0.05 standard deviations of those of fit_profiles at tolerance 0.002.
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares

from plugins.uniform import Uniform
from toolkit.profile_fit import START_BLUR, _first_guess, fit_profiles
from toolkit.profile_model import OUTLIER_SAMPLE
from toolkit.profiles import gather_profiles
from toolkit.semi_ellipse import WINDOW_PER_BLUR
from toolkit.streak_fit import PROFILE_REACH
from toolkit.synthetic import benchmark_scene, render_shot
from toolkit.types import Profiles
from toolkit.view import observe_streak

Array = NDArray[np.float64]
COUNT, WIDTH = 300, 60
CLOSE = 0.05
"""Standard deviations within which two solutions agree."""


@dataclass(frozen=True, kw_only=True)
class Samples:
    """One profile for numpy, N samples of which each shows three channels."""

    offset: Array  # [N] px
    contrast: Array  # [N, 3] ball minus background, in standard deviations
    observed: Array  # [N, 3] shot minus background, in standard deviations
    start: Array  # [3] centre, half width, opacity


def make_profiles(seed: int) -> tuple[Profiles, Uniform]:
    """Render the streak and gather the profiles between the ball's first and last image."""
    scene = benchmark_scene(width_px=WIDTH, length_widths=COUNT / WIDTH + 1, seed=seed)
    shot = render_shot(scene, seed=seed)
    estimator = Uniform(colour=scene.appearance.colour)
    view = observe_streak(shot.image, shot.background, estimator)
    reach = PROFILE_REACH * WIDTH / 2 + 4
    everything = gather_profiles(
        view.observation, view.clipped, view.streak.axis, reach, corner=view.corner
    )
    first = (everything.position.shape[1] - COUNT) // 2
    middle = slice(first, first + COUNT)
    cut = {f.name: getattr(everything, f.name)[:, middle] for f in fields(everything)}
    return replace(everything, **cut), estimator


def for_numpy(profiles: Profiles, estimator: Uniform) -> list[Samples]:
    """Hand the same samples, weights and first guesses to numpy, without empty places."""
    no_skew = torch.zeros(COUNT, dtype=torch.float64)
    start = _first_guess(profiles, estimator, rough_half_width(), no_skew)[:, :3].numpy()
    samples = []
    for index in range(COUNT):
        used = profiles.valid[0, index]
        signal, ground, variance = (
            values[0, index][used].numpy()
            for values in (profiles.signal, profiles.ground, profiles.variance)
        )
        weight = 1 / np.sqrt(variance)
        samples.append(
            Samples(
                offset=profiles.offset[0, index][used].numpy(),
                contrast=(np.array(estimator.colour) - ground) * weight,
                observed=(signal - ground) * weight,
                start=start[index],
            )
        )
    return samples


def rough_half_width() -> torch.Tensor:
    """Give the half width that bounds the first guess, px."""
    return torch.tensor([WIDTH / 2], dtype=torch.float64)


def residual(x: Array, samples: Samples) -> Array:
    """Give the whitened residuals of one profile [N * 3]."""
    centre, half_width, opacity = x
    half_window = START_BLUR * WINDOW_PER_BLUR / 2
    upper = _area((samples.offset + half_window - centre) / half_width)
    lower = _area((samples.offset - half_window - centre) / half_width)
    alpha = opacity * half_width * (upper - lower) / (2 * half_window)
    return (alpha[:, None] * samples.contrast - samples.observed).ravel()


def _area(share: Array) -> Array:
    s = np.clip(share, -1, 1)
    area: Array = (s * np.sqrt(1 - s * s) + np.arcsin(s)) / 2
    return area


def J_residual(x: Array, samples: Samples) -> Array:
    """Give the Jacobian of `residual` [N * 3, 3]."""
    centre, half_width, opacity = x
    half_window = START_BLUR * WINDOW_PER_BLUR / 2
    upper = np.clip((samples.offset + half_window - centre) / half_width, -1, 1)
    lower = np.clip((samples.offset - half_window - centre) / half_width, -1, 1)
    high, low = np.sqrt(1 - upper * upper), np.sqrt(1 - lower * lower)
    arc = (np.arcsin(upper) - np.arcsin(lower)) / 2
    moment = (upper * high - lower * low) / 2
    columns = [opacity * (low - high), opacity * (arc - moment), half_width * (arc + moment)]
    J_alpha = np.stack(columns, axis=-1) / (2 * half_window)
    J: Array = (samples.contrast[..., None] * J_alpha[:, None]).reshape(-1, 3)
    return J


def robust_residual(x: Array, samples: Samples) -> Array:
    """Give residuals whose squares are the Huber costs."""
    r = residual(x, samples)
    size = np.abs(r)
    return np.sign(r) * np.sqrt(_huber(size))


def J_robust_residual(x: Array, samples: Samples) -> Array:
    """Give the Jacobian of `robust_residual`."""
    size = np.abs(residual(x, samples))
    slope = np.where(
        size <= OUTLIER_SAMPLE, 1.0, OUTLIER_SAMPLE / np.sqrt(_huber(size)).clip(1e-300)
    )
    J: Array = J_residual(x, samples) * slope[:, None]
    return J


def _huber(size: Array) -> Array:
    linear = 2 * OUTLIER_SAMPLE * size - OUTLIER_SAMPLE**2
    return np.where(size <= OUTLIER_SAMPLE, size * size, linear)


def loop_trf(samples: list[Samples]) -> Array:
    """Fit one profile after the other with the defaults."""
    return np.stack(
        [
            least_squares(residual, s.start, loss="huber", f_scale=OUTLIER_SAMPLE, args=(s,)).x
            for s in samples
        ]
    )


def loop_lm(samples: list[Samples]) -> Array:
    """Fit one profile after the other with MINPACK and the analytic Jacobian."""
    return np.stack(
        [
            least_squares(robust_residual, s.start, J_robust_residual, method="lm", args=(s,)).x
            for s in samples
        ]
    )


def at_once(profiles: Profiles, estimator: Uniform, tolerance: float) -> Array:
    """Fit all profiles in one call, the blur fixed."""
    fit = fit_profiles(
        profiles, estimator, half_width=rough_half_width(), tolerance=tolerance, blur_rounds=1
    )
    return torch.stack([fit.centre, fit.half_width, fit.opacity], dim=-1)[0].numpy()


def race(
    methods: dict[str, Callable[[], Array]], rounds: int
) -> tuple[dict[str, float], dict[str, Array]]:
    """Run all methods in turn; give each one's median seconds and its solution."""
    times: dict[str, list[float]] = {name: [] for name in methods}
    found = {name: method() for name, method in methods.items()}  # the first calls warm up
    for _ in range(rounds):
        for name, method in methods.items():
            start = time.perf_counter()
            method()
            times[name].append(time.perf_counter() - start)
    return {name: float(np.median(values)) for name, values in times.items()}, found


def standard_deviations(samples: list[Samples], solution: Array) -> Array:
    """Give each parameter's standard deviation at the solution [P, 3]."""
    jacobians = (J_residual(x, s) for x, s in zip(solution, samples, strict=True))
    return np.stack([np.sqrt(np.diag(np.linalg.inv(J.T @ J))) for J in jacobians])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    profiles, estimator = make_profiles(arguments.seed)
    samples = for_numpy(profiles, estimator)
    exact = "fit_profiles, tolerance 0.002"
    methods = {
        "fit_profiles, tolerance 0.05": lambda: at_once(profiles, estimator, 0.05),
        exact: lambda: at_once(profiles, estimator, 0.002),
        "scipy trf, 2-point": lambda: loop_trf(samples),
        "scipy lm, analytic": lambda: loop_lm(samples),
    }
    seconds, found = race(methods, arguments.rounds)
    std = standard_deviations(samples, found[exact])
    fastest = seconds["fit_profiles, tolerance 0.05"]
    numbers = np.median([s.observed.size for s in samples])
    print(f"{COUNT} profiles of {numbers:.0f} numbers each, medians of {arguments.rounds} rounds")
    print(f"{'':30}{'ms':>9}{'times as long':>15}{'agree':>8}{'worst, std':>12}")
    for name, time_s in seconds.items():
        gap = (np.abs(found[name] - found[exact]) / std).max(1)
        print(
            f"{name:30}{1000 * time_s:9.1f}{time_s / fastest:15.1f}"
            f"{100 * (gap < CLOSE).mean():7.1f}%{gap.max():12.3f}"
        )


if __name__ == "__main__":
    main()
