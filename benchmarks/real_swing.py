"""What the exact streak says of a real swing, held against what must be true of it.

    python benchmarks/real_swing.py --data FOLDER [--pairs 24] [--free-colour]

FOLDER holds circle.avi, floorball1.png and floorball_bgr.png, as `real_streaks` takes them; camera
and exposure are assumed as there. The ball of circle.avi is swung on a string about a hand. Of its
frames the 30 listed ones are measured, and neighbours of theirs that were not rejected by eye, with
the colour listed for the streak nearest in the picture, or with --free-colour with none (the light
changes along a streak, too).

1. The way of the ball's centre in the picture while the shutter is open, first to last, mean of two
   frames in a row, over the step between their middles. The shutter stays open nearly the whole
   frame: this must come out just below 1, whatever the camera.
2. One sphere about the hand through the centres of all frames. A focal length f in place of the
   assumed f0 stretches the depths by f / f0 and leaves x and y (the ball is as wide as it is seen),
   so that it is fitted too. The centres lie near one plane, which tells little of the sphere's
   centre across it: the hand's place in the picture, read by eye, holds it. The hand stands still
   in one model, and moves evenly in the other; in truth it wanders.
3. floorball1: how well a plain ball explains one that has holes, patch by patch.
"""

import argparse
import os
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray
from real_streaks import BALL_RADIUS, EXPOSURE, LIST
from scipy.optimize import least_squares

from plugins.uniform import Uniform
from toolkit import (
    Camera,
    LinearImage,
    Measurement,
    StreakError,
    measure,
    read_background,
    read_image,
)

Array = NDArray[np.float64]

FOCAL = 600.0  # px, assumed
FOCALS = np.arange(400.0, 1201.0, 10.0)
HAND = np.array([[465.0, 195.0], [512.0, 200.0]])
"""Where the hand is seen in the first and the last frame, px."""
HAND_STD = 15.0  # px, by which it wanders beside an even motion
ROUNDS = 4
"""Of weighing each centre by its standard deviation along the string, which turns with the fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """A sphere fitted to the centres, at one focal length."""

    focal: float  # px
    centre: Array  # [3] m, at the middle of the clip
    radius: float  # m
    residual: Array  # [N] m, distance from the sphere
    sigma: Array  # [N] m, of the distance
    cost: float  # robust, as minus the logarithm of a likelihood


def pairs_of(listed: dict, most: int) -> list[tuple[int, int]]:
    """Frames in a row, one of them listed, none rejected by eye."""
    rejected = {frame for entry in listed["rejected"] for frame in entry["frames"]}
    found = set()
    for frame in (entry["frame"] for entry in listed["streak"]):
        after, before = (frame, frame + 1), (frame - 1, frame)
        found |= {next((p for p in (after, before) if not rejected & {*p}), None)}
    return sorted(found - {None})[:most]


def colour_at(image: LinearImage, background: LinearImage, listed: dict) -> list[float]:
    """Colour listed for the streak nearest to where the picture has become greener."""
    change = (image.rgb - background.rgb)[0].double().numpy()
    greener = np.clip(change[1] - np.maximum(change[0], change[2]) - 0.02, 0, None)
    rows, columns = np.indices(greener.shape)
    place = np.array([(columns * greener).sum(), (rows * greener).sum()]) / greener.sum()
    nearest = min(listed["streak"], key=lambda entry: np.linalg.norm(place - entry["mid"]))
    return listed["light"][nearest["light"]]


def measure_frame(
    frame: int, clip: Path, background: LinearImage, camera: Camera, listed: dict, *, free: bool
) -> Measurement | None:
    """Measure one frame of the clip and print its row."""
    image, since = read_image(clip, response="srgb", frame=frame), time.perf_counter()
    known = [entry["light"] for entry in listed["streak"] if entry["frame"] == frame]
    colour = listed["light"][known[0]] if known else colour_at(image, background, listed)
    try:
        result = measure(
            image,
            background,
            camera=camera,
            ball_radius=BALL_RADIUS,
            exposure=EXPOSURE,
            estimator=Uniform() if free else Uniform(colour=tuple(colour)),
        )
    except StreakError as refusal:
        print(f"frame {frame:3}  refused: {refusal}", flush=True)
        return None
    print(
        f"frame {frame:3}  {result.stage:8}  way {np.linalg.norm(way(result, camera)):5.1f} px  "
        f"depth {result.position_m[2]:.3f} +/- {result.position_std_m[2]:.3f} m  "
        f"chi2 {result.fit.chi2_per_dof:5.1f}  {time.perf_counter() - since:4.1f} s",
        flush=True,
    )
    return result


def seen_at(position: Array, camera: Camera) -> Array:
    """Where the camera sees points [..., 3], px."""
    x, y, z = np.moveaxis(np.asarray(position), -1, 0)
    return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=-1)


def way(result: Measurement, camera: Camera) -> Array:
    """Way of the ball's centre in the picture while the shutter is open, px."""
    first, last = seen_at(np.array(result.trajectory.position_m)[[0, -1]], camera)
    return last - first


def report_steps(
    pairs: list[tuple[int, int]], results: dict[int, Measurement | None], camera: Camera
) -> None:
    """Print the way over the step of each pair, and the median of those fitted exactly."""
    print("\nway while the shutter is open over the step from frame to frame")
    ratios = []
    for pair in pairs:
        both = [results[frame] for frame in pair]
        name = f"{pair[0]:3} to {pair[1]:3}"
        if None in both:
            print(f"  {name}  one refused")
            continue
        stages = [result.stage for result in both]
        ways = [float(np.linalg.norm(way(result, camera))) for result in both]
        first, second = (seen_at(result.position_m, camera) for result in both)
        step = float(np.linalg.norm(second - first))
        ratio = (ways[0] + ways[1]) / 2 / step
        is_exact = stages == ["sweep", "sweep"]
        ratios += [ratio] if is_exact else []
        print(
            f"  {name}  ways {ways[0]:5.1f} {ways[1]:5.1f}  step {step:5.1f} px  ratio {ratio:.3f}"
            + ("" if is_exact else f"  not counted: {', '.join(stages)}")
        )
    low, middle, high = np.percentile(ratios, [10, 50, 90]) if ratios else [np.nan] * 3
    print(
        f"  {len(ratios)} of {len(pairs)} pairs counted: median {middle:.3f}, "
        f"80 % from {low:.3f} to {high:.3f}, {sum(r > 1 for r in ratios)} above 1"
    )


def count_stages(results: dict[int, Measurement | None]) -> None:
    """Print how many frames were measured at which stage."""
    stages = [None if result is None else result.stage for result in results.values()]
    print(
        f"\n{len(stages)} frames: {stages.count('sweep')} by the exact streak, "
        f"{stages.count('contours')} fell back on contours, {stages.count(None)} refused"
    )


def fit_sphere(
    focal: float, position: Array, covariance: Array, moment: Array, *, is_moving: bool
) -> Sphere:
    """Fit a sphere to centres [N, 3], robustly; moment runs from -1 to 1 over the clip."""
    stretch, lens = np.array([1.0, 1.0, focal / FOCAL]), Camera.centred(640, 480, focal)
    points, spread = position * stretch, covariance * np.outer(stretch, stretch)

    def hand(values: Array, moments: Array) -> Array:
        return values[:3] + (moments[:, None] * values[4:7] if is_moving else 0 * moments[:, None])

    def residual(values: Array) -> Array:
        return np.linalg.norm(points - hand(values, moment), axis=1) - values[3]

    def all_residuals(values: Array, sigma: Array) -> Array:
        seen = seen_at(hand(values, np.array([-1.0, 1.0])), lens) - HAND
        blur = np.ptp(HAND[:, 0]) / 2 * (not is_moving) + HAND_STD
        return np.concatenate([residual(values) / sigma, seen.ravel() / blur])

    x, y = (HAND.mean(axis=0) - [lens.cx, lens.cy]) / focal
    depth = float(np.median(points[:, 2]))
    values = np.array([x * depth, y * depth, depth, 0.4, *[0.0] * 3 * is_moving])
    sigma = np.full(len(points), BALL_RADIUS)
    for _ in range(ROUNDS):
        fit = least_squares(all_residuals, values, loss="soft_l1", args=(sigma,))
        values = fit.x
        along = points - hand(values, moment)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        sigma = np.sqrt(np.einsum("ni,nij,nj->n", along, spread, along))
    left = all_residuals(values, sigma)
    return Sphere(
        focal=focal,
        centre=values[:3],
        radius=float(values[3]),
        residual=residual(values),
        sigma=sigma,
        cost=float((np.sqrt(1 + left**2) - 1).sum()),
    )


def report_sphere(results: dict[int, Measurement | None]) -> None:
    """Print the sphere on which the centres of the exact streaks lie, and how well they do."""
    used = {n: r for n, r in results.items() if r is not None and r.stage == "sweep"}
    position = np.array([r.position_m for r in used.values()])
    covariance = np.array([r.state_covariance for r in used.values()])[:, :3, :3]
    moment = np.array(list(used)) / 60.0 - 1
    print(f"\none sphere about the hand through {len(used)} centres")
    for name, is_moving in (("still", False), ("moving evenly", True)):
        spheres = [fit_sphere(f, position, covariance, moment, is_moving=is_moving) for f in FOCALS]
        best = min(spheres, key=lambda sphere: sphere.cost)
        likely = [s.focal for s in spheres if s.cost < best.cost + 0.5]
        assumed = min(spheres, key=lambda sphere: abs(sphere.focal - FOCAL))
        for kind, sphere in (("fitted", best), ("assumed", assumed)):
            print(f"  hand {name}, focal length {kind}: " + describe(sphere))
        print(f"  hand {name}: focal lengths as likely {min(likely):.0f} to {max(likely):.0f} px")


def describe(sphere: Sphere) -> str:
    """Put a sphere and what it leaves in words."""
    left, relative = sphere.residual / BALL_RADIUS, sphere.residual / sphere.sigma
    lens = Camera.centred(640, 480, sphere.focal)
    x, y = seen_at(sphere.centre, lens)
    return (
        f"{sphere.focal:.0f} px, radius {sphere.radius:.3f} m, hand at ({x:.0f}, {y:.0f}) px "
        f"{sphere.centre[2]:.2f} m away; left: rms {np.sqrt(np.mean(left**2)):.2f}, median "
        f"{np.median(np.abs(left)):.2f} ball radii; rms {np.sqrt(np.mean(relative**2)):.1f}, "
        f"median {np.median(np.abs(relative)):.2f} sigma"
    )


def report_still(folder: Path, still: dict) -> None:
    """Print how well a plain ball explains floorball1."""
    camera = Camera.centred(960, 600, 900.0)
    print("\nfloorball1")
    try:
        result = measure(
            read_image(folder / still["image"], response="srgb"),
            read_background([folder / still["background"]], response="srgb"),
            camera=camera,
            ball_radius=BALL_RADIUS,
            exposure=EXPOSURE,
            estimator=Uniform(colour=tuple(still["colour"])),
        )
    except StreakError as refusal:
        print(f"  refused: {refusal}")
        return
    where = " ".join(
        f"{p:.3f}+/-{s:.3f}" for p, s in zip(result.position_m, result.position_std_m, strict=True)
    )
    print(
        f"  stage {result.stage}, chi2 {result.fit.chi2_per_dof:.2f}, position {where} m, "
        f"speed {result.speed_m_s:.2f} +/- {result.speed_std_m_s:.2f} m/s"
    )
    for caution in result.warnings:
        print(f"  {caution.code}: {caution.message}")
    if result.fit.residuals is not None:
        report_patches(result, camera)


def report_patches(result: Measurement, camera: Camera) -> None:
    """Print where the largest residuals lie, along the ball's path and across it."""
    place = np.array(result.fit.residuals.place_px)
    sigma = np.array(result.fit.residuals.sigma)
    first, last = seen_at(np.array(result.trajectory.position_m)[[0, -1]], camera)
    length, middle = float(np.linalg.norm(last - first)), (first + last) / 2
    along = (last - first) / length
    half_width = camera.fx * BALL_RADIUS / result.position_m[2]
    forward = (place - middle) @ along / (length / 2)
    sideways = (place - middle) @ np.array([-along[1], along[0]]) / half_width
    share = np.mean(np.abs(sigma) > 3)
    print(f"  {len(sigma)} patches, {100 * share:.0f} % beyond 3 sigma; the largest:")
    print("    place, px      along (1: last centre)  across (1: rim)  sigma")
    for i in np.argsort(-np.abs(sigma))[:10]:
        x, y = place[i]
        print(
            f"    ({x:4.0f}, {y:4.0f})  {forward[i]:+16.2f}  {sideways[i]:+15.2f}  {sigma[i]:+9.1f}"
        )
    ends, rim = np.abs(forward) > 1, np.abs(sideways) > 0.7
    for name, chosen in (("ends", ends), ("rims", ~ends & rim), ("inside", ~ends & ~rim)):
        beyond = np.mean(np.abs(sigma[chosen]) > 3) if chosen.any() else np.nan
        print(f"    {name:7}{chosen.sum():4} patches, {100 * beyond:3.0f} % beyond 3 sigma")


def main() -> None:
    """Measure the frames and print the three checks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--free-colour", action="store_true")
    arguments = parser.parse_args()
    listed = tomllib.loads(LIST.read_text())
    clip, camera = arguments.data / "circle.avi", Camera.centred(640, 480, FOCAL)
    background = read_background([clip], response="srgb")
    pairs = pairs_of(listed, arguments.pairs)
    frames = sorted({frame for pair in pairs for frame in pair})
    results = {
        frame: measure_frame(frame, clip, background, camera, listed, free=arguments.free_colour)
        for frame in frames
    }
    count_stages(results)
    report_steps(pairs, results, camera)
    report_sphere(results)
    report_still(arguments.data, listed["still"][0])


if __name__ == "__main__":
    main()
