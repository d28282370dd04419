"""What the picture shows away from the ball: the camera's noise, and how the light drifted."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.demosaicing import tile
from toolkit.errors import MismatchError
from toolkit.types import LinearImage, NoiseModel

SAMPLES = 60_000
"""Pixels a channel that the statistics look at; their own error is then below 1 %."""
LEVELS = 8
"""Groups of equal count by brightness, from which the noise's dependence on the level is read."""
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


def estimate_noise(
    image: LinearImage, background: LinearImage, ignore: Tensor | None = None
) -> NoiseModel:
    """Estimate read noise and gain from the difference of two pictures, robustly against the ball.

    Raw samples are compared where both pictures still hold them, since demosaicing smooths the
    noise. Within each group of equal brightness the median is taken out first, so that a drift of
    the light does not count as noise.
    Source: MATHS, var(C) = read^2 + gain * C. [derived]

    Args:
        image: the shot.
        background: the scene without the ball.
        ignore: pixels of the ball and of whatever else moved [B, 1, H, W] bool.

    Returns:
        NoiseModel of one picture; the difference of both has (1 + 1 / background.frames) times its
        variance.
    """
    share = 1 + 1 / background.frames
    pairs = [_channel_samples(image, background, channel, ignore) for channel in range(3)]
    fits = [_fit_variance(level, difference, share) for level, difference in pairs]
    density = [_density(image, background, channel) for channel in range(3)]
    return NoiseModel(
        read_variance=torch.tensor([[fit[0] for fit in fits]]),
        gain=torch.tensor([[fit[1] for fit in fits]]),
        density=torch.tensor(density),
    )


def brightness_drift(
    image: LinearImage, background: LinearImage, ignore: Tensor | None = None
) -> Tensor:
    """Give the median ratio of shot to background per channel, [3]; 1 when the light stayed."""
    ratios = []
    for channel in range(3):
        level, difference = _channel_samples(image, background, channel, ignore)
        if not len(level):  # all is clipped, and nothing tells of another light
            ratios.append(1.0)
            continue
        bright = level.argsort()[len(level) // 2 :]
        share = float(_quantile(difference[bright] / level[bright].clip(1e-3), 0.5))
        own = 1 / (1 + background.frames)  # of the shot in the level
        # a background without light leaves nothing below: the ratio is as good as infinite
        ratios.append((1 + (1 - own) * share) / max(1 - own * share, 1e-6))
    return torch.tensor(ratios, dtype=torch.float64)


def scale_background(background: LinearImage, ratio: Tensor) -> LinearImage:
    """Give the background in the light of the shot, each channel multiplied by its ratio [3]."""
    ratio = ratio.to(background.recorded)
    if background.pattern is None:
        return background.remade(background.recorded * ratio[:, None, None])
    period = ratio[torch.tensor(background.pattern)].numpy()
    site = tile(period, background.recorded.shape[-2:])
    return background.remade(background.recorded * torch.from_numpy(site))


def _channel_samples(
    image: LinearImage, background: LinearImage, channel: int, ignore: Tensor | None
) -> tuple[Values, Values]:
    """Mean levels and differences of one channel on an even subset of its raw samples, [N] each."""
    if image.mosaic is not None and background.mosaic is not None and image.pattern is not None:
        shot, ground = image.mosaic[0, 0], background.mosaic[0, 0]
        row, column, step_y, step_x = _lattice(image.pattern, channel)
    else:
        shot, ground = image.rgb[0, channel], background.rgb[0, channel]
        row, column, step_y, step_x = 0, 0, 1, 1
    step = max(1, math.ceil((shot.numel() / (step_y * step_x) / SAMPLES) ** 0.5))
    sites = (slice(row, None, step_y * step), slice(column, None, step_x * step))
    unusable = [image.clipped, background.clipped, *([] if ignore is None else [ignore])]
    # NumPy from here on: it sorts many times faster than torch
    usable = ~np.any([mask[0, 0][sites].numpy() for mask in unusable], axis=0)
    seen, empty = (light[sites].numpy()[usable].astype(np.float64) for light in (shot, ground))
    # the mean weighed by precision is the one level whose noise is independent of the difference's:
    # grouped by any other, a group would be selected for differences of one sign
    level = (seen + background.frames * empty) / (1 + background.frames)
    return level, seen - empty


def _lattice(pattern: tuple[tuple[int, ...], ...], channel: int) -> tuple[int, int, int, int]:
    """First row and column, and the periods, of one site of `channel` in the mosaic."""
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
    groups = level.argsort()[: len(level) // LEVELS * LEVELS].reshape(LEVELS, -1)
    x = level[groups].mean(-1)
    variance = (_robust_variance(difference[groups]) / share).clip(MIN_STD**2)
    design = np.stack([np.ones_like(x), x], axis=-1) / variance[:, None]
    read, gain = np.linalg.lstsq(design, np.ones_like(x), rcond=None)[0].tolist()
    if gain < 0:
        return max(float(_quantile(variance, 0.5)), MIN_STD**2), 0.0
    if read < MIN_STD**2:
        slope = float((x / variance).sum() / ((x / variance) ** 2).sum())
        return MIN_STD**2, max(slope, 0.0)
    return read, gain


def _robust_variance(difference: Values) -> Values:
    """Variance of the bulk of each row [G, N]: what lies beyond 4 of its deviations is left out.

    On 8-bit pictures most differences may be exactly 0, so that the median or even the middle half
    says nothing: the spread is looked for further and further out.
    """
    size = np.abs(difference - _quantile(difference, 0.5)[:, None])
    half, most, nearly_all = (_quantile(size, share) for share in (0.5, 0.8, 0.98))
    spread = np.maximum(half / 0.674, most / 1.282)
    spread = np.where(spread > 0, spread, nearly_all)
    kept = size <= 4 * spread[:, None]
    return np.asarray(difference.var(-1, ddof=1, where=kept))


def _quantile(values: Values, share: float) -> Values:
    """Give the value below which a share of those along the last axis lies, without interpolation.

    NumPy's own is three times as slow, and the first call of it loads further modules.
    """
    rank = round(share * (values.shape[-1] - 1))
    return np.asarray(np.partition(values, rank)[..., rank])
