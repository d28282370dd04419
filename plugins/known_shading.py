"""A ball known from a sharp picture: shaded, shiny, or lit by lamps of several colours."""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from plugins.radon_table import RadonTable
from toolkit import (
    AlphaEstimator,
    Chord,
    ConfigError,
    LinearImage,
    NoiseModel,
    Observation,
    SharpBall,
    observe_colours,
)


@dataclass(frozen=True, kw_only=True)
class KnownShading(AlphaEstimator):
    """The ball looks as in a sharp picture, wherever it is: nothing on it turns with it.

    What a pixel of the streak sees is the mean of the disc's colours along the chord that passes
    over it.
    Source: Caglioti & Giusti 2007, section 3.2.2. Deviation: the composited colours are fitted, not
    alpha, and the means come from a table made once for all directions.
    """

    ball: SharpBall
    """The ball seen sharply, in the light it moved in: --ball-image F, or --ball F."""

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

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Hand on the colours as they are; behind a mosaic, those measured and no others."""
        return observe_colours(image, background, noise)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the mean colour along each chord, or along the part between start and stop."""
        if _is_whole(chord):
            return self.foreground_and_slope(chord)[0]
        direction = chord.direction.to(chord.offset)
        return self.table.part(chord.offset, direction, chord.start, chord.stop)

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Give the same and its derivative in the chord's offset, in closed form."""
        direction = chord.direction.to(chord.offset)
        if _is_whole(chord):
            return self.table.whole(chord.offset, direction)
        slope = self.table.slope_of_part(chord.offset, direction, chord.start, chord.stop)
        return self.foreground(chord, appearance), slope

    @cached_property
    def table(self) -> RadonTable:
        """Means along all chords, made at first need."""
        return RadonTable.of(self.ball)


def _is_whole(chord: Chord) -> bool:
    if isinstance(chord.start, Tensor) or isinstance(chord.stop, Tensor):
        return False
    return chord.start == -1 and chord.stop == 1
