"""A ball known from a sharp picture: shaded, shiny, or lit by lamps of several colours."""

import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from torch import Tensor

from plugins.ball_light import BallLight, picture_noise
from plugins.chord_means import ChordMeans
from plugins.loose_light import LooseLight, light_errors
from toolkit import (
    AlphaEstimator,
    Camera,
    Chord,
    ConfigError,
    LinearImage,
    NoiseModel,
    Observation,
    SharpBall,
    observe_colours,
)

DRAWS = 8
"""Of a sharp picture's noise, which tell what it does to the answer."""
LEAST_NOISE = 5e-4
"""Standard deviation of a node, shares of white, below which it does nothing."""


@dataclass(frozen=True, kw_only=True)
class KnownShading(AlphaEstimator):
    """The ball is lit as in a sharp picture, wherever it is: nothing on it turns with it.

    What a pixel of the streak sees is the mean of the surface's light along the half circle that
    its ray draws on the ball. Seen along another ray than in the sharp picture, the disc shows
    another part of the ball: this is followed exactly for a matt one, and what the sharp picture
    does not show is continued smoothly.
    Source: Caglioti & Giusti 2007, section 3.2.2. Deviations: the composited colours are fitted,
    not alpha; the view may turn.
    """

    ball: SharpBall
    """The ball seen sharply, in the light it moved in: --ball-image F, or --ball F."""
    camera: Camera | None = field(default=None, init=False, repr=False)
    """Of the shot, and of the sharp picture too; `seen_through`."""

    def __post_init__(self) -> None:
        if not isinstance(self.ball, SharpBall):
            raise ConfigError(
                f"the ball is given as {type(self.ball).__name__}, not seen sharply; give "
                "--ball-image, or --ball with the file that `toolkit ball` wrote"
            )
        rgb = self.ball.rgb
        if rgb.ndim != 3 or len(rgb) != 3 or rgb.shape[1] != rgb.shape[2] or rgb.shape[1] < 2:
            raise ConfigError(
                f"the sharp ball has colours of shape {tuple(rgb.shape)}, not [3, N, N]; "
                "make its file again with `toolkit ball`"
            )
        if not rgb.is_floating_point() or not bool(torch.isfinite(rgb).all()):
            raise ConfigError(
                "the sharp ball has colours that are no finite numbers; "
                "make its file again with `toolkit ball`"
            )

    def seen_through(self, camera: Camera) -> "KnownShading":
        """Give the estimator that knows how the camera's view of the ball turns along the path."""
        seen = copy.copy(self)
        seen.__dict__.pop("chords", None)
        object.__setattr__(seen, "camera", camera)
        return seen

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Hand on the colours as they are; behind a mosaic, those measured and no others."""
        return observe_colours(image, background, noise)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the mean colour along each chord, or along the part between start and stop."""
        if chord.ray is None and _is_whole(chord):
            return self.chords.whole(chord)[0]
        return self.chords.part(chord)

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Give the same and its derivative in the chord's offset."""
        if chord.ray is None and _is_whole(chord):
            return self.chords.whole(chord)
        return super().foreground_and_slope(chord, appearance)

    def other_lights(self) -> tuple["KnownShading", ...]:
        """Give the ball in light that its sharp picture allows for; none where it has no noise.

        None where the errors of its light are known one by one: they are found with the motion.
        """
        if self.ball.others is not None:
            return ()
        std = torch.tensor(picture_noise(self.ball))[:, None, None]
        if float(std.max()) < LEAST_NOISE:
            return ()
        generator, rgb = torch.Generator().manual_seed(0), self.ball.rgb
        return tuple(
            self._with(rgb + std * torch.randn(rgb.shape, generator=generator))
            for _ in range(DRAWS)
        )

    def loosened(self) -> LooseLight | None:
        """Give the ball whose light may be off as the sharp picture allows for, where it tells."""
        if self.ball.others is None or not len(self.ball.others):
            return None
        return LooseLight.of(self, self.ball, self.camera)

    def relit(self, amounts: Tensor) -> "KnownShading":
        """Give the ball whose light is off by standard deviations of each error [E]."""
        change = torch.einsum("ecyx,e->cyx", light_errors(self.ball), amounts.float())
        return self._with(self.ball.rgb + change)

    def doubts(self) -> dict[str, str]:
        """Say that the rim's light is less sure where the sharp picture has more than the ball."""
        if self.ball.others is not None or self._noise() < LEAST_NOISE:
            return {}
        return {
            "rim-light-doubted": "the sharp picture shows no smoothly shaded ball alone (a pattern "
            "on it, a shadow or another thing beside it), so that the light of its rim is less "
            "sure than the stated uncertainties take it to be; show it alone, without its shadow"
        }

    def _noise(self) -> float:
        return max(picture_noise(self.ball))

    def _with(self, rgb: Tensor) -> "KnownShading":
        # its own light, whatever it was drawn from, is known
        nothing = torch.zeros(0, *rgb.shape)
        other = KnownShading(ball=replace(self.ball, rgb=rgb, others=nothing))
        return other if self.camera is None else other.seen_through(self.camera)

    @cached_property
    def chords(self) -> ChordMeans:
        """Means along all chords; the ball's light is laid out at first need."""
        light = BallLight.of(self.ball, self.camera)
        return ChordMeans(light=light, camera=self.camera, disc=self.ball.disc)


def _is_whole(chord: Chord) -> bool:
    if isinstance(chord.start, Tensor) or isinstance(chord.stop, Tensor):
        return False
    return chord.start == -1 and chord.stop == 1
