"""Balls of one material with holes all over, turning, lit from one side: floorballs, say."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.synthetic import LitBall, PlainBall, Scene
from toolkit.synthetic.backgrounds import Colour
from toolkit.synthetic.paths import Vector, turned

Generator = np.random.Generator

HOLES = 26
"""Spread evenly over the ball, as a floorball's are."""
SHARE, HOLE_LIGHT = (0.15, 0.25), (0.05, 0.35)
"""Of the ball that is holes, and of the material's light that comes out of one."""
TURNS = 3.0
"""At most, within the exposure."""
DARKER, ASIDE = (0.3, 0.5), (math.radians(40), math.radians(100))
"""Share of the light that the lamp does not give its far side, and its angle to the viewer."""
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True, kw_only=True)
class HoledBall:
    """One colour with round dark holes, the same distance apart; it may spin."""

    colour: Colour
    share: float
    """Of the surface that is holes."""
    hole_light: float
    """Light out of a hole over that of the material."""
    pole: Vector
    """Of the spiral on which the holes lie at t = 0, unit."""
    spin: Vector = (0.0, 0.0, 0.0)
    """Angular velocity, rad/s."""

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the colour at each normal, [N, 3]."""
        spin = torch.tensor(self.spin, dtype=torch.float64)
        angle = (torch.linalg.vector_norm(spin) * time)[None]
        axes = torch.cat([turned(e, spin, angle) for e in _axes_about(self.pole)])
        body = normal @ axes.mT.to(normal.dtype)
        nearest = (body @ _spiral().mT.to(normal.dtype)).amax(-1)
        is_hole = nearest > 1 - 2 * self.share / HOLES  # a cap of that height has that area
        colour = torch.tensor(self.colour, dtype=normal.dtype)
        return torch.where(is_hole[:, None], self.hole_light, 1.0) * colour


def holed(scene: Scene, generator: Generator) -> LitBall:
    """Make the scene's ball one with holes that spins, before a lamp aside."""
    centre = scene.path.position(torch.tensor([scene.exposure / 2]))[0].numpy()
    view = -centre / np.linalg.norm(centre)
    across = np.cross(view, _direction(generator))
    angle = generator.uniform(*ASIDE)
    lamp = math.cos(angle) * view + math.sin(angle) * across / np.linalg.norm(across)
    rate = math.tau * generator.uniform(0, TURNS) / scene.exposure
    ball = HoledBall(
        colour=scene.appearance.colour,
        share=generator.uniform(*SHARE),
        hole_light=generator.uniform(*HOLE_LIGHT),
        pole=_vector(_direction(generator)),
        spin=_vector(rate * _direction(generator)),
    )
    return LitBall(pattern=ball, light=_vector(lamp), ambient=1 - generator.uniform(*DARKER))


def without_holes(ball: LitBall) -> LitBall:
    """Give the plain material in the same light."""
    return LitBall(
        pattern=PlainBall(colour=ball.pattern.colour), light=ball.light, ambient=ball.ambient
    )


def _spiral() -> Tensor:
    """Give directions evenly spread over a sphere [HOLES, 3]."""
    number = torch.arange(HOLES, dtype=torch.float64)
    z = 1 - (2 * number + 1) / HOLES
    turn, ring = GOLDEN_ANGLE * number, (1 - z * z).sqrt()
    return torch.stack([ring * turn.cos(), ring * turn.sin(), z], dim=-1)


def _axes_about(pole: Vector) -> list[Tensor]:
    z = torch.tensor(pole, dtype=torch.float64)
    aside = torch.tensor([0.3, 1.0, 0.2], dtype=torch.float64)
    x = torch.nn.functional.normalize(torch.linalg.cross(z, aside), dim=0)
    return [x, torch.linalg.cross(z, x), z]


def _direction(generator: Generator) -> NDArray[np.float64]:
    vector = generator.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)
