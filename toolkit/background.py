"""What the picture shows away from the ball: the camera's noise, and how the light drifted."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.demosaicing import tile
from toolkit.errors import MismatchError
from toolkit.ranks import HALF_OF_NORMAL, ranked_value
from toolkit.types import LinearImage, NoiseModel

SAMPLES = 30_000
"""Pixels a channel, at least, that the statistics look at: a variance is then right to 1 %."""
LEVELS = 8
"""Groups of equal count by brightness, from which the noise's dependence on the level is read."""
MEDIAN_STD = 1.2533
"""Standard deviation of a median of normal values over that of their mean."""
MIN_STD = 2e-5
"""Share of white below which no camera's noise lies (a quarter step of 14 bits)."""

Values = NDArray[np.float64]


def check_pair(image: LinearImage, background: LinearImage) -> None:
    """Raise `MismatchError` unless shot and background have the same size."""
    if image.clipped.shape[-2:] != background.clipped.shape[-2:]:
        raise MismatchError(
            f"the background is {background.width}x{background.height} px but the shot is "
            f"{image.width}x{image.height} px; take both with the same camera and settings"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSamples:
    """Raw samples of shot and background at the same places, an even subset of each channel."""

    level: tuple[Values, Values, Values]  # [N] each, the mean weighed by precision
    difference: tuple[Values, Values, Values]  # [N] each, shot minus background
    density: tuple[float, ...]  # share of the pixels at which a channel was measured
    frames: float  # of the background

    def noise(self) -> NoiseModel:
        """Give the noise of one picture; see `estimate_noise`."""
        share = 1 + 1 / self.frames
        pairs = zip(self.level, self.difference, strict=True)
        fits = [_fit_variance(level, difference, share) for level, difference in pairs]
        return NoiseModel(
            read_variance=torch.tensor([[fit[0] for fit in fits]]),
            gain=torch.tensor([[fit[1] for fit in fits]]),
            density=torch.tensor(self.density),
        )

    def drift(self) -> Tensor:
        """Give the median ratio of shot to background per channel, [3]."""
        return self.drift_and_std()[0]

    def drift_and_std(self) -> tuple[Tensor, Tensor]:
        """Give `drift`, and the standard deviation that noise leaves it, [3] each."""
        pairs = zip(self.level, self.difference, strict=True)
        ratios = [_ratio(level, difference, self.frames) for level, difference in pairs]
        drift, std = torch.tensor(ratios, dtype=torch.float64).mT
        return drift, std


def sample_pair(
    image: LinearImage,
    background: LinearImage,
    ignore: Tensor | None = None,
    least: int = SAMPLES,
) -> PairSamples:
    """Look at shot and background in the same places, `least` of each channel and not many more.

    Raw samples are taken where both pictures still hold them, since demosaicing smooths the noise.

    Args:
        image: the shot.
        background: the scene without the ball.
        ignore: pixels of the ball and of whatever else moved [B, 1, H, W] bool.
        least: pixels a channel, where there are as many.
    """
    lattices = [_lattice(image, background, channel) for channel in range(3)]
    usable = {lattice: _usable(image, background, ignore, lattice, least) for lattice in lattices}
    red, green, blue = (
        _channel_samples(image, background, channel, lattice, usable[lattice], least)
        for channel, lattice in enumerate(lattices)
    )
    return PairSamples(
        level=(red[0], green[0], blue[0]),
        difference=(red[1], green[1], blue[1]),
        density=tuple(_density(image, background, channel) for channel in range(3)),
        frames=background.frames,
    )


def estimate_noise(
    image: LinearImage, background: LinearImage, ignore: Tensor | None = None
) -> NoiseModel:
    """Estimate read noise and gain from the difference of two pictures, robustly against the ball.

    Within each group of equal brightness the median is taken out first, so that a drift of the
    light does not count as noise.
    Source: MATHS, var(C) = read^2 + gain * C. [derived]

    Args:
        image: the shot.
        background: the scene without the ball.
        ignore: pixels of the ball and of whatever else moved [B, 1, H, W] bool.

    Returns:
        NoiseModel of one picture; the difference of both has (1 + 1 / background.frames) times its
        variance.
    """
    return sample_pair(image, background, ignore).noise()


def brightness_drift(
    image: LinearImage, background: LinearImage, ignore: Tensor | None = None
) -> Tensor:
    """Give the median ratio of shot to background per channel, [3]; 1 when the light stayed."""
    return sample_pair(image, background, ignore).drift()


def _ratio(level: Values, difference: Values, frames: float) -> tuple[float, float]:
    """Give the median ratio of shot to background, and the standard deviation of that median."""
    if not len(level):  # all is clipped, and nothing tells of another light
        return 1.0, 0.0
    bright = np.argpartition(level, len(level) // 2)[len(level) // 2 :]
    shares = difference[bright] / level[bright].clip(1e-3)
    share = float(ranked_value(shares, 0.5))
    spread = float(ranked_value(np.abs(shares - share), 0.5)) / HALF_OF_NORMAL
    own = 1 / (1 + frames)  # of the shot in the level
    # a background without light leaves nothing below: the ratio is as good as infinite
    ratio = (1 + (1 - own) * share) / max(1 - own * share, 1e-6)
    return ratio, MEDIAN_STD * spread / len(bright) ** 0.5


def scale_background(background: LinearImage, ratio: Tensor) -> LinearImage:
    """Give the background in the light of the shot, each channel multiplied by its ratio [3].

    Its noise grows with it: it then counts for as many frames as leave that much.
    """
    frames = background.frames / float((ratio * ratio).mean())
    ratio = ratio.to(background.recorded)
    if background.pattern is None:
        return background.remade(background.recorded * ratio[:, None, None], frames=frames)
    period = ratio[torch.tensor(background.pattern)].numpy()
    site = tile(period, background.recorded.shape[-2:])
    return background.remade(background.recorded * torch.from_numpy(site), frames=frames)


def _usable(
    image: LinearImage,
    background: LinearImage,
    ignore: Tensor | None,
    lattice: tuple[int, int, int, int],
    least: int,
) -> NDArray[np.bool_]:
    """Tell which of the samples on a lattice are neither clipped nor to be ignored."""
    sites = _sites(image, lattice, least)
    unusable = image.clipped[0, 0][sites] | background.clipped[0, 0][sites]
    if ignore is not None:
        unusable = unusable | ignore[0, 0][sites]
    return ~np.asarray(unusable.numpy())


def _channel_samples(
    image: LinearImage,
    background: LinearImage,
    channel: int,
    lattice: tuple[int, int, int, int],
    usable: NDArray[np.bool_],
    least: int,
) -> tuple[Values, Values]:
    """Mean levels and differences of one channel's usable samples on a lattice, [N] each."""
    if image.mosaic is not None and background.mosaic is not None:
        shot, ground = image.mosaic[0, 0], background.mosaic[0, 0]
    else:
        shot, ground = image.rgb[0, channel], background.rgb[0, channel]
    sites = _sites(image, lattice, least)
    # NumPy from here on: it sorts many times faster than torch
    seen, empty = (light[sites].numpy()[usable].astype(np.float64) for light in (shot, ground))
    # the mean weighed by precision is the one level whose noise is independent of the difference's:
    # grouped by any other, a group would be selected for differences of one sign
    level = (seen + background.frames * empty) / (1 + background.frames)
    return level, seen - empty


def _sites(
    image: LinearImage, lattice: tuple[int, int, int, int], least: int
) -> tuple[slice, slice]:
    """Thin out a lattice to `least` samples or not many more."""
    row, column, step_y, step_x = lattice
    step = max(1, int((image.width * image.height / (step_y * step_x) / least) ** 0.5))
    return slice(row, None, step_y * step), slice(column, None, step_x * step)


def _lattice(
    image: LinearImage, background: LinearImage, channel: int
) -> tuple[int, int, int, int]:
    """First row and column, and the periods, of one site of `channel`: all sites of colours."""
    pattern = image.pattern
    if image.mosaic is None or background.mosaic is None or pattern is None:
        return 0, 0, 1, 1
    sites = [
        (y, x)
        for y, line in enumerate(pattern)
        for x, colour in enumerate(line)
        if colour == channel
    ]
    return (*sites[0], len(pattern), len(pattern[0]))


def _density(image: LinearImage, background: LinearImage, channel: int) -> float:
    if image.mosaic is None or background.mosaic is None or image.pattern is None:
        return 1.0
    sites = [colour for line in image.pattern for colour in line]
    return sites.count(channel) / len(sites)


def _fit_variance(level: Values, difference: Values, share: float) -> tuple[float, float]:
    """Fit read variance and gain, neither negative, to the variance of each brightness group."""
    if len(level) < 4 * LEVELS:
        return MIN_STD**2, 0.0
    groups = _ranked(level)[: len(level) // LEVELS * LEVELS].reshape(LEVELS, -1)
    x = level[groups].mean(-1)
    variance = (_robust_variance(difference[groups]) / share).clip(MIN_STD**2)
    design = np.stack([np.ones_like(x), x], axis=-1) / variance[:, None]
    read, gain = np.linalg.lstsq(design, np.ones_like(x), rcond=None)[0].tolist()
    if gain < 0:
        return max(float(ranked_value(variance, 0.5)), MIN_STD**2), 0.0
    if read < MIN_STD**2:
        slope = float((x / variance).sum() / ((x / variance) ** 2).sum())
        return MIN_STD**2, max(slope, 0.0)
    return read, gain


def _robust_variance(difference: Values) -> Values:
    """Variance of the bulk of each row [G, N]: what lies beyond 4 of its deviations is left out.

    On 8-bit pictures most differences may be exactly 0, so that the median or even the middle half
    says nothing: the spread is looked for further and further out.
    """
    difference = difference - ranked_value(difference, 0.5)[:, None]
    size = np.abs(difference)
    half, most, nearly_all = (ranked_value(size, share) for share in (0.5, 0.8, 0.98))
    spread = np.maximum(half / HALF_OF_NORMAL, most / 1.282)
    spread = np.where(spread > 0, spread, nearly_all)
    kept = size <= 4 * spread[:, None]
    count = np.count_nonzero(kept, axis=-1)
    inner = np.where(kept, difference, 0)
    squares = np.einsum("gn,gn->g", inner, inner) - inner.sum(-1) ** 2 / count
    return np.asarray(squares / (count - 1))


def _ranked(values: Values) -> NDArray[np.intp]:
    """Indices of rising values, to 1 / 65536 of their range: whole numbers are sorted by digits."""
    low, high = values.min(), values.max()
    steps = (values - low) * (65535 / max(high - low, 1e-300))
    return np.argsort(steps.astype(np.uint16), kind="stable")
