"""The door through which an estimator's answers reach the solver: what cannot be stops here.

An estimator is a stranger's code. Where it breaks, or gives values that cannot be, the error must
name it and whose it is, not a line deep in the solver.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn, TypeVar

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord, Observation
from toolkit.camera import Camera
from toolkit.errors import BadOutputError, ImageError, ShapeError, ToolkitError
from toolkit.files import one_line
from toolkit.registry import called
from toolkit.types import LinearImage, NoiseModel

PRECISIONS = (torch.float32, torch.float64)

T = TypeVar("T")


def guarded(estimator: AlphaEstimator) -> AlphaEstimator:
    """Give the same estimator with every answer checked; one that is guarded already stays itself.

    Errors of the toolkit's own kinds, by which an estimator refuses a shot, pass unchanged.
    """
    return estimator if isinstance(estimator, _Guarded) else _Guarded(estimator=estimator)


@dataclass(frozen=True, kw_only=True)
class _Guarded(AlphaEstimator):
    """An estimator whose answers are checked.

    Raises `BadOutputError`, one line with the estimator's name, what was wrong and whose fault it
    is.
    """

    estimator: AlphaEstimator

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        seen = self._ask("observe", lambda: self.estimator.observe(image, background, noise))
        if not isinstance(seen, Observation):
            self._refuse("observe", f"gives a {type(seen).__name__}, not an Observation")
        self._check_shapes(seen, image)
        if not _is_finite(seen.signal) or not _is_finite(seen.ground):
            _check_pictures(image, background)
            self._refuse("observe", "gives signals or grounds that are not finite")
        # infinite where nothing was measured; a NaN fails the comparison
        if not float(seen.variance.detach().min()) >= 0:
            _check_pictures(image, background)
            self._refuse("observe", "gives variances that are negative or no number")
        self._check_channels(seen)
        return seen

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        value = self._ask("foreground", lambda: self.estimator.foreground(chord, appearance))
        self._check_foreground("foreground", value, chord)
        return value

    def foreground_and_slope(
        self, chord: Chord, appearance: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        name = "foreground_and_slope"
        answer = self._ask(name, lambda: self.estimator.foreground_and_slope(chord, appearance))
        if not isinstance(answer, tuple) or len(answer) != 2:
            self._refuse(name, f"gives a {type(answer).__name__}, not a value and its slope")
        value, slope = answer
        self._check_foreground(name, value, chord)
        if slope is not None:
            self._check_foreground(name, slope, chord)
            if slope.shape != value.shape:
                shapes = f"{list(value.shape)} and {list(slope.shape)}"
                self._refuse(name, f"gives value and slope of different shapes, {shapes}")
        return value, slope

    def seen_through(self, camera: Camera) -> AlphaEstimator:
        through = self._ask("seen_through", lambda: self.estimator.seen_through(camera))
        if not isinstance(through, AlphaEstimator):
            self._refuse("seen_through", f"gives a {type(through).__name__}, not an estimator")
        return guarded(through)

    def other_lights(self) -> tuple[AlphaEstimator, ...]:
        others = self._ask("other_lights", self.estimator.other_lights)
        if not all(isinstance(other, AlphaEstimator) for other in others):
            self._refuse("other_lights", "gives something else than estimators")
        return tuple(guarded(other) for other in others)

    def loosened(self) -> AlphaEstimator | None:
        loose = self._ask("loosened", self.estimator.loosened)
        if loose is not None and not isinstance(loose, AlphaEstimator):
            self._refuse("loosened", f"gives a {type(loose).__name__}, not an estimator")
        return None if loose is None else guarded(loose)

    def relit(self, amounts: Tensor) -> AlphaEstimator:
        relit = self._ask("relit", lambda: self.estimator.relit(amounts))
        if not isinstance(relit, AlphaEstimator):
            self._refuse("relit", f"gives a {type(relit).__name__}, not an estimator")
        return guarded(relit)

    def doubts(self) -> dict[str, str]:
        doubts = self._ask("doubts", self.estimator.doubts)
        if not isinstance(doubts, dict) or not all(
            isinstance(text, str) for pair in doubts.items() for text in pair
        ):
            self._refuse("doubts", "gives something else than messages by code")
        return doubts

    def unknowns(self) -> int:
        count = self._ask("unknowns", self.estimator.unknowns)
        if isinstance(count, bool) or not isinstance(count, int) or count < 0:
            self._refuse("unknowns", f"gives {count!r:.40}, not a number from 0 up")
        return count

    def _ask(self, method: str, question: Callable[[], T]) -> T:
        try:
            return question()
        except (ShapeError, SystemExit) as error:
            self._blame(method, error)
        except (ToolkitError, MemoryError):
            raise
        except Exception as error:  # a stranger's code may raise anything
            self._blame(method, error)

    def _blame(self, method: str, error: BaseException) -> NoReturn:
        reason = f"breaks with {type(error).__name__}: {one_line(error)}"
        raise BadOutputError(self._text(method, reason)) from error

    def _refuse(self, method: str, trouble: str) -> NoReturn:
        raise BadOutputError(self._text(method, trouble))

    def _text(self, method: str, trouble: str) -> str:
        return (
            f"{called(type(self.estimator))}: its {method} {trouble}; report this to its author, "
            "or choose another --estimator"
        )

    def _check_shapes(self, seen: Observation, image: LinearImage) -> None:
        parts = (seen.signal, seen.ground, seen.variance)
        if not all(isinstance(part, Tensor) for part in parts):
            kinds = ", ".join(type(part).__name__ for part in parts)
            self._refuse("observe", f"gives {kinds}, not three tensors")
        batch, _, height, width = image.clipped.shape
        shapes = [list(part.shape) for part in parts]
        channels = shapes[0][1] if len(shapes[0]) == 4 else 0
        if channels == 0 or any(shape != [batch, channels, height, width] for shape in shapes):
            self._refuse(
                "observe",
                f"gives signal, ground, variance of shapes {shapes[0]}, {shapes[1]}, {shapes[2]}; "
                f"[{batch}, Q, {height}, {width}] is needed, one Q for all",
            )
        if parts[0].dtype not in PRECISIONS or len({part.dtype for part in parts}) > 1:
            kinds = ", ".join(str(part.dtype) for part in parts)
            self._refuse("observe", f"gives {kinds}; one of float32 and float64 is needed for all")

    def _check_channels(self, seen: Observation) -> None:
        zero = torch.zeros(1, dtype=seen.signal.dtype)
        count = self.unknowns()
        appearance = torch.zeros(count, dtype=zero.dtype) if count else None
        channels = self.foreground(Chord(offset=zero, direction=zero), appearance).shape[-1]
        if channels != seen.signal.shape[1]:
            self._refuse(
                "foreground",
                f"gives {channels} channels where its observe gives {seen.signal.shape[1]}",
            )

    def _check_foreground(self, method: str, value: object, chord: Chord) -> None:
        if not isinstance(value, Tensor):
            self._refuse(method, f"gives a {type(value).__name__}, not a tensor")
        wanted = list(chord.offset.shape)
        if list(value.shape[:-1]) != wanted or value.ndim != len(wanted) + 1:
            sizes = ", ".join(map(str, wanted))
            self._refuse(method, f"gives shape {list(value.shape)}; [{sizes}, Q] is needed")
        if value.dtype != chord.offset.dtype:
            self._refuse(method, f"gives {value.dtype} for offsets in {chord.offset.dtype}")
        if not _is_finite(value):
            self._refuse(method, "gives values that are not finite")


def _is_finite(values: Tensor) -> bool:
    """One pass without a mask: a NaN or an infinity survives every sum."""
    return bool(torch.isfinite(values.detach().sum()))


def _check_pictures(image: LinearImage, background: LinearImage) -> None:
    """Raise `ImageError` where the pictures themselves are to blame."""
    for name, picture in (("shot", image), ("background", background)):
        if not _is_finite(picture.recorded):
            raise ImageError(f"the {name} holds values that are not finite; read it anew")
