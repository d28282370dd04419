"""A rendered shot, and all that is true of it, to try an estimator on."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.ball import Disc, SharpBall
from toolkit.shapes import check_shape
from toolkit.synthetic import (
    Appearance,
    LitBall,
    NoiseLevel,
    PlainBall,
    RenderedShot,
    Scene,
    StripedBall,
    add_noise,
    benchmark_scene,
    pigments,
    render_shot,
    textured_background,
)
from toolkit.synthetic.lens import blur_pixels
from toolkit.types import LinearImage, NoiseModel

if TYPE_CHECKING:
    from toolkit.synthetic.backgrounds import Colour

WIDTH, LENGTH_WIDTHS, DISTANCE_R = 40.0, 4.0, 50.0
HEADING = 0.5
"""Radians in the image; no axis of the picture is special to an estimator."""
NOISE = NoiseLevel(read=0.006, gain=3e-4)
"""About 1 % of white in mid-grey, more in the light: a variance must follow the level."""
FRAMES = 16
"""Pictures averaged into the background."""
REPEATS = 6
"""Shots that differ by their noise only."""
SUPERSAMPLING = 3
NO_PLANE = 1e-6
"""Length of the product of two colours of the same hue, as black and white: they span a line."""
CORE = 0.85
"""Half widths from the axis within which opacities are compared: at the rim the lens decides."""
DISC_NODES = 129
SPIN = (0.0, 400.0, 300.0)
"""Radians a second: 1.6 turns within the exposure."""
ORANGE = (0.75, 0.4, 0.1)
RED, YELLOW = (0.8, 0.1, 0.1), (0.8, 0.7, 0.1)
"""Their plane lies far from grey."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A shot of one straight streak with its truth, and what may be known about its ball."""

    shot: RenderedShot
    background: LinearImage  # of FRAMES pictures, averaged
    noise: NoiseModel  # the true one, of one picture
    facts: Mapping[str, object]  # by the names estimators use for their fields

    @property
    def image(self) -> LinearImage:
        """The shot."""
        return self.shot.image

    @cached_property
    def alpha(self) -> Tensor:
        """True opacity behind the lens, [H, W]."""
        sharp = self.shot.alpha[None].numpy()
        blurred = blur_pixels(sharp, self.shot.scene.blur, SUPERSAMPLING)
        return torch.from_numpy(np.asarray(blurred[0], dtype=np.float32))

    @cached_property
    def repeats(self) -> tuple[tuple[LinearImage, LinearImage], ...]:
        """Shots and backgrounds of the same scene, each with noise of its own."""
        return tuple(_expose(self.shot, 1 + number) for number in range(REPEATS))

    @cached_property
    def core(self) -> Tensor:
        """Pixels that whole chords pass over, away from the rim, [H, W] bool."""
        along, across = self._place
        length, half_width = self._length, self._half_width
        is_between = (along > 1.2 * half_width) & (along < length - 1.2 * half_width)
        return is_between & (across.abs() < CORE * half_width)

    @cached_property
    def core_chord(self) -> Chord:
        """The chord that passed over each pixel of the core, [N]."""
        _, across = self._place
        offset = (across / self._half_width)[self.core].float()
        return Chord(offset=offset, direction=torch.full((1,), self._direction))

    @cached_property
    def _ends(self) -> Tensor:
        """The ball's centre in the picture at the exposure's start and end, [2, 2] px."""
        scene = self.shot.scene
        time = torch.tensor([0.0, scene.exposure], dtype=torch.float64)
        return scene.camera.project(scene.path.position(time))

    @property
    def _length(self) -> float:
        return float(torch.linalg.vector_norm(self._ends[1] - self._ends[0]))

    @property
    def _direction(self) -> float:
        x, y = (self._ends[1] - self._ends[0]).tolist()
        return math.atan2(y, x)

    @cached_property
    def _half_width(self) -> float:
        left, right = self.shot.contours()
        middle = len(left) // 2
        normal = torch.tensor([-math.sin(self._direction), math.cos(self._direction)])
        return float(((right - left)[middle] @ normal.to(left.dtype)).abs()) / 2

    @cached_property
    def _place(self) -> tuple[Tensor, Tensor]:
        """Each pixel's place along the axis from its start, and to the right of it, px [H, W]."""
        height, width = self.shot.alpha.shape
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        x, y = x - self._ends[0, 0], y - self._ends[0, 1]
        cos, sin = math.cos(self._direction), math.sin(self._direction)
        return x * cos + y * sin, y * cos - x * sin


def make_sample(
    appearance: Appearance | None = None,
    *,
    background_colour: "Colour" = (0.3, 0.3, 0.3),
    facts: Mapping[str, object] | None = None,
    seed: int = 0,
) -> Sample:
    """Render a sample.

    Args:
        appearance: what the ball looks like; orange all over when None.
        background_colour: mean of the texture behind the ball.
        facts: what else is known about the ball, by field name.
        seed: of texture and noise.

    Example:
        >>> from toolkit.synthetic import PlainBall
        >>> sample = make_sample(PlainBall(colour=(0.9, 0.9, 0.9)))
        >>> sample.facts["colour"]
        (0.9, 0.9, 0.9)
    """
    scene = benchmark_scene(
        width_px=WIDTH,
        length_widths=LENGTH_WIDTHS,
        distance_R=DISTANCE_R,
        heading=HEADING,
        noise=NOISE,
        seed=seed,
    )
    check_shape("background_colour", torch.tensor(background_colour), 3)
    size = scene.camera.width, scene.camera.height
    scene = replace(
        scene,
        appearance=appearance or PlainBall(colour=ORANGE),
        background=textured_background(*size, colour=background_colour, seed=seed),
    )
    shot = render_shot(scene, seed=seed, supersampling=SUPERSAMPLING)
    image, background = _expose(shot, 0)
    return Sample(
        shot=replace(shot, image=image, background=background),
        background=background,
        noise=NoiseModel(
            read_variance=torch.full((1, 3), NOISE.read**2),
            gain=torch.full((1, 3), NOISE.gain),
            density=torch.ones(3),
        ),
        facts={**_facts(scene), **(facts or {})},
    )


def sample_for(
    estimator: type[AlphaEstimator] | AlphaEstimator,
    *,
    colours: tuple["Colour", ...] = (),
    background_colour: "Colour" = (0.3, 0.3, 0.3),
) -> Sample:
    """Render a ball of the kind that an estimator's fields ask for.

    A field `ball` asks for a shaded ball, `colours` or `plane_normal` for one of two pigments that
    spins; any other estimator gets a plain one.

    Args:
        estimator: its class, or one that is made.
        colours: of the ball; the estimator's own, or the toolkit's choice, where none is given.
        background_colour: mean of the texture behind the ball.
    """
    names = estimator.option_names()
    known = colours or _own_colours(estimator)
    appearance: Appearance
    if "ball" in names:
        appearance = LitBall(pattern=PlainBall(colour=(*known, ORANGE)[0]), highlight=0.2)
    elif len(known) > 1 or {"colours", "plane_normal"} & set(names):
        first, second = known if len(known) == 2 else (RED, YELLOW)
        appearance = StripedBall(colours=(first, second), spin=SPIN)
    else:
        appearance = PlainBall(colour=(*known, ORANGE)[0])
    return make_sample(appearance, background_colour=background_colour)


def _own_colours(estimator: type[AlphaEstimator] | AlphaEstimator) -> tuple["Colour", ...]:
    """Give the colours an estimator was made with."""
    if isinstance(estimator, type):
        return ()
    colour = getattr(estimator, "colour", None)
    colours = getattr(estimator, "colours", None) or (() if colour is None else (colour,))
    return tuple(colours)


def _expose(shot: RenderedShot, seed: int) -> tuple[LinearImage, LinearImage]:
    """Give a shot and its averaged background with noise of their own."""
    averaged = NoiseLevel(read=NOISE.read / math.sqrt(FRAMES), gain=NOISE.gain / FRAMES)
    light = add_noise(shot.clean_image, NOISE, seed, 0)[None]
    behind = add_noise(shot.clean_background, averaged, seed, 1)[None]
    image, background = shot.image, shot.background
    return (
        replace(image, rgb=light, clipped=(light >= 1).any(1, keepdim=True)),
        replace(background, rgb=behind, clipped=(behind >= 1).any(1, keepdim=True), frames=FRAMES),
    )


def _facts(scene: Scene) -> dict[str, object]:
    """Say what is known about a ball, by the names that estimators use for their fields."""
    facts: dict[str, object] = {"ball": _seen_sharply(scene)}
    colours = pigments(scene.appearance)
    if colours:
        facts["colours"] = colours
    if len(colours) == 1:
        facts["colour"] = colours[0]
    if len(colours) == 2:
        normal = np.cross(np.array(colours[0]), np.array(colours[1]))
        length = float(np.linalg.norm(normal))
        if length > NO_PLANE:
            facts["plane_normal"] = tuple((normal / length).tolist())
    return facts


def _seen_sharply(scene: Scene) -> SharpBall:
    """Look at a ball at rest, on the camera's axis at the sample's distance."""
    side = torch.linspace(-1, 1, DISC_NODES, dtype=torch.float64)
    y, x = torch.meshgrid(side, side, indexing="ij")
    # nodes beyond the rim show the rim
    scale = 1 / torch.hypot(x, y).clamp_min(1)
    rim = 1 / math.sqrt(DISTANCE_R**2 - 1)
    rays = torch.stack([x * scale * rim, y * scale * rim, torch.ones_like(x)], dim=-1)
    rays = torch.nn.functional.normalize(rays, dim=-1)
    middle = DISTANCE_R * rays[..., 2]
    depth = middle - (middle**2 - DISTANCE_R**2 + 1).clamp_min(0).sqrt()
    normal = depth[..., None] * rays - torch.tensor([0.0, 0.0, DISTANCE_R], dtype=torch.float64)
    light = scene.appearance(normal.reshape(-1, 3), 0.0).reshape(DISC_NODES, DISC_NODES, 3)
    axis = (scene.camera.cx, scene.camera.cy)
    disc = Disc(centre=axis, semi_axes=(WIDTH / 2, WIDTH / 2), angle=0.0, std=0.01)
    return SharpBall(disc=disc, rgb=light.permute(2, 0, 1).float())
