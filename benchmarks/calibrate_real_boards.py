"""Calibrate from real photos and print how well the camera is known.

    python benchmarks/calibrate_real_boards.py --data ../shared/data/checkerboard

Each folder holds the photos of one camera.
"""

import argparse
import time
from pathlib import Path

from calibration.intrinsics import Calibration, calibrate

FOLDERS = ("opencv_left", "gopro_wide")
NAMES = ("fx", "fy", "cx", "cy")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the photo folders")
    data = parser.parse_args().data
    head = "".join(f"{name + ' px':>18}" for name in NAMES)
    print(
        f"{'photos':<12}{'board':>6}{'used':>8}{'RMS px':>8}{'held-out':>10}{head}"
        f"{'time s':>8}  lens"
    )
    for folder in FOLDERS:
        images = sorted((data / folder).glob("*.jpg"))
        start = time.perf_counter()
        result = calibrate(images)
        print(row(folder, result, time.perf_counter() - start))


def row(folder: str, result: Calibration, seconds: float) -> str:
    camera = result.camera
    assert camera.covariance is not None
    std = camera.covariance.diagonal().sqrt().tolist()
    numbers = "".join(
        f"{getattr(camera, name):>11.2f} ± {s:.2f}" for name, s in zip(NAMES, std, strict=False)
    )
    board, used = "x".join(map(str, result.board)), f"{len(result.used)}/{len(result.views)}"
    taken = next(score for score in result.model_scores if score.is_taken)
    errors = f"{result.rms_px:>8.3f}{result.held_out_px:>10.3f}"
    lens = f"{taken.model}, {'bent' if taken.is_bent else 'flat'} board"
    return f"{folder:<12}{board:>6}{used:>8}{errors}{numbers}{seconds:>8.1f}  {lens}"


if __name__ == "__main__":
    main()
