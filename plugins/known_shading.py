"""A ball known from a sharp picture: shaded, shiny, or lit by lamps of several colours."""

import copy
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from plugins.radon_table import RadonTable
from plugins.view_turn import ViewTurn
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


@dataclass(frozen=True, kw_only=True)
class KnownShading(AlphaEstimator):
    """The ball is lit as in a sharp picture, wherever it is: nothing on it turns with it.

    What a pixel of the streak sees is the mean of the disc's colours along the chord that passes
    over it. Where the ball is seen along another ray than in the sharp picture, the disc shows
    another part of it: this is followed to first order in the turn of the view.
    Source: Caglioti & Giusti 2007, section 3.2.2. Deviations: the composited colours are fitted,
    not alpha; the means come from a table made once for all directions; the view may turn.
    """

    ball: SharpBall
    """The ball seen sharply, in the light it moved in: --ball-image F, or --ball F."""
    view_turn: ViewTurn | None = field(default=None, init=False, repr=False)
    """From the view of the sharp picture, which is the shot's camera's too; `seen_through`."""

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
        _ = self.table  # made before it is copied, for every shot
        seen = copy.copy(self)
        object.__setattr__(seen, "view_turn", ViewTurn.of(camera, self.ball.disc))
        return seen

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Hand on the colours as they are; behind a mosaic, those measured and no others."""
        return observe_colours(image, background, noise)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the mean colour along each chord, or along the part between start and stop."""
        if _is_whole(chord):
            return self.foreground_and_slope(chord)[0]
        return self.table.part(*self._part(chord))

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Give the same and its derivative in the chord's offset, in closed form."""
        if _is_whole(chord):
            direction = chord.direction.to(chord.offset)
            return self.table.whole(chord.offset, direction, self._turn(chord))
        return self.foreground(chord, appearance), self.table.slope_of_part(*self._part(chord))

    def _part(
        self, chord: Chord
    ) -> tuple[Tensor, Tensor, float | Tensor, float | Tensor, Tensor | None]:
        direction = chord.direction.to(chord.offset)
        return chord.offset, direction, chord.start, chord.stop, self._turn(chord)

    def _turn(self, chord: Chord) -> Tensor | None:
        """Say by how much the view of the ball has turned [..., 1, 3], where that is known."""
        if self.view_turn is None or chord.place is None:
            return None
        return self.view_turn.at(chord.place.to(chord.offset))

    @cached_property
    def table(self) -> RadonTable:
        """Means along all chords, made at first need."""
        return RadonTable.of(self.ball)


def _is_whole(chord: Chord) -> bool:
    if isinstance(chord.start, Tensor) or isinstance(chord.stop, Tensor):
        return False
    return chord.start == -1 and chord.stop == 1
