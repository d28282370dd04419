"""What a ball looks like: the light each point of its surface sends to the camera.

An appearance is any callable (normal [N, 3] outward unit, time s) -> rgb [N, 3] in linear light.
Patterns of pigments (`PlainBall`, `StripedBall`, `PanelledBall`) are appearances under even light;
`LitBall` puts one of them before a lamp. Patterns turn with the ball, the light stays.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.errors import ConfigError
from toolkit.synthetic.backgrounds import Colour
from toolkit.synthetic.paths import Vector, turned

Appearance = Callable[[Tensor, float], Tensor]

WHITE: Colour = (1.0, 1.0, 1.0)
GOLDEN = (1 + math.sqrt(5)) / 2
PENTAGON_PLANE, HEXAGON_PLANE = 2.32744, 2.26728
"""Distances of a football's faces from its centre, in edges: a truncated icosahedron."""
DISC_GRID, INSTANTS = 65, 400
"""Places across the disc and instants of an exposure whose light is averaged."""


@dataclass(frozen=True, kw_only=True)
class PlainBall:
    """One colour all over."""

    colour: Colour

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the colour at each normal, [N, 3]."""
        return torch.tensor(self.colour, dtype=normal.dtype).expand(len(normal), 3)


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
        pole = _turned_back(normal, self.spin, time) @ _unit(self.pole, normal)
        latitude = torch.acos(pole.clamp(-1, 1))
        is_second = (latitude * (self.stripes / math.pi)).floor() % 2 == 1
        return _either(self.colours, is_second, normal)


@dataclass(frozen=True, kw_only=True)
class PanelledBall:
    """A football: twelve pentagons of the second pigment among hexagons of the first.

    The pentagons cover 28 % of the ball. It turns with the ball's spin and is evenly lit.
    """

    colours: tuple[Colour, Colour]
    spin: Vector = (0.0, 0.0, 0.0)
    """Angular velocity, rad/s."""

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the pigment at each normal, [N, 3]."""
        body = _turned_back(normal, self.spin, time)
        # a ray from the centre meets the face whose plane it reaches first; faces lie in pairs
        pentagon = (body @ _pentagon_axes(normal).mT).abs().amax(-1) / PENTAGON_PLANE
        hexagon = (body @ _hexagon_axes(normal).mT).abs().amax(-1) / HEXAGON_PLANE
        return _either(self.colours, pentagon > hexagon, normal)


@dataclass(frozen=True, kw_only=True)
class LitBall:
    """A ball of any pigments, matt or glossy, lit by one distant lamp and by the room.

    Under a white lamp a pigment only darkens: all its shades lie on the line through black. A
    coloured lamp in a white room, or a highlight, moves them off that line.
    """

    pattern: Appearance
    light: Vector = (-0.5, -0.7, -0.5)
    """Direction towards the lamp, camera frame, of any length."""
    light_colour: Colour = WHITE
    """Of the lamp; the room's light is white."""
    ambient: float = 0.3
    """Share of the light that comes from everywhere."""
    highlight: float = 0.0
    """Light of the lamp's colour added where the surface mirrors the lamp to the camera."""
    gloss: float = 40.0
    """The larger, the smaller the highlight."""

    def __post_init__(self) -> None:
        if not (0 <= self.ambient <= 1 and self.highlight >= 0 and self.gloss > 0):
            raise ConfigError(
                f"ambient light {self.ambient} must lie in 0..1, highlight {self.highlight} not be"
                f" negative, gloss {self.gloss} be positive"
            )

    def __call__(self, normal: Tensor, time: float) -> Tensor:
        """Give the light at each normal, [N, 3]."""
        light = _unit(self.light, normal)
        lamp = torch.tensor(self.light_colour, dtype=normal.dtype)
        shade = (1 - self.ambient) * torch.outer((normal @ light).clamp_min(0), lamp)
        lit = (self.ambient + shade) * self.pattern(normal, time)
        if self.highlight == 0:
            return lit
        # half-way between lamp and camera; the view is taken along z, as for a distant ball
        halfway = _unit((0.0, 0.0, -1.0), normal) + light
        halfway = torch.nn.functional.normalize(halfway, dim=0)
        shine = self.highlight * (normal @ halfway).clamp_min(0) ** self.gloss
        return lit + torch.outer(shine, lamp)


@dataclass(frozen=True, kw_only=True)
class LambertBall:
    """A `LitBall` of one pigment under white light."""

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
        ball = LitBall(
            pattern=PlainBall(colour=self.colour),
            light=self.light,
            ambient=self.ambient,
            highlight=self.highlight,
            gloss=self.gloss,
        )
        return ball(normal, time)


def pigments(appearance: Appearance) -> tuple[Colour, ...]:
    """Give the colours a ball is painted with; none for an appearance not of this module."""
    match appearance:
        case PlainBall(colour=colour) | LambertBall(colour=colour):
            return (colour,)
        case StripedBall(colours=colours) | PanelledBall(colours=colours):
            return colours
        case LitBall(pattern=pattern):
            return pigments(pattern)
    return ()


def mean_colour(appearance: Appearance, exposure: float, instants: int = INSTANTS) -> Colour:
    """Give a ball's light averaged over its disc and instants of the exposure, s, from far away."""
    side = torch.linspace(-1, 1, DISC_GRID)
    x, y = (axis.flatten() for axis in torch.meshgrid(side, side, indexing="xy"))
    is_inside = x * x + y * y < 1
    x, y = x[is_inside], y[is_inside]
    normal = torch.stack([x, y, -(1 - x * x - y * y).sqrt()], dim=-1)
    times = ((torch.arange(instants) + 0.5) * (exposure / instants)).tolist()
    light = torch.stack([appearance(normal, time).mean(dim=0) for time in times])
    red, green, blue = light.mean(dim=0).tolist()
    return (red, green, blue)


def _either(colours: tuple[Colour, Colour], is_second: Tensor, like: Tensor) -> Tensor:
    """Give the second colour where told and the first elsewhere, [N, 3]."""
    first, second = torch.tensor(colours, dtype=like.dtype)
    return torch.where(is_second[:, None], second, first)


def _turned_back(normal: Tensor, spin: Vector, time: float) -> Tensor:
    """Give camera normals in the frame of a ball that has spun since t = 0, [N, 3]."""
    axis = torch.tensor(spin, dtype=torch.float64)
    angle = (torch.linalg.vector_norm(axis) * time)[None]
    # each row is a body axis as the camera sees it now
    body = torch.cat([turned(e, axis, angle) for e in torch.eye(3, dtype=torch.float64)])
    return normal @ body.mT.to(normal.dtype)


def _pentagon_axes(like: Tensor) -> Tensor:
    """Six axes through opposite vertices of an icosahedron, [6, 3]."""
    axes = _cyclic([(0.0, 1.0, GOLDEN), (0.0, 1.0, -GOLDEN)])
    return torch.nn.functional.normalize(axes, dim=-1).to(like.dtype)


def _hexagon_axes(like: Tensor) -> Tensor:
    """Ten axes through its opposite faces, the vertices of a dodecahedron, [10, 3]."""
    cube = torch.tensor([(1.0, 1.0, s) for s in (1, -1)] + [(1.0, -1.0, s) for s in (1, -1)])
    axes = torch.cat([cube, _cyclic([(0.0, GOLDEN, 1 / GOLDEN), (0.0, GOLDEN, -1 / GOLDEN)])])
    return torch.nn.functional.normalize(axes, dim=-1).to(like.dtype)


def _cyclic(vectors: list[Vector]) -> Tensor:
    """Give the vectors and their cyclic exchanges of axes."""
    rows = torch.tensor(vectors)
    return torch.cat([rows.roll(shift, dims=-1) for shift in range(3)])


def _unit(vector: Vector, like: Tensor) -> Tensor:
    return torch.nn.functional.normalize(torch.tensor(vector, dtype=like.dtype), dim=0)
