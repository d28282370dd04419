"""Contours of real streaks against what the eye sees: a swung floorball and a thrown one.

    python benchmarks/real_streaks.py --data FOLDER [--overlays FOLDER] [--stage sweep]

FOLDER holds circle.avi, floorball1.png and floorball_bgr.png. The 30 frames of circle.avi, the
places of their contours and the ball's colour in each part of the picture were listed by eye before
any measurement (real_streaks.toml says how). The background is the clip's median, both pictures are
decoded as sRGB, the camera is assumed (no distortion, focal length below), the exposure too (the
shutter stays open nearly the whole 1/30 s). Nothing tells where in the picture the streak is.

For each frame: the distances, px, of the points seen by eye from the contour measured, outward
positive, where the measured contour reaches beside them; the eye's points err by 1 to 3 px.
"""

import argparse
import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
from toolkit.report import write_overlay

LIST = Path(__file__).with_name("real_streaks.toml")
EXPOSURE = 1 / 30  # s
BALL_RADIUS = 0.036  # m

Points = NDArray[np.float64]


def outward_distances(points: Points, result: Measurement) -> list[float]:
    """Distance of each point from the contour it is nearest to, where the contour reaches it."""
    sides = [np.array(result.contours.left), np.array(result.contours.right)]
    found = []
    for point in points:
        near, far = sorted(sides, key=lambda side: np.linalg.norm(side - point, axis=1).min())
        index = int(np.linalg.norm(near - point, axis=1).argmin())
        if 0 < index < len(near) - 1:
            tangent = near[index + 1] - near[index - 1]
            normal = np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
            outward = normal * np.sign(normal @ (near[index] - far[index]))
            found.append(float(outward @ (point - near[index])))
    return found


def report(
    name: str,
    entry: dict,
    image: LinearImage,
    background: LinearImage,
    camera: Camera,
    colour,
    stage: str,
) -> tuple[Measurement | None, list[float]]:
    """Measure one listed streak, print its row, give all distances from the eye's points."""
    try:
        result = measure(
            image,
            background,
            camera=camera,
            ball_radius=BALL_RADIUS,
            exposure=EXPOSURE,
            estimator=Uniform(colour=tuple(colour)),
            stage=stage,
        )
    except StreakError as refusal:
        print(f"{name:>10}  refused: {refusal}")
        return None, []
    distances = outward_distances(np.array(entry["across"], float).reshape(-1, 2), result)
    left, right = (np.array(side) for side in (result.contours.left, result.contours.right))
    width = float(np.median(np.linalg.norm(right - left, axis=1)))
    print(
        f"{name:>10}  width {width:4.1f} (eye {entry['width_px']})  "
        f"speed {result.speed_m_s:5.1f} +/- {result.speed_std_m_s:4.1f} m/s  "
        f"points {' '.join(f'{d:+.1f}' for d in distances)}"
    )
    return result, distances


def main() -> None:
    """Measure all listed streaks and count those whose contours agree with the eye."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--overlays", type=Path)
    parser.add_argument("--stage", default="contours", choices=["contours", "sweep"])
    arguments = parser.parse_args()
    listed = tomllib.loads(LIST.read_text())
    clip = arguments.data / "circle.avi"
    background = read_background([clip], response="srgb")
    camera, rows = Camera.centred(640, 480, 600.0), []
    jobs = [
        (
            f"frame {entry['frame']}",
            entry,
            clip,
            entry["frame"],
            background,
            camera,
            listed["light"][entry["light"]],
        )
        for entry in listed["streak"]
    ]
    still = listed["still"][0]
    ground = read_background([arguments.data / still["background"]], response="srgb")
    jobs.append(
        (
            "floorball1",
            still,
            arguments.data / still["image"],
            None,
            ground,
            Camera.centred(960, 600, 900.0),
            still["colour"],
        )
    )
    for name, entry, path, frame, ground, lens, colour in jobs:
        image = read_image(path, response="srgb", frame=frame)
        result, distances = report(name, entry, image, ground, lens, colour, arguments.stage)
        rows.append(distances)
        if result is not None and arguments.overlays is not None:
            arguments.overlays.mkdir(parents=True, exist_ok=True)
            write_overlay(arguments.overlays / f"{name.replace(' ', '_')}.png", image, result)
    seen = [np.abs(row) for row in rows[:-1] if row]
    mean, worst = (np.array([f(row) for row in seen]) for f in (np.mean, np.max))
    print(f"{len(rows) - 1} frames, {len(seen)} measured; frames within 2, 3, 4 px of the eye:")
    for name, values in (("mean of the points", mean), ("every point", worst)):
        print(f"  {name:20}" + "".join(f"{(values <= limit).sum():4}" for limit in (2, 3, 4)))


if __name__ == "__main__":
    main()
