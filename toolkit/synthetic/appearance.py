"""What a ball looks like: the light each point of its surface sends to the camera.

An appearance is any callable (normal [N, 3] outward unit, time s) -> rgb [N, 3] in linear light.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.synthetic.backgrounds import Colour
from toolkit.synthetic.paths import Vector, turned

Appearance = Callable[[Tensor, float], Tensor]


@dataclass(frozen=True, kw_only=True)
class PlainBall:
    """One colour all over."""

    colour: Colour

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the colour at each normal, [N, 3]."""
        return torch.tensor(self.colour, dtype=normal.dtype).expand(len(normal), 3)


@dataclass(frozen=True, kw_only=True)
class LambertBall:
    """A matt ball lit by one distant lamp and by the room, with a highlight if wanted."""

    colour: Colour
    light: Vector = (-0.5, -0.7, -0.5)
    """Direction towards the lamp, camera frame, of any length."""
    ambient: float = 0.3
    """Share of the light that comes from everywhere."""
    highlight: float = 0.0
    """Light added, white, where the surface mirrors the lamp to the camera."""
    gloss: float = 40.0
    """The larger, the smaller the highlight."""

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the light at each normal, [N, 3]."""
        light = _unit(self.light, normal)
        shade = self.ambient + (1 - self.ambient) * (normal @ light).clamp_min(0)
        # half-way between lamp and camera; the view is taken along z, as for a distant ball
        halfway = _unit((0.0, 0.0, -1.0), normal) + light
        halfway = torch.nn.functional.normalize(halfway, dim=0)
        shine = self.highlight * (normal @ halfway).clamp_min(0) ** self.gloss
        colour = torch.tensor(self.colour, dtype=normal.dtype)
        return torch.outer(shade, colour) + shine[:, None]


@dataclass(frozen=True, kw_only=True)
class StripedBall:
    """Two pigments in stripes about an axis, turning with the ball's spin, evenly lit."""

    colours: tuple[Colour, Colour]
    stripes: int = 6
    """Stripes from pole to pole."""
    pole: Vector = (1.0, 0.0, 0.0)
    """The stripes' axis at t = 0, of any length."""
    spin: Vector = (0.0, 0.0, 0.0)
    """Angular velocity, rad/s."""

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the pigment at each normal, [N, 3]."""
        latitude = torch.acos((normal @ self._pole_at(time, normal)).clamp(-1, 1))
        is_second = (latitude * (self.stripes / math.pi)).floor() % 2 == 1
        first, second = torch.tensor(self.colours, dtype=normal.dtype)
        return torch.where(is_second[:, None], second, first)

    def _pole_at(self, time: float, like: Tensor) -> Tensor:
        spin = torch.tensor(self.spin, dtype=like.dtype)
        angle = torch.linalg.vector_norm(spin) * torch.full((1,), time, dtype=like.dtype)
        return turned(_unit(self.pole, like), spin, angle)[0]


def _unit(vector: Vector, like: Tensor) -> Tensor:
    return torch.nn.functional.normalize(torch.tensor(vector, dtype=like.dtype), dim=0)
