"""toolkit simulate: a shot with known truth, ready to be measured."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from toolkit.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from toolkit.synthetic import RenderedBoard, Scene

MAX_BOARDS = 99
MAX_PIXELS = 64_000_000
MIN_SIDE = 100
MAX_READOUT = 10.0
BOARD, SQUARE = (9, 6), 0.025


Preset = Literal["straight", "parabola", "bounce", "circle", "shaded", "striped"]
Format = Literal["dng", "png"]


def simulate(
    out: Annotated[Path, typer.Option(metavar="DIR", help="A new folder, or an older simulation.")],
    preset: Annotated[Preset, typer.Option(help="How the ball moves, or looks.")] = "straight",
    format: Annotated[Format, typer.Option(help="RAW, or linear 16-bit PNG.")] = "dng",
    size: Annotated[str, typer.Option(metavar="WxH", help="Picture size, px.")] = "1500x1000",
    boards: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Write N photos of a checkerboard to calibrate from, and no camera.toml.",
        ),
    ] = 0,
    noise: Annotated[
        float, typer.Option(metavar="SHARE", help="Read noise, share of sensor white.")
    ] = 0.01,
    gain: Annotated[
        float,
        typer.Option(metavar="SHARE", help="Light per electron; adds shot noise sqrt(gain*light)."),
    ] = 0.0,
    readout: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="Rolling shutter: from the start of the first row to that of the last row.",
        ),
    ] = 0.0,
    seed: Annotated[int, typer.Option(metavar="N", help="Draws noise and background.")] = 0,
) -> None:
    """Render a shot with known truth by averaging many sharp images of a ball.

    DIR gets shot, background, rig.toml, camera.toml and truth.json; with a shaded or striped ball
    also ball.toml and a sharp picture of it.
    """
    width, height = parse_size(size)
    if not 0 <= boards <= MAX_BOARDS:
        raise ConfigError(f"--boards is {boards}; a number from 0 to {MAX_BOARDS} is needed")
    if seed < 0:
        raise ConfigError(f"--seed is {seed}; a number from 0 up is needed")
    if not (math.isfinite(noise) and math.isfinite(gain)):
        raise ConfigError(f"--noise {noise} and --gain {gain} must be finite shares of white")
    if not 0 <= readout <= MAX_READOUT:
        raise ConfigError(
            f"--readout is {readout:g} s; a number from 0 to {MAX_READOUT:g} is needed"
        )

    from toolkit.synthetic import (
        NoiseLevel,
        PlainBall,
        preset_scene,
        render_sharp,
        render_shot,
    )
    from toolkit.synthetic.folder import claim_folder, write_shot

    level = NoiseLevel(read=noise, gain=gain)
    claim_folder(out)  # before the work, which would be lost if the folder cannot be used
    scene = preset_scene(preset, size=(width, height), noise=level, seed=seed)
    scene = replace(scene, readout=readout)
    shot = render_shot(scene, seed=seed)
    is_plain = isinstance(scene.appearance, PlainBall)
    sharp = None if is_plain else render_sharp(scene, seed=seed)
    photos = _photos(scene, boards, seed) if boards else None
    write_shot(out, shot, format=format, sharp=sharp, boards=photos, seed=seed)
    typer.echo(_next_step(out, format, boards))


def parse_size(text: str) -> tuple[int, int]:
    """Read WIDTHxHEIGHT in px.

    Raises:
        ConfigError: when it is none, or of a size that cannot be rendered.
    """
    found = re.fullmatch(r"(\d{1,6})x(\d{1,6})", text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if min(width, height) < MIN_SIDE or width * height > MAX_PIXELS:
        raise ConfigError(
            f"--size is {text}; WIDTHxHEIGHT is needed, sides from {MIN_SIDE} px"
            f" and at most {MAX_PIXELS} px in all"
        )
    return width, height


def _photos(scene: "Scene", count: int, seed: int) -> "Iterator[RenderedBoard]":
    """Render one board after the other, so that only one is held in memory."""
    from toolkit.synthetic import board_poses, render_board

    poses = board_poses(count, scene.camera, BOARD, SQUARE, seed=seed)
    for number, pose in enumerate(poses):
        own_seed = (MAX_BOARDS + 1) * (seed + 1) + number
        yield render_board(scene.camera, BOARD, SQUARE, pose, noise=scene.noise, seed=own_seed)


def _next_step(out: Path, format: Format, boards: int) -> str:
    measure = f"toolkit measure {out}/shot.{format}"
    if not boards:
        return f"{out} holds a shot and its truth; next: {measure}"
    calibrate = f"toolkit calibrate --images {out}/boards/*.{format} --out {out}/camera.toml"
    return f"{out} holds a shot, its truth and {boards} boards; next: {calibrate} && {measure}"
