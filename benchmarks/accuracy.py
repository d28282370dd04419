"""Accuracy of the measurement on brute-force rendered streaks before a textured background.

The benchmark scene: ball at 50 radii R (and 15 R beside it), |F - B| >= 0.4, noise 1 % of white in
each channel of the shot and of each background picture, lens point spread 0.7 px, colour given.
Straight streaks are 40 to 110 px wide and 3 to 7 widths long, curved ones 60 to 110 px wide, 4 to 7
widths long and bent by 0.4 to 1.1 widths; both tilted up to 30 degrees out of the image plane.

    python benchmarks/accuracy.py [--shots N] [--kind straight curved] [--stage contours]

Columns: median over the shots of the median and of the rms distance of the path found from the true
one, of the rms error of the speed along it, of the angle between the directions at mid-exposure, of
the position's error at mid-exposure along and across the viewing ray; then the share of shots whose
errors lie within 1.96 reported standard deviations, for x y z vx vy vz and the speed.
"""

import argparse
import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from plugins.uniform import Uniform
from toolkit import LinearImage, Measurement, StreakError, measure
from toolkit.synthetic import RenderedShot, benchmark_scene, render_shot

HEAD = (
    "kind      R  backgrounds  shots    axis R  path R  speed %  direction deg  along R  across R"
    "   within 1.96 sigma: x y z vx vy vz speed"
)


@dataclass(frozen=True, kw_only=True)
class Errors:
    """How far one measurement is from the truth; lengths in ball radii."""

    axis: float
    path: float
    speed: float
    direction_deg: float
    along: float
    across: float
    sigmas: tuple[float, ...]


def mean_background(shot: RenderedShot, count: int, seed: int) -> LinearImage:
    """Average `count` pictures of the background, each with noise of its own."""
    pictures = [shot.with_noise(seed + i).background.rgb for i in range(count)]
    return replace(shot.background, rgb=torch.stack(pictures).mean(0), frames=count)


def run(shot: RenderedShot, background: LinearImage, stage: str) -> Measurement:
    """Measure a rendered shot as a user would, the ball's colour given."""
    scene = shot.scene
    return measure(
        shot.image,
        background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=Uniform(colour=scene.appearance.colour),
        stage=stage,
    )


def compare(shot: RenderedShot, result: Measurement) -> Errors:
    """Compare a measurement with the truth, on the branch of the sign nearer to it."""
    scene, radius = shot.scene, shot.scene.ball_radius
    truth, velocity = shot.position.numpy(), shot.velocity.numpy()
    found = np.array(result.velocity_m_s)
    sign = math.copysign(1.0, found @ velocity)
    error, speed = np.array(result.position_m) - truth, np.linalg.norm(velocity)
    ray = truth / np.linalg.norm(truth)
    time = torch.linspace(0, scene.exposure, 2001, dtype=torch.float64)
    path = np.array(result.trajectory.position_m)
    gaps = np.linalg.norm(path[:, None] - scene.path.position(time).numpy()[None], axis=-1)
    true_speed = np.linalg.norm(scene.path.velocity(time).numpy(), axis=-1)[gaps.argmin(1)]
    path_speed = np.linalg.norm(np.array(result.trajectory.velocity_m_s), axis=-1)
    state_std = np.sqrt(np.diag(np.array(result.state_covariance)))
    state_error = np.concatenate([error, sign * found - velocity])
    cosine = sign * (found @ velocity) / np.linalg.norm(found) / speed
    return Errors(
        axis=float(np.median(gaps.min(1))) / radius,
        path=float(np.sqrt((gaps.min(1) ** 2).mean())) / radius,
        speed=float(np.sqrt(((path_speed / true_speed - 1) ** 2).mean())),
        direction_deg=math.degrees(math.acos(min(1.0, cosine))),
        along=abs(float(error @ ray)) / radius,
        across=float(np.linalg.norm(error - (error @ ray) * ray)) / radius,
        sigmas=(*(state_error / state_std), (result.speed_m_s - speed) / result.speed_std_m_s),
    )


def draw_shot(kind: str, distance: float, seed: int) -> RenderedShot:
    """Render the seed's shot of a kind."""
    generator = np.random.default_rng([seed, 7])
    is_curved = kind == "curved"
    scene = benchmark_scene(
        width_px=generator.uniform(60 if is_curved else 40, 110),
        length_widths=generator.uniform(4 if is_curved else 3, 7),
        distance_R=distance,
        tilt=math.radians(generator.uniform(-30, 30)),
        sagitta_widths=generator.uniform(0.4, 1.1) if is_curved else 0.0,
        seed=seed,
    )
    return render_shot(scene, seed=seed)


def print_row(
    kind: str, distance: float, backgrounds: int, shots: int, seed: int, stage: str
) -> None:
    """Measure all shots of a row and print their medians."""
    errors = []
    for index in range(shots):
        shot = draw_shot(kind, distance, seed * 1000 + index)
        try:
            result = run(shot, mean_background(shot, backgrounds, seed * 1000 + index), stage)
        except StreakError as refusal:
            print("refused:", refusal)
            continue
        errors.append(compare(shot, result))
    names = ("axis", "path", "speed", "direction_deg", "along", "across")
    medians = {name: float(np.median([getattr(e, name) for e in errors])) for name in names}
    within = (np.abs([e.sigmas for e in errors]) < 1.96).mean(0)
    print(
        f"{kind:8}{distance:4.0f}{backgrounds:10}{len(errors):7}/{shots:<5}"
        f"{medians['axis']:9.3f}{medians['path']:8.3f}{100 * medians['speed']:9.2f}"
        f"{medians['direction_deg']:13.2f}{medians['along']:10.3f}{medians['across']:10.3f}   "
        + " ".join(f"{share:.2f}" for share in within),
        flush=True,
    )


def main() -> None:
    """Print one row for each kind, distance and number of background pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stage", default="sweep", choices=["contours", "sweep"])
    parser.add_argument("--kind", nargs="+", default=["straight", "curved"])
    parser.add_argument("--distance", type=float, nargs="+", default=[50.0, 15.0])
    parser.add_argument("--backgrounds", type=int, nargs="+", default=[1, 8])
    arguments = parser.parse_args()
    print(HEAD)
    for kind in arguments.kind:
        for distance in arguments.distance:
            for backgrounds in arguments.backgrounds:
                print_row(
                    kind, distance, backgrounds, arguments.shots, arguments.seed, arguments.stage
                )


if __name__ == "__main__":
    main()
