"""A camera's read noise and gain from photos that differ in nothing but noise."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from toolkit.background import PairSamples, sample_pair
from toolkit.errors import CalibrationError, ConfigError, MismatchError
from toolkit.measurement import Caution
from toolkit.types import LinearImage, NoiseModel

Array = NDArray[np.float64]

SAME_TIME = 0.01
"""Share by which the times of photos may differ that count as repeated."""
BOOTSTRAPS = 16
BLOCK, MOVED, MOST_MOVED = 8, 8.0, 0.02
"""Side of the squares whose means are compared, px; standard deviations of a mean beyond which a
square has changed, and the share of such squares that is borne."""
QUIET = 1e-3
"""Noise that is always granted, share of white: half a step of 8 bits in the bright."""
FLICKER = 0.02
"""Share by which the light may change from photo to photo before somebody should know."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredNoise:
    """Noise of one photo in linear light, white = 1: variance = read^2 + gain * light."""

    model: NoiseModel
    read_std: tuple[float, float, float]  # R, G, B
    read_std_error: tuple[float, float, float]
    gain: tuple[float, float, float]
    gain_std: tuple[float, float, float]
    photos: int
    range: tuple[float, float]  # light of the samples, 1st to 99th percentile
    warnings: tuple[Caution, ...] = ()


def measure_noise(
    paths: Sequence[Path],
    *,
    response: str | Path | None = None,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> MeasuredNoise:
    """Measure noise from pairs of photos of the same still scene with the same settings.

    Photon transfer: the variance of differences against the mean, so that neither the scene nor
    fixed patterns count. Photos of several exposure times are paired within each time: a dark and
    a bright pair tell read noise and gain apart best.
    Source: Janesick 2007, chapter 5; EMVA 1288. Deviation: one line through all levels, robust.

    Args:
        paths: two photos at least of one exposure time.
        response: as in `toolkit.read_image`; noise is told in the light it gives.
        on_photo: called with each path as its photo is read.

    Raises:
        ConfigError: when a file is named twice, or the response is unknown.
        ImageError: when a photo cannot be read.
        MismatchError: when sizes or kinds differ, or the scene changed.
        CalibrationError: when no two photos have the same exposure time, or all is clipped.
    """
    if len(set(paths)) < len(paths):
        raise ConfigError("a photo is named twice; its noise would be the same: name each once")
    samples, names = _pairs(paths, response, on_photo)
    if not samples:
        raise CalibrationError(
            "no two photos were exposed equally long; noise shows in repeated photos: take two or "
            "more of a still scene with the same settings"
        )
    joined = _joined(samples)
    if min(len(level) for level in joined.level) < 1000:
        raise CalibrationError(
            "nearly all is clipped; expose so that the scene is neither black nor white"
        )
    model = joined.noise()
    reads, gains = _bootstrap(joined)
    read = model.read_variance[0].sqrt()
    everything = np.concatenate(joined.level)
    low, high = np.percentile(everything, [1, 99])
    return MeasuredNoise(
        model=model,
        read_std=_triple(read),
        read_std_error=_triple(reads),
        gain=_triple(model.gain[0]),
        gain_std=_triple(gains),
        photos=len(paths),
        range=(float(low), float(high)),
        warnings=_cautions(samples, names, (float(low), float(high))),
    )


def _triple(values: torch.Tensor | Array) -> tuple[float, float, float]:
    red, green, blue = (float(value) for value in values)
    return red, green, blue


def _pairs(
    paths: Sequence[Path], response: str | Path | None, on_photo: Callable[[Path], None]
) -> tuple[list[PairSamples], list[str]]:
    """Compare each photo with the next of the same exposure time; two are held at a time."""
    from toolkit.imaging import read_image

    times: dict[Path, float] = {}
    for path in paths:
        exposure = _exposure(read_image(path, response=response))
        times[path] = 0.0 if exposure is None else exposure
        on_photo(path)
    samples, names = [], []
    ordered = sorted(paths, key=lambda path: times[path])
    last: tuple[Path, LinearImage] | None = None
    for first, second in pairwise(ordered):
        if abs(times[second] - times[first]) > SAME_TIME * times[second]:
            continue
        one = (
            last[1]
            if last is not None and last[0] == first
            else read_image(first, response=response)
        )
        other = read_image(second, response=response)
        last = second, other
        if (one.clipped.shape, one.pattern) != (other.clipped.shape, other.pattern):
            raise MismatchError(
                f"{first} and {second} differ in size or kind; use photos of one camera setting"
            )
        _check_still(one, other, f"{first} and {second}")
        samples.append(sample_pair(one, other))
        names.append(f"{first.name} and {second.name}")
    return samples, names


def _check_still(one: LinearImage, other: LinearImage, names: str) -> None:
    """Raise `MismatchError` where two photos differ by what no noise does: whole blocks alike."""
    light, change = (value.rgb[0].mean(0).numpy() for value in (one, other))
    change = light - change * (float(light.sum()) / max(float(change.sum()), 1e-9))
    rows, columns = (side // BLOCK * BLOCK for side in change.shape)
    blocks = change[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
    # of neighbouring rows, the scene's own changes are alike
    noise = np.abs(np.diff(blocks, axis=1)).mean((1, 3)) * math.sqrt(math.pi) / 2
    mean = np.abs(blocks.mean((1, 3)) - np.median(change))
    moved = mean > MOVED * (noise + QUIET) / BLOCK
    if moved.mean() > MOST_MOVED:
        raise MismatchError(
            f"{names} differ by more than noise in {moved.mean():.0%} of the picture; take photos "
            "of a scene in which nothing moves, from a tripod"
        )


def _exposure(image: LinearImage) -> float | None:
    return None if image.exposure is None else float(image.exposure[0])


def _joined(samples: Sequence[PairSamples]) -> PairSamples:
    """Put pairs together; what the light changed in each is taken out first."""
    level: list[Array] = []
    difference: list[Array] = []
    for channel in range(3):
        level.append(np.concatenate([pair.level[channel] for pair in samples]))
        difference.append(
            np.concatenate(
                [
                    pair.difference[channel] - _drift(pair, channel) * pair.level[channel]
                    for pair in samples
                ]
            )
        )
    return PairSamples(
        level=(level[0], level[1], level[2]),
        difference=(difference[0], difference[1], difference[2]),
        density=samples[0].density,
        frames=1.0,
    )


def _drift(pair: PairSamples, channel: int) -> float:
    """Give the share by which the first photo of a pair was brighter."""
    level, difference = pair.level[channel], pair.difference[channel]
    total = float(level.sum())
    return float(difference.sum()) / total if total > 0 else 0.0


def _bootstrap(joined: PairSamples) -> tuple[Array, Array]:
    """Give the standard errors of read noise and gain [3] by drawing the samples anew."""
    generator = np.random.default_rng(0)
    reads, gains = [], []
    for _ in range(BOOTSTRAPS):
        draws = [generator.integers(0, len(level), len(level)) for level in joined.level]
        levels = [level[at] for level, at in zip(joined.level, draws, strict=True)]
        changes = [change[at] for change, at in zip(joined.difference, draws, strict=True)]
        model = PairSamples(
            level=(levels[0], levels[1], levels[2]),
            difference=(changes[0], changes[1], changes[2]),
            density=joined.density,
            frames=joined.frames,
        ).noise()
        reads.append(model.read_variance[0].sqrt().numpy())
        gains.append(model.gain[0].numpy())
    return np.std(reads, axis=0, ddof=1), np.std(gains, axis=0, ddof=1)


def _cautions(
    samples: Sequence[PairSamples], names: Sequence[str], light: tuple[float, float]
) -> tuple[Caution, ...]:
    found = []
    for pair, name in zip(samples, names, strict=True):
        drift = float((pair.drift() - 1).abs().max())
        if drift > FLICKER:
            found.append(
                Caution(
                    code="light-changed",
                    message=f"the light changed by {drift:.1%} between {name}; use a steady lamp",
                )
            )
    if light[1] < 3 * max(light[0], 1e-3):
        found.append(
            Caution(
                code="narrow-range",
                message=f"all samples lie between {light[0]:.3f} and {light[1]:.3f} of white, "
                "which leaves read noise and gain open; add pairs of shorter and longer exposures",
            )
        )
    return tuple(found)
