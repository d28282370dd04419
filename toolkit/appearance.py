"""A first guess of what an estimator leaves open of the ball's looks, from the streak's shape.

The share of the exposure during which the ball covers the middle of its streak is its width over
the way it went, so that a streak's length tells its opacity, and with the background the ball's
colour. [derived]
"""

import torch

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.types import Appearance, Profiles

CORE = 0.5
"""Half widths about the axis in which pixels are looked at: nearer the rim little is covered."""
MIDDLE = 0.5
"""Share of the streak's length about its middle that is looked at."""
ERROR = 0.2
"""Relative standard deviation of an opacity guessed from a rough length and width."""


def guess_appearance(
    profiles: Profiles, half_width: float, estimator: AlphaEstimator
) -> Appearance:
    """Guess the unknowns of an estimator, which the signal is linear in, by least squares.

    Args:
        profiles: of one picture, across the rough axis from tip to tip.
        half_width: rough, px.
        estimator: with unknowns.
    """
    length = float(profiles.position[0, -1])
    travel = max(length - 2 * half_width, half_width)
    inner = (profiles.position[0] - length / 2).abs() < MIDDLE * length / 2
    share = profiles.offset[0, inner] / half_width
    opacity = min(2 * half_width / travel, 1.0)
    alpha = (opacity * (1 - share * share).clamp_min(0).sqrt())[..., None]
    is_core = profiles.valid[0, inner] & (share.abs() <= CORE)
    weight = is_core[..., None] / profiles.variance[0, inner]
    chord = Chord(offset=share, direction=profiles.direction[0, inner][:, None])
    count = estimator.unknowns()
    at_zero = estimator.foreground(chord, torch.zeros(count, dtype=share.dtype))
    units = torch.eye(count, dtype=share.dtype)
    design = alpha[..., None] * torch.stack(
        [estimator.foreground(chord, unit) - at_zero for unit in units], dim=-1
    )
    ground = profiles.ground[0, inner]
    rest = profiles.signal[0, inner] - (1 - alpha) * ground - alpha * at_zero
    weighed = (design * weight[..., None]).flatten(0, 2).mT
    values = torch.linalg.solve(weighed @ design.flatten(0, 2), weighed @ rest.flatten())
    contrast = (estimator.foreground(chord, values) - ground).abs() * (weight > 0)
    std = ERROR * float(contrast.sum() / (weight > 0).sum().clamp_min(1))
    return Appearance(values=values, std=max(std, 1e-6), opacity_std=ERROR)
