"""Accuracy of the measurement on brute-force rendered streaks before a textured background.

The benchmark scene: ball at 50 radii (and 15 beside it), |F - B| >= 0.4, noise 1 % of white in each channel of shot and
background, lens point spread 0.7 px, ball colour given. Straight streaks 40 to 110 px wide and 3 to 7 widths long, tilted up to 30
degrees; curved ones 60 to 110 px wide. Run: python benchmarks/accuracy.py [--shots N] [--seed S] [--kind straight|curved]
"""

import argparse
import math
from dataclasses import dataclass

import numpy as np
import torch

from plugins.uniform import Uniform
from toolkit import StreakError
from toolkit.pipeline import measure
from toolkit.synthetic.render import RenderedShot, render_shot
from toolkit.synthetic.scenes import benchmark_scene


@dataclass(frozen=True, kw_only=True)
class Errors:
    """How far one measurement is from the truth."""

    axis_R: float
    path_R: float
    speed: float
    direction_deg: float
    along_ray_R: float
    across_ray_R: float
    sigmas: tuple[float, ...]


def compare(shot: RenderedShot) -> Errors:
    """Measure a rendered shot and compare it with its truth."""
    scene = shot.scene
    result = measure(
        shot.image,
        shot.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=Uniform(colour=scene.appearance.colour),
    )
    radius = scene.ball_radius
    truth, velocity = shot.position.numpy(), shot.velocity.numpy()
    measured = np.array(result.velocity_m_s)
    sign = math.copysign(1.0, measured @ velocity)
    error = np.array(result.position_m) - truth
    ray = truth / np.linalg.norm(truth)
    along = error @ ray
    time = torch.linspace(0, scene.exposure, 2001, dtype=torch.float64)
    true_path = scene.path.position(time).numpy()
    path = np.array(result.trajectory.position_m)
    gaps = np.linalg.norm(path[:, None] - true_path[None], axis=-1).min(1)
    true_speed = np.linalg.norm(scene.path.velocity(time).numpy(), axis=-1)
    speed = np.linalg.norm(np.array(result.trajectory.velocity_m_s), axis=-1)
    nearest = np.linalg.norm(path[:, None] - true_path[None], axis=-1).argmin(1)
    covariance = np.array(result.state_covariance)
    state_error = np.concatenate([error, sign * measured - velocity])
    sigmas = state_error / np.sqrt(np.diag(covariance))
    cosine = sign * (measured @ velocity) / np.linalg.norm(measured) / np.linalg.norm(velocity)
    return Errors(
        axis_R=float(np.median(gaps)) / radius,
        path_R=float(np.sqrt((gaps**2).mean())) / radius,
        speed=float(np.sqrt(((speed / true_speed[nearest] - 1) ** 2).mean())),
        direction_deg=math.degrees(math.acos(min(1.0, cosine))),
        along_ray_R=abs(along) / radius,
        across_ray_R=float(np.linalg.norm(error - along * ray)) / radius,
        sigmas=(*sigmas, (result.speed_m_s - np.linalg.norm(velocity)) / result.speed_std_m_s),
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


def main() -> None:
    """Print one row a kind and distance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shots", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--kind", choices=("straight", "curved"), nargs="+", default=["straight", "curved"]
    )
    parser.add_argument("--distance", type=float, nargs="+", default=[50.0, 15.0])
    arguments = parser.parse_args()
    print("medians; lengths in ball radii R, speed relative, direction in degrees")
    print(
        f"{'kind':9}{'at':>5}{'shots':>7}{'axis':>8}{'path rms':>10}{'speed %':>9}{'dir':>7}{'along':>8}{'across':>8}"
        "   |error| within 1.96 sigma: x y z vx vy vz speed"
    )
    for kind in arguments.kind:
        for distance in arguments.distance:
            errors, refused = [], 0
            for index in range(arguments.shots):
                shot = draw_shot(kind, distance, arguments.seed * 1000 + index)
                try:
                    errors.append(compare(shot))
                except StreakError as error:
                    refused += 1
                    print("refused:", error)
            names = ("axis_R", "path_R", "speed", "direction_deg", "along_ray_R", "across_ray_R")
            m = {name: float(np.median([getattr(e, name) for e in errors])) for name in names}
            within = (np.abs([e.sigmas for e in errors]) < 1.96).mean(0)
            print(
                f"{kind:9}{distance:4.0f}R{len(errors):4}/{arguments.shots:<3}{m['axis_R']:7.3f}{m['path_R']:10.3f}"
                f"{100 * m['speed']:9.3f}{m['direction_deg']:7.3f}{m['along_ray_R']:8.3f}{m['across_ray_R']:8.3f}   "
                + " ".join(f"{share:.2f}" for share in within)
            )


if __name__ == "__main__":
    main()
