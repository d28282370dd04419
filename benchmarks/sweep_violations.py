"""What becomes of a measurement where one thing is not as the model takes it to be.

Each violation is tried alone, on the shots of `sweep_scenes`, measured with the ball's colour
unknown:

- text: dark print over a tenth of the ball's face, towards the camera; the ball does not turn;
- text, spinning: the same print on a ball that turns 0.5 to 3 times within the exposure;
- defocus: the ball, not the background, is spread over a disc of 1.5 px radius;
- shifted: the background's picture is shifted by 0.3 px;
- brighter: the background's picture is 3 % brighter;
- jpeg: both pictures went through an 8-bit sRGB JPEG of quality 90, colours at half resolution;
- gamma: both were decoded with an exponent that is 5 % too large;
- holes: a ball with holes over 15 to 25 % of it, up to 3 turns, lit from one side (`holed_balls`);
- holes, known: the same, measured with the mean colour of its plain material in that light.

    python benchmarks/sweep_violations.py [--shots N] [--clean N] [--kind text ...] [--workers 2]

A caution is telling when at most 5 % of clean shots carry it. Columns: shots measured; share of
them whose x, y and z all lie within 3 stated standard deviations; share of them with a telling
caution; share of all shots with either, or refused; how often each caution is given (in brackets on
clean shots).
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import math
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import simplejpeg
import torch
from holed_balls import holed, without_holes
from numpy.typing import NDArray
from sweep_scenes import draw_scene, facts, render
from sweep_score import Row, column, gist, in_processes, load_rows, save_rows, score
from torch import Tensor

from plugins.uniform import Uniform
from toolkit import LinearImage
from toolkit.imaging import read_image
from toolkit.synthetic import RenderedShot, Scene, mean_colour
from toolkit.synthetic.backgrounds import Colour
from toolkit.synthetic.paths import Vector, turned
from toolkit.synthetic.render import expose_sensor

Generator = np.random.Generator
Array = NDArray[np.float32]

TEXT_SHARE, INK = 0.1, 0.25
"""Share of the ball's face that is inked, and the ink's light over the ball's."""
PATCH = math.asin(math.sqrt(3 * TEXT_SHARE))
"""Angle from the middle of the print to its border; a third of what lies within is ink."""
LINES, LETTERS = 8.0, 14.0
"""Of the print, to a ball's radius, down and across."""
OFF_CENTRE, TURNS = math.radians(20), (0.5, 3.0)
"""Of the print that does not turn, from the middle of the face; turns of the one that does."""
DEFOCUS_PX, SHIFT_PX, BRIGHTER, QUALITY, GAMMA = 1.5, 0.3, 1.03, 90, 1.05
FINE = 15
"""Samples along a pixel's side of the disc of defocus."""
WITHIN = 3.0
"""Stated standard deviations."""
FALSE_ALARMS = 0.05
"""Share of clean shots that may carry a telling caution."""


@dataclass(frozen=True, kw_only=True)
class PrintedBall:
    """A ball of one colour with a few lines of dark text on a round patch; it may spin."""

    colour: Colour
    middle: Vector
    """Of the patch at t = 0, unit."""
    spin: Vector = (0.0, 0.0, 0.0)
    """Angular velocity, rad/s."""

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the colour at each normal, [N, 3]."""
        spin = torch.tensor(self.spin, dtype=torch.float64)
        angle = (torch.linalg.vector_norm(spin) * time)[None]
        z = torch.tensor(self.middle, dtype=torch.float64)
        x = torch.nn.functional.normalize(
            torch.linalg.cross(z, torch.tensor([0.3, 1.0, 0.2], dtype=torch.float64)), dim=0
        )
        axes = torch.cat([turned(e, spin, angle) for e in (x, torch.linalg.cross(z, x), z)])
        across, down, facing = (normal @ axes.mT.to(normal.dtype)).unbind(-1)
        in_line = (down * LINES).floor() % 2 == 0
        in_letter = (across * LETTERS + 0.37 * (down * LINES).floor()) % 1 < 2 / 3
        is_ink = in_line & in_letter & (facing > math.cos(PATCH))
        return torch.where(is_ink[:, None], INK, 1.0) * torch.tensor(
            self.colour, dtype=normal.dtype
        )


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """What is measured, and the shot that holds the truth."""

    shot: RenderedShot
    image: LinearImage
    background: LinearImage
    colour: Colour | None = None
    """Of the ball, where it is told."""


Draw = Callable[[Scene, int], RenderedShot]
"""Renders a scene with the noise of a seed."""


def clean(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Leave everything as the model takes it to be."""
    shot = draw(scene, seed)
    return Pictures(shot=shot, image=shot.image, background=shot.background)


def text(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Print on the face that the ball shows."""
    generator = np.random.default_rng([seed, 33])
    centre = scene.path.position(torch.tensor([scene.exposure / 2]))[0].numpy()
    facing = -centre / np.linalg.norm(centre)
    across = np.cross(facing, _direction(generator))
    off = math.tan(OFF_CENTRE * math.sqrt(generator.uniform()))
    middle = facing + off * across / np.linalg.norm(across)
    x, y, z = (middle / np.linalg.norm(middle)).tolist()
    colour = scene.appearance.colour
    return clean(
        replace(scene, appearance=PrintedBall(colour=colour, middle=(x, y, z))), seed, draw
    )


def text_spinning(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Print anywhere on the ball, and spin it."""
    generator = np.random.default_rng([seed, 34])
    rate = math.tau * generator.uniform(*TURNS) / scene.exposure
    x, y, z = _direction(generator).tolist()
    u, v, w = (rate * _direction(generator)).tolist()
    ball = PrintedBall(colour=scene.appearance.colour, middle=(x, y, z), spin=(u, v, w))
    return clean(replace(scene, appearance=ball), seed, draw)


def defocus(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Spread what the ball adds to the background over a disc."""
    shot = draw(scene, seed)
    ball = (shot.clean_image - shot.clean_background).numpy()
    spread = np.stack([cv2.filter2D(channel, -1, _disc(DEFOCUS_PX)) for channel in ball])
    light = shot.clean_background + torch.from_numpy(spread)
    return clean(scene, seed, lambda *_: _exposed(shot, light, shot.clean_background, seed))


def shifted(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Take the background's picture from a camera turned a little."""
    shot = draw(scene, seed)
    angle = np.random.default_rng([seed, 35]).uniform(0, math.tau)
    shift = SHIFT_PX * np.array([[math.cos(angle)], [math.sin(angle)]])
    moved = [
        cv2.warpAffine(
            channel,
            np.hstack([np.eye(2), shift]),
            channel.shape[::-1],
            flags=cv2.INTER_LANCZOS4,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for channel in shot.clean_background.numpy()
    ]
    ground = torch.from_numpy(np.stack(moved))
    return clean(scene, seed, lambda *_: _exposed(shot, shot.clean_image, ground, seed))


def brighter(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Take the background's picture in brighter light."""
    shot = draw(scene, seed)
    ground = BRIGHTER * shot.clean_background
    return clean(scene, seed, lambda *_: _exposed(shot, shot.clean_image, ground, seed))


def jpeg(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Store both pictures as a compact camera does, and read them as a user would."""
    shot = draw(scene, seed)
    return Pictures(shot=shot, image=_stored(shot.image), background=_stored(shot.background))


def gamma(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Decode both pictures with a wrong exponent."""
    shot = draw(scene, seed)
    image, background = (
        replace(picture, rgb=picture.rgb.clamp_min(0) ** GAMMA)
        for picture in (shot.image, shot.background)
    )
    return Pictures(shot=shot, image=image, background=background)


def holes(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Pierce the ball, spin it and light it from one side."""
    ball = holed(scene, np.random.default_rng([seed, 36]))
    return clean(replace(scene, appearance=ball), seed, draw)


def holes_known(scene: Scene, seed: int, draw: Draw) -> Pictures:
    """Do the same, and tell the colour of the material."""
    seen = holes(scene, seed, draw)
    plain = without_holes(seen.shot.scene.appearance)
    return replace(seen, colour=mean_colour(plain, scene.exposure, instants=1))


VIOLATIONS: dict[str, Callable[[Scene, int, Draw], Pictures]] = {
    "clean": clean,
    "text": text,
    "text, spinning": text_spinning,
    "defocus": defocus,
    "shifted": shifted,
    "brighter": brighter,
    "jpeg": jpeg,
    "gamma": gamma,
    "holes": holes,
    "holes, known": holes_known,
}


def _direction(generator: Generator) -> NDArray[np.float64]:
    vector = generator.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _disc(radius: float) -> Array:
    """Shares of a disc's light that fall on the pixels about its middle."""
    reach = math.ceil(radius)
    line = (np.arange((2 * reach + 1) * FINE) + 0.5) / FINE - reach - 0.5
    inside = (line[:, None] ** 2 + line**2 <= radius**2).astype(np.float32)
    cells = inside.reshape(2 * reach + 1, FINE, 2 * reach + 1, FINE).sum(axis=(1, 3))
    return np.asarray(cells / cells.sum(), dtype=np.float32)


def _exposed(shot: RenderedShot, image: Tensor, background: Tensor, seed: int) -> RenderedShot:
    return expose_sensor(shot.scene, shot.alpha, image, background, seed)


def _stored(picture: LinearImage) -> LinearImage:
    """Write a picture as JPEG and read it again."""
    light = picture.rgb[0].clamp(0, 1).numpy()
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    stored = np.rint(255 * np.moveaxis(srgb, 0, -1)).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.jpg"
        path.write_bytes(
            simplejpeg.encode_jpeg(
                np.ascontiguousarray(stored), quality=QUALITY, colorsubsampling="420"
            )
        )
        return read_image(path, response="srgb")


def run_shot(seed: int, *, name: str, cache: Path | None) -> Row:
    """Render, spoil and measure the seed's shot."""
    seen = VIOLATIONS[name](draw_scene(seed), seed, partial(render, cache=cache))
    row = {"violation": name, "seed": seed, **facts(seen.shot)}
    estimator = Uniform(colour=seen.colour)
    return row | score(seen.shot, estimator, image=seen.image, background=seen.background)


def report(rows: list[Row]) -> str:
    """Sum up each violation, and say which cautions are telling."""
    by_name = {name: [row for row in rows if row["violation"] == name] for name in VIOLATIONS}
    usual = _rates(by_name["clean"])
    telling = {code for row in rows for code in row.get("cautions", ()) if _is_rare(usual, code)}
    lines = [f"{'':16}measured  within 3 sigma  told  either  cautions (share; on clean shots)"]
    for name, own in by_name.items():
        if own:
            lines.append(_line(name, own, telling, usual))
    refused = Counter(
        f"{row['violation']}: {gist(row['refused'])}" for row in rows if row["refused"]
    )
    lines += [f"refused {count:4} x {reason}" for reason, count in refused.most_common()]
    return "\n".join(lines)


def _is_rare(usual: dict[str, float], code: str) -> bool:
    return usual.get(code, 0.0) <= FALSE_ALARMS


def _rates(rows: list[Row]) -> dict[str, float]:
    """Share of the measured shots that carry each caution."""
    measured = [row for row in rows if row["refused"] is None]
    counts = Counter(code for row in measured for code in row["cautions"])
    return {code: count / len(measured) for code, count in counts.most_common()}


def _line(name: str, rows: list[Row], telling: set[str], usual: dict[str, float]) -> str:
    measured = [row for row in rows if row["refused"] is None]
    if not measured:
        return f"{name:16}{0:4}/{len(rows):<4}"
    sigmas = np.abs(column(measured, "error")[:, :3] / column(measured, "std")[:, :3])
    within = (sigmas < WITHIN).all(axis=1)
    told = np.array([bool(telling & set(row["cautions"])) for row in measured])
    either = (int((within | told).sum()) + len(rows) - len(measured)) / len(rows)
    cautions = ", ".join(
        f"{code} {share:.2f} ({usual.get(code, 0.0):.2f})" for code, share in _rates(rows).items()
    )
    return (
        f"{name:16}{len(measured):4}/{len(rows):<4}{within.mean():13.2f}{told.mean():8.2f}"
        f"{either:8.2f}  {cautions}"
    )


def main() -> None:
    """Run the clean shots and those of each violation."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=50)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1, help="of the run: shots are SEED00000 on")
    parser.add_argument("--kind", nargs="+", choices=list(VIOLATIONS), default=list(VIOLATIONS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--cache", type=Path, help="folder that keeps what was rendered")
    parser.add_argument("--save", type=Path, help="file for one row of JSON a shot")
    parser.add_argument("--load", type=Path, help="sum up rows saved before instead")
    arguments = parser.parse_args()
    rows: list[Row] = load_rows(arguments.load) if arguments.load else []
    for name in arguments.kind if not arguments.load else ():
        count = arguments.clean if name == "clean" else arguments.shots
        seeds = range(arguments.seed * 100_000, arguments.seed * 100_000 + count)
        work = partial(run_shot, name=name, cache=arguments.cache)
        rows += in_processes(work, seeds, arguments.workers)
    if arguments.save is not None:
        save_rows(arguments.save, rows)
    print(report(rows))


if __name__ == "__main__":
    main()
