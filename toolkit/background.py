"""What the picture shows away from the ball: the camera's noise, and how the light drifted."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.errors import MismatchError
from toolkit.types import LinearImage, NoiseModel

SAMPLES = 60_000
"""Pixels a channel that the statistics look at; their own error is then below 1 %."""
LEVELS = 8
"""Groups of equal count by brightness, from which the noise's dependence on the level is read."""
MIN_STD = 2e-5
"""Share of white below which no camera's noise lies (a quarter step of 14 bits)."""


def check_pair(image: LinearImage, background: LinearImage) -> None:
    """Raise `MismatchError` unless shot and background have the same size."""
    if image.rgb.shape[-2:] != background.rgb.shape[-2:]:
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
            ratios.append(torch.ones((), dtype=torch.float64))
            continue
        bright = level >= level.median()
        share = (difference[bright] / level[bright].clamp_min(1e-3)).median()
        own = 1 / (1 + background.frames)  # of the shot in the level
        # a background without light leaves nothing below: the ratio is as good as infinite
        ratios.append((1 + (1 - own) * share) / (1 - own * share).clamp_min(1e-6))
    return torch.stack(ratios)


def scale_background(background: LinearImage, ratio: Tensor) -> LinearImage:
    """Give the background in the light of the shot, each channel multiplied by its ratio [3]."""
    return replace(background, rgb=background.rgb * ratio.to(background.rgb)[:, None, None])


def _channel_samples(
    image: LinearImage, background: LinearImage, channel: int, ignore: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Mean levels and differences of one channel on an even subset of its raw samples."""
    shot, ground, clipped = image.rgb[0, channel], background.rgb[0, channel], image.clipped[0, 0]
    clipped = clipped | background.clipped[0, 0]
    if ignore is not None:
        clipped = clipped | ignore[0, 0]
    if image.mosaic is not None and background.mosaic is not None and image.pattern is not None:
        row, column, step_y, step_x = _lattice(image.pattern, channel)
        shot = image.mosaic[0, 0, row::step_y, column::step_x]
        ground = background.mosaic[0, 0, row::step_y, column::step_x]
        clipped = clipped[row::step_y, column::step_x]
    step = max(1, math.ceil((shot.numel() / SAMPLES) ** 0.5))
    shot, ground = shot[::step, ::step], ground[::step, ::step]
    usable = ~clipped[::step, ::step]
    shot, ground = shot[usable].double(), ground[usable].double()
    # the mean weighed by precision is the one level whose noise is independent of the difference's:
    # grouped by any other, a group would be selected for differences of one sign
    level = (shot + background.frames * ground) / (1 + background.frames)
    return level, shot - ground


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


def _fit_variance(level: Tensor, difference: Tensor, share: float) -> tuple[float, float]:
    """Fit read variance and gain, neither negative, to the variance of each brightness group."""
    if level.numel() < 4 * LEVELS:
        return MIN_STD**2, 0.0
    order = level.argsort()
    levels, variances = [], []
    for group in order.chunk(LEVELS):
        levels.append(level[group].mean())
        variances.append(_robust_variance(difference[group]) / share)
    x, variance = torch.stack(levels), torch.stack(variances).clamp_min(MIN_STD**2)
    design = torch.stack([torch.ones_like(x), x], dim=-1) / variance[:, None]
    read, gain = torch.linalg.lstsq(design, torch.ones_like(x)[:, None]).solution[:, 0].tolist()
    if gain < 0:
        return max(float(variance.median()), MIN_STD**2), 0.0
    if read < MIN_STD**2:
        slope = float((x / variance).sum() / ((x / variance) ** 2).sum())
        return MIN_STD**2, max(slope, 0.0)
    return read, gain


def _robust_variance(difference: Tensor) -> Tensor:
    """Variance of the bulk: samples beyond 4 standard deviations of the bulk are left out.

    On 8-bit pictures most differences may be exactly 0, so that the median or even the middle half
    says nothing: the spread is looked for further and further out.
    """
    size = (difference - difference.median()).abs()
    shares = torch.tensor([0.5, 0.8, 0.98], dtype=size.dtype)
    half, most, nearly_all = size.quantile(shares).tolist()
    spread = max(half / 0.674, most / 1.282) or nearly_all
    kept = difference[size <= 4 * spread]
    return kept.var() if len(kept) > 1 else difference.new_zeros(())
