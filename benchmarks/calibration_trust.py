"""Calibrate many rendered sets and tell how often the stated intervals hold the truth.

    python benchmarks/calibration_trust.py --folder /tmp/boards

Three lenses in turn; every photo is rendered (1024 x 768, blur 0.7 px, noise 1 % of white), every
board is bent by 0.5 mm, and its corners are found as in any photo. Rendering takes about a second a
photo; the corners are kept in the folder for the next run. Last, sets whose boards all face the
camera (exact corners with 0.04 px of noise): every one should be refused.
"""

import argparse
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from rendered_boards import (
    BOARD,
    LENSES,
    SQUARE,
    BoardSet,
    bowl,
    load_set,
    pixel_rays,
    seen_corners,
)

from calibration.corners import View
from calibration.intrinsics import Calibration, calibrate_views
from toolkit.errors import CalibrationError
from toolkit.synthetic.boards import BoardPose

Array = NDArray[np.float64]
NAMES = ("fx", "fy", "cx", "cy")
FACING_SETS, FACING_VIEWS = 30, 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One calibrated set against the truth."""

    lens: str
    error: Array  # [4] px of fx fy cx cy
    std: Array  # [4] px
    focal: float  # relative error of fx
    taken: str
    misread: int  # corners found more than a pixel off


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="where corners are kept")
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first set")
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--bend-mm", type=float, default=0.5)
    parser.add_argument("--bootstrap", type=int, default=0)
    words = parser.parse_args()
    rays = {name: pixel_rays(camera) for name, camera in LENSES.items()}
    outcomes: list[Outcome] = []
    for seed in range(words.seed, words.seed + words.sets):
        found = load_set(
            seed, rays, views=words.views, sag=words.bend_mm / 1000, folder=words.folder
        )
        try:
            outcomes.append(judged(found, words.bootstrap))
        except CalibrationError as error:
            print(f"set {seed} ({found.lens}): refused: {error}")
    report(outcomes, words.sets)
    refused = sum(is_refused(facing_set(seed)) for seed in range(FACING_SETS))
    print(f"{refused} of {FACING_SETS} sets that only face the camera were refused")


def judged(found: BoardSet, bootstrap: int) -> Outcome:
    result = calibrate_views(views_of(found), square=SQUARE, bootstrap=bootstrap)
    truth = LENSES[found.lens].parameters.numpy()[:4]
    assert result.camera.covariance is not None
    error = result.camera.parameters.numpy()[:4] - truth
    off = [np.linalg.norm(a - b, axis=1) for a, b in zip(found.corners, found.true, strict=True)]
    return Outcome(
        lens=found.lens,
        error=error,
        std=result.camera.covariance.diagonal()[:4].sqrt().numpy(),
        focal=float(error[0] / truth[0]),
        taken=taken(result),
        misread=int((np.concatenate(off) > 1).sum()),
    )


def facing_set(seed: int) -> BoardSet:
    """Twelve views of a board that is parallel to the sensor to a degree, flat or bent."""
    generator = np.random.default_rng([seed, 23])
    name = list(LENSES)[seed % len(LENSES)]
    camera = LENSES[name]
    shape = bowl(seed, 5e-4) * (seed // len(LENSES) % 2)
    half = SQUARE * (np.array([*BOARD, 1]) - 1) / 2
    seen: list[Array] = []
    while len(seen) < FACING_VIEWS:
        turn = np.append(generator.normal(0, 0.01, 2), generator.uniform(-0.3, 0.3))
        rotation = cv2.Rodrigues(turn)[0]
        depth = generator.uniform(0.4, 1.0) * camera.fx / 1000 + 0.1
        reach = depth * np.array([camera.width / camera.fx, camera.height / camera.fy]) / 4
        middle = np.append(generator.uniform(-reach, reach), depth)
        pose = BoardPose(
            rotation=torch.from_numpy(rotation),
            translation=torch.from_numpy(middle - rotation @ half),
        )
        corners = seen_corners(camera, pose, shape)
        if (corners > 0).all() and (corners < [camera.width - 1, camera.height - 1]).all():
            seen.append(corners + generator.normal(0, 0.04, corners.shape))
    return BoardSet(lens=name, corners=seen, true=seen)


def is_refused(found: BoardSet) -> bool:
    try:
        calibrate_views(views_of(found), square=SQUARE)
    except CalibrationError:
        return True
    return False


def views_of(found: BoardSet) -> list[View]:
    """The corners as views, as finding them in photo files gives them."""
    size = (LENSES[found.lens].width, LENSES[found.lens].height)
    return [
        View(path=Path(f"v{index}.png"), picture_size=size, board=BOARD, corners=corners)
        for index, corners in enumerate(found.corners)
    ]


def taken(result: Calibration) -> str:
    score = next(score for score in result.model_scores if score.is_taken)
    return f"{score.model}, {'bent' if score.is_bent else 'flat'}"


def report(outcomes: list[Outcome], asked: int) -> None:
    print(f"{len(outcomes)} of {asked} sets calibrated")
    groups: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        groups[outcome.lens].append(outcome)
    groups["all"] = outcomes
    head = "".join(f"{name:>8}" for name in NAMES)
    print(f"{'lens':<9}{'sets':>5}{head}   share of 95 % intervals that hold the truth")
    for lens, some in groups.items():
        scaled = np.array([one.error / one.std for one in some])
        held = "".join(f"{100 * share:>7.1f}%" for share in (np.abs(scaled) < 1.96).mean(axis=0))
        rms = " ".join(f"{value:.2f}" for value in np.sqrt((scaled**2).mean(axis=0)))
        worst = 100 * max(abs(one.focal) for one in some)
        print(
            f"{lens:<9}{len(some):>5}{held}   error over std, rms {rms}; fx off by {worst:.3f} %"
            f" at most; {sum(one.misread for one in some)} misread corners"
        )
    for lens, some in groups.items():
        names = sorted({one.taken for one in some})
        counts = ", ".join(f"{name}: {sum(o.taken == name for o in some)}" for name in names)
        print(f"{lens:<9} took {counts}")


if __name__ == "__main__":
    main()
