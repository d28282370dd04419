"""Hide 3 blurred photos among 20 of a board, and count how many are found and how many good lost.

    python benchmarks/blurred_boards.py --sets 10

Boards are rendered at 800x600 with a lens blur from 0.5 to 1 px, noise of 1 % and JPEG. Of each set
3 views are blurred in light: out of focus (a Gaussian of 1.8 to 4 px) or moved (6 to 14 px).
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.corners import find_boards
from toolkit.camera import Camera
from toolkit.synthetic.boards import board_poses, render_board
from toolkit.synthetic.noise import NoiseLevel

VIEWS, BLURRED = 20, 3
BOARD, SQUARE, NOISE = (9, 6), 0.03, 0.01
CAMERA = Camera(
    width=800,
    height=600,
    fx=700.0,
    fy=698.0,
    cx=405.0,
    cy=297.0,
    distortion=(-0.2, 0.06, 5e-4, -3e-4),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    settings = parser.parse_args()
    totals = np.zeros(4, dtype=int)
    for number in range(settings.sets):
        counts = one_set(settings.seed + number)
        totals += counts
        print("set {}: {} of {} blurred found, {} of {} good lost".format(number, *counts))
    print("all: {} of {} blurred found, {} of {} good lost".format(*totals))


def one_set(seed: int) -> NDArray[np.int64]:
    """Blurred photos found, of how many; good photos lost, of how many."""
    generator = np.random.default_rng([seed, 77])
    blurred = set(generator.choice(VIEWS, BLURRED, replace=False).tolist())
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{i:02}.jpg" for i in range(VIEWS)]
        poses = board_poses(VIEWS, CAMERA, BOARD, SQUARE, seed=seed)
        for index, (path, pose) in enumerate(zip(paths, poses, strict=True)):
            shot = render_board(
                CAMERA,
                BOARD,
                SQUARE,
                pose,
                noise=NoiseLevel(read=0.0),
                blur_px=generator.uniform(0.5, 1.0),
                seed=100 * seed + index,
            )
            light = shot.image.rgb[0].mean(0).numpy()
            if index in blurred:
                light = spoilt(light, generator)
            light = light + generator.normal(0, NOISE, light.shape)
            coded = 255 * np.clip(light, 0, 1) ** (1 / 2.2)
            cv2.imwrite(str(path), np.rint(coded).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 92])
        views = find_boards(paths)
    for index, view in enumerate(views):
        if view.is_used == (index in blurred):
            print(f"   {index}: {view.edge_px} {view.reason or 'kept though blurred'}")
    found = sum(not views[index].is_used for index in blurred)
    lost = sum(not view.is_used for index, view in enumerate(views) if index not in blurred)
    return np.array([found, BLURRED, lost, VIEWS - BLURRED])


def spoilt(light: NDArray[np.float32], generator: np.random.Generator) -> NDArray[np.float32]:
    """Light out of focus, or smeared by motion in any direction."""
    if generator.random() < 0.5:
        return np.asarray(cv2.GaussianBlur(light, (0, 0), generator.uniform(1.8, 4.0)))
    length, angle = generator.uniform(6, 14), generator.uniform(0, np.pi)
    size = 2 * int(length / 2 + 2) + 1
    kernel = np.zeros((size, size), dtype=np.float32)
    for step in np.linspace(-length / 2, length / 2, 400):
        x, y = size // 2 + step * np.cos(angle), size // 2 + step * np.sin(angle)
        left, top = int(x), int(y)
        shares = np.outer([1 - (y - top), y - top], [1 - (x - left), x - left])
        kernel[top : top + 2, left : left + 2] += shares
    return np.asarray(cv2.filter2D(light, -1, kernel / kernel.sum()))


if __name__ == "__main__":
    main()
