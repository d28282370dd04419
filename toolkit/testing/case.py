"""One estimator on one sample: what the checks look at."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord, Observation
from toolkit.testing.sample import Sample
from toolkit.types import LinearImage

PARTS = ("signal", "ground", "variance")


class CheckFailed(AssertionError):
    """A promise that an estimator does not keep; the text says how."""


def expect(is_kept: object, otherwise: str) -> None:
    """Raise `CheckFailed` with the text unless the promise is kept."""
    if not is_kept:
        raise CheckFailed(otherwise)


@dataclass(frozen=True, kw_only=True)
class Case:
    """An estimator on a sample."""

    estimator: AlphaEstimator
    sample: Sample

    def observe(
        self, image: LinearImage | None = None, background: LinearImage | None = None
    ) -> Observation:
        """Observe the sample, or other pictures with its noise."""
        sample = self.sample
        shot = sample.image if image is None else image
        ground = sample.background if background is None else background
        noise = sample.noise
        pictures = len(shot.clipped)
        many = replace(
            noise,
            read_variance=noise.read_variance.expand(pictures, 3),
            gain=noise.gain.expand(pictures, 3),
        )
        return self.estimator.observe(shot, ground, many)

    def foreground(self, chord: Chord) -> Tensor:
        """Ask for the ball along chords, with its unknowns as the sample tells them."""
        return self.estimator.foreground(chord, self.appearance)

    def slope(self, chord: Chord) -> tuple[Tensor, Tensor | None]:
        """Ask for the ball and its derivative."""
        return self.estimator.foreground_and_slope(chord, self.appearance)

    @cached_property
    def seen(self) -> Observation:
        """The sample, observed."""
        return self.observe()

    @cached_property
    def appearance(self) -> Tensor | None:
        """The unknowns that explain the sample's core best with its true opacity; None without.

        The signal is linear in them, so that one least-squares solution finds them.
        """
        count = self.estimator.unknowns()
        if count == 0:
            return None
        chord = self.sample.core_chord
        at_zero = self.estimator.foreground(chord, torch.zeros(count))
        units = [self.estimator.foreground(chord, unit) - at_zero for unit in torch.eye(count)]
        signal, ground, variance = self.core(self.seen)
        alpha = self.sample.alpha[self.sample.core][:, None]
        weight = alpha / variance.sqrt()
        design = torch.stack([unit * weight for unit in units], dim=-1).flatten(0, 1)
        rest = (signal - (1 - alpha) * ground) / variance.sqrt() - at_zero * weight
        found: Tensor = torch.linalg.lstsq(design.double(), rest.flatten().double()).solution
        return found.float()

    def core(self, seen: Observation) -> tuple[Tensor, Tensor, Tensor]:
        """Give signal, ground and variance on the sample's core, each [N, Q]."""
        signal, ground, variance = (getattr(seen, part)[0] for part in PARTS)
        chosen = self.sample.core
        return signal[:, chosen].T, ground[:, chosen].T, variance[:, chosen].T

    def use(self) -> None:
        """Ask everything once."""
        self.observe()
        self.slope(chords())


def chords(
    profiles: int = 6, samples: int = 11, *, dtype: torch.dtype = torch.float32, reach: float = 0.95
) -> Chord:
    """Give whole chords at many offsets in as many directions as there are profiles."""
    offset = torch.linspace(-reach, reach, samples, dtype=dtype).repeat(profiles, 1)
    direction = torch.linspace(-3.0, 3.0, profiles, dtype=dtype)[:, None]
    return Chord(offset=offset, direction=direction)


def are_equal(first: Observation, second: Observation, part: str, share: float = 1e-4) -> bool:
    """Say whether a part of two observations agrees but for rounding."""
    return are_close(getattr(first, part), getattr(second, part), share)


def are_close(first: Tensor, second: Tensor, share: float = 1e-4) -> bool:
    """Say whether two answers agree but for rounding, by their largest finite value."""
    if first.shape != second.shape:
        return False
    finite = second[torch.isfinite(second)]
    scale = float(finite.abs().max()) if len(finite) else 0.0
    return torch.allclose(first, second, rtol=share, atol=share * scale, equal_nan=True)


def each_part(test: Callable[[str], bool], otherwise: str) -> None:
    """Expect `test` of signal, ground and variance."""
    for part in PARTS:
        expect(test(part), f"{part} {otherwise}")
