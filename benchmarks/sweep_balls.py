"""Accuracy of the exact stage on shaded and on patterned balls, against their own bounds.

The shots are those of `sweep_scenes`, their balls painted anew, with a mean colour at least 0.4
from every pixel of the background (norm of three channels):

- shaded: a matt ball of one pigment. A lamp stands within 50 degrees of the camera, 40 % of the
  light comes from the room. `known-shading` is told the light of the ball's disc as it is at
  mid-exposure, exactly;
- shaded, seen: the same ball, but the light is taken from a sharp picture of it, at rest there,
  with noise like that of the shot, as a user would. Beside the bound of a known light, the errors
  are held against two of their own (`sweep_light_bound`), which count what such a picture leaves
  open: that of a smooth shade, which is what `known-shading` knows, and that of the very family of
  these balls, which it does not;
- two lamps, seen: the same with a second lamp elsewhere before the ball, half as strong as the
  first, which a smooth shade with one lamp is not made for: what counts is that positions lie
  within three stated deviations, or that the result says that something is doubtful;
- striped: 2 to 6 stripes of two pigments, evenly lit, turning 2 to 6 times within the exposure;
  `two-colour` is given the pigments. Every pixel of the background lies at least 0.15 from their
  plane;
- lit stripes: the same before the lamp.

The lamp stays while the ball crosses the view, so that its shade shifts on the disc: by up to half
the angle that it crosses ("turn_deg" in the rows saved), by which errors are told apart too.

    python benchmarks/sweep_balls.py [--shots N] [--kind shaded striped] [--workers 2] [--save FILE]
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from sweep_light_bound import LightBound, exact_ball
from sweep_scenes import BALL_COLOUR, CONTRAST, draw_scene, facts, render
from sweep_score import (
    AXES,
    Row,
    column,
    in_processes,
    is_wide,
    over_bound,
    rms,
    save_rows,
    score,
    summary,
)
from torch import Tensor

from plugins.known_shading import KnownShading
from plugins.two_colour import TwoColour
from toolkit import AlphaEstimator, ToolkitError
from toolkit.ball_look import look_at_ball
from toolkit.synthetic import (
    Appearance,
    LitBall,
    PlainBall,
    RenderedShot,
    Scene,
    StripedBall,
    mean_colour,
    pigments,
    render_sharp,
)

Generator = np.random.Generator
Array = NDArray[np.float64]

AMBIENT, LAMP_ANGLE = 0.4, math.radians(50)
SECOND_LAMP = 1 / 3
"""Share of both lamps' light that is the second's."""
TURNS, STRIPES = (2.0, 6.0), (2, 7)
TURN_DEG = (0, 3, 8, 31)
"""Between which shots are told apart by how far the view turns."""
SAFE = 3.0
"""Stated deviations within which a position is to lie where no caution warns."""
INSTANTS = 40
"""Of the exposure, over which a ball's colour is averaged."""
OFF_PLANE, APART = 0.15, math.radians(15)
"""Distance of the background from the pigments' plane, and angle between them, at least."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of ball, and how it is measured."""

    paint: Callable[[Scene, Generator], Appearance]
    know: Callable[[RenderedShot, int], AlphaEstimator]
    has_own_bound: bool = False  # that counts what a sharp picture tells of its light


@dataclass(frozen=True, kw_only=True)
class TwoLamps:
    """A matt ball before two distant lamps, in a room of even light."""

    first: LitBall
    second: LitBall
    share: float = SECOND_LAMP

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the light at each normal, [N, 3]."""
        first, second = self.first(normal, time), self.second(normal, time)
        return first + self.share * (second - first)


def shade(pattern: Appearance, generator: Generator) -> LitBall:
    """Light a ball by a lamp in front of it and by the room."""
    angle, turn = LAMP_ANGLE * math.sqrt(generator.uniform()), generator.uniform(0, math.tau)
    across = math.sin(angle)
    light = (across * math.cos(turn), across * math.sin(turn), -math.cos(angle))
    return LitBall(pattern=pattern, light=light, ambient=AMBIENT)


def two_lamps(scene: Scene, generator: Generator) -> TwoLamps:
    """Paint a ball of one pigment and put it before two lamps."""
    first = lit(one_pigment, scene, generator)
    x, y, z = direction(generator).tolist()
    return TwoLamps(first=first, second=replace(first, light=(x, y, -abs(z))))


def one_pigment(_: Scene, generator: Generator) -> PlainBall:
    """Paint a ball in one colour."""
    red, green, blue = generator.uniform(*BALL_COLOUR, size=3).tolist()
    return PlainBall(colour=(red, green, blue))


def stripes(scene: Scene, generator: Generator) -> StripedBall:
    """Paint stripes in two pigments whose plane the background does not lie in, and spin them."""
    empty = scene.background.double().flatten(1)
    while True:
        first, second = generator.uniform(*BALL_COLOUR, size=(2, 3))
        normal = np.cross(first, second)
        length = float(np.linalg.norm(normal))
        angle = math.asin(min(1.0, length / float(np.linalg.norm(first) * np.linalg.norm(second))))
        off = (torch.from_numpy(normal / length) @ empty).abs().min()
        if angle >= APART and float(off) >= OFF_PLANE:
            break
    (r1, g1, b1), (r2, g2, b2) = first.tolist(), second.tolist()
    x, y, z = direction(generator).tolist()
    rate = math.tau * generator.uniform(*TURNS) / scene.exposure
    u, v, w = (rate * direction(generator)).tolist()
    return StripedBall(
        colours=((r1, g1, b1), (r2, g2, b2)),
        stripes=int(generator.integers(*STRIPES)),
        pole=(x, y, z),
        spin=(u, v, w),
    )


def direction(generator: Generator) -> Array:
    """A direction evenly drawn from all."""
    vector = generator.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def know_exactly(shot: RenderedShot, _: int) -> KnownShading:
    """Tell the light of the disc at mid-exposure, without a picture of it."""
    return KnownShading(ball=exact_ball(shot))


def see_sharply(shot: RenderedShot, seed: int) -> KnownShading:
    """Cut the ball out of a sharp picture of it, with noise like that of the shot."""
    sharp = render_sharp(shot.scene, seed=seed)
    return KnownShading(ball=look_at_ball(sharp.image, shot.background))


def name_pigments(shot: RenderedShot, _: int) -> TwoColour:
    """Tell the ball's two pigments."""
    return TwoColour(colours=pigments(shot.scene.appearance))


def lit(
    pattern: Callable[[Scene, Generator], Appearance], scene: Scene, generator: Generator
) -> LitBall:
    """Paint a ball and put it before a lamp."""
    return shade(pattern(scene, generator), generator)


KINDS = {
    "shaded": Kind(paint=partial(lit, one_pigment), know=know_exactly),
    "shaded, seen": Kind(paint=partial(lit, one_pigment), know=see_sharply, has_own_bound=True),
    "two lamps, seen": Kind(paint=two_lamps, know=see_sharply),
    "striped": Kind(paint=stripes, know=name_pigments),
    "lit stripes": Kind(paint=partial(lit, stripes), know=name_pigments),
}


def paint(kind: Kind, scene: Scene, seed: int) -> Scene:
    """Give the scene with a ball of a kind that stands out from the background."""
    generator = np.random.default_rng([seed, 32])
    while True:
        ball = kind.paint(scene, generator)
        mean = torch.tensor(mean_colour(ball, scene.exposure, INSTANTS))[:, None, None]
        if float((scene.background - mean).norm(dim=0).min()) >= CONTRAST:
            return replace(scene, appearance=ball)


def run_shot(seed: int, *, name: str, cache: Path | None) -> Row:
    """Render and measure the seed's shot of a kind."""
    kind = KINDS[name]
    shot = render(paint(kind, draw_scene(seed), seed), seed, cache)
    row = {"kind": name, "seed": seed, **facts(shot), "turn_deg": turn(shot)}
    try:
        estimator = kind.know(shot, seed)
    except ToolkitError as refusal:
        return row | {"refused": f"sharp picture: {refusal}"}
    row |= score(shot, estimator)
    if not kind.has_own_bound:
        return row
    bound = LightBound(shot, seed)
    own = {
        "smooth_bound": bound.of_smooth_light().tolist(),
        "family_bound": bound.of_known_family().tolist(),
    }
    return row | own


def over_own(rows: list[Row]) -> str:
    """Give the errors over the bounds that count the light, with the standard error of each."""
    rows = [row for row in rows if row["refused"] is None and not is_wide(row)]
    lines = []
    for name in ("smooth", "family"):
        ratio = rms(column(rows, "error") / column(rows, f"{name}_bound"))
        above = np.median(column(rows, f"{name}_bound") / column(rows, "bound"), axis=0)
        error = ratio / math.sqrt(2 * len(rows))
        for text, values in (
            (f"rms error / bound of {name} light", ratio),
            ("  standard error", error),
            ("  that over the known light's", above),
        ):
            lines.append(f"{text:32}" + "".join(f"{value:9.3f}" for value in values))
    return "\n".join(lines)


def turn(shot: RenderedShot) -> float:
    """Half the angle that the ball crosses, degrees."""
    scene = shot.scene
    ends = scene.path.position(torch.tensor([0.0, scene.exposure], dtype=torch.float64))
    first, last = torch.nn.functional.normalize(ends, dim=-1)
    return math.degrees(math.acos(min(1.0, float(first @ last)))) / 2


def by_turn(rows: list[Row]) -> str:
    """Give the errors over their bounds of shots whose view turns little, more and much."""
    lines = [f"{'rms error / bound, by turn':32}" + "".join(f"{axis:>9}" for axis in AXES)]
    for low, high in pairwise(TURN_DEG):
        own = [r for r in rows if r["refused"] is None and low <= r["turn_deg"] < high]
        if own:
            values = "".join(f"{value:9.3f}" for value in rms(over_bound(own)))
            lines.append(f"{f'{low} to {high} degrees, {len(own)} shots':32}{values}")
    return "\n".join(lines)


def safe(rows: list[Row]) -> str:
    """Say how often positions lie within three stated deviations, or a caution warns."""
    rows = [row for row in rows if row["refused"] is None]
    errors = np.abs(column(rows, "error") / column(rows, "std"))[:, :3]
    is_near = (errors < SAFE).all(axis=1)
    is_warned = np.array([bool(row["cautions"]) for row in rows])
    return (
        f"{len(rows)} measured: position within {SAFE:.0f} stated deviations in "
        f"{is_near.mean():.3f}, or a caution in {(is_near | is_warned).mean():.3f}; "
        f"a caution on {is_warned.mean():.3f}"
    )


def main() -> None:
    """Print a summary of each kind."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1, help="of the run: shots are SEED00000 on")
    parser.add_argument("--kind", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--cache", type=Path, help="folder that keeps what was rendered")
    parser.add_argument("--save", type=Path, help="file for one row of JSON a shot")
    arguments = parser.parse_args()
    seeds = range(arguments.seed * 100_000, arguments.seed * 100_000 + arguments.shots)
    everything: list[Row] = []
    for name in arguments.kind:
        work = partial(run_shot, name=name, cache=arguments.cache)
        rows = list(in_processes(work, seeds, arguments.workers))
        everything += rows
        print(f"--- {name}\n{summary(rows)}\n{by_turn(rows)}\n{safe(rows)}\n", flush=True)
        if KINDS[name].has_own_bound:
            print(over_own(rows), flush=True)
    if arguments.save is not None:
        save_rows(arguments.save, everything)


if __name__ == "__main__":
    main()
