"""A ball whose light a sharp picture told with errors, to be found together with its motion."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from plugins.ball_light import BallLight
from plugins.chord_means import ChordMeans
from toolkit import (
    AlphaEstimator,
    Camera,
    Chord,
    LinearImage,
    NoiseModel,
    Observation,
    SharpBall,
    observe_colours,
)


@dataclass(frozen=True, kw_only=True)
class LooseLight(AlphaEstimator):
    """A ball's light plus some standard deviations of each error it may have, as unknowns."""

    known: AlphaEstimator
    errors: ChordMeans  # [E * 3] in place of colours
    count: int
    kept: "_Kept" = field(default_factory=lambda: _Kept(), repr=False, compare=False)

    @classmethod
    def of(cls, known: AlphaEstimator, ball: SharpBall, camera: Camera | None) -> "LooseLight":
        """Lay out the errors of a sharp ball's light; it must know of some."""
        errors = light_errors(ball)
        light = BallLight.of_errors(ball, errors.flatten(0, 1), camera)
        means = ChordMeans(light=light, camera=camera, disc=ball.disc)
        return cls(known=known, errors=means, count=len(errors))

    def unknowns(self) -> int:
        """Say how many errors there are."""
        return self.count

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Hand on the colours as they are; behind a mosaic, those measured and no others."""
        return observe_colours(image, background, noise)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give the mean colour along each chord, or the part between start and stop."""
        colour, errors = self.kept.find(chord, self._both)
        if appearance is None:
            return colour
        return colour + (errors @ appearance.to(errors)).to(colour)

    def _both(self, chord: Chord) -> tuple[Tensor, Tensor]:
        """Give the mean colour [..., S, 3] and what each error changes [..., S, 3, E]."""
        colour = self.known.foreground(chord, None)
        rows = [self.errors.part(row) for row in _rows(chord)]
        errors = torch.cat(rows).reshape(*chord.offset.shape, self.count, 3).mT
        return colour, errors


def light_errors(ball: SharpBall) -> Tensor:
    """Give the independent errors of a ball's light, one standard deviation each [E, 3, N, N]."""
    if ball.others is None:
        return torch.zeros(0, *ball.rgb.shape)
    errors: Tensor = (ball.others - ball.rgb) / math.sqrt(len(ball.others))
    return errors


def _rows(chord: Chord) -> list[Chord]:
    """Part chords by the instants they belong to; in single precision, which is enough."""
    chord = replace(chord, offset=chord.offset.float())
    if chord.offset.ndim < 2:
        return [chord]
    return [
        Chord(
            offset=chord.offset[number],
            direction=_own(chord.direction, chord, number),
            start=_end(chord.start, chord, number),
            stop=_end(chord.stop, chord, number),
            place=None if chord.place is None else _own(chord.place, chord, number),
            ray=None if chord.ray is None else _own(chord.ray, chord, number),
            ahead=None if chord.ahead is None else _own(chord.ahead, chord, number),
        )
        for number in range(len(chord.offset))
    ]


def _own(value: Tensor, chord: Chord, number: int) -> Tensor:
    is_shared = value.ndim < 2 or len(value) != len(chord.offset)
    return value if is_shared else value[number]


def _end(value: float | Tensor, chord: Chord, number: int) -> float | Tensor:
    return _own(value, chord, number) if isinstance(value, Tensor) else value


@dataclass(slots=True)
class _Kept:
    """The answer to the last question: a fit asks for one chord in many lights, one by one."""

    chord: Chord | None = None
    answer: tuple[Tensor, Tensor] | None = None

    def find(
        self, chord: Chord, ask: Callable[[Chord], tuple[Tensor, Tensor]]
    ) -> tuple[Tensor, Tensor]:
        """Give the answer for a chord, asked anew where it is another one."""
        if self.answer is None or self.chord is not chord:
            self.chord, self.answer = chord, ask(chord)
        return self.answer
