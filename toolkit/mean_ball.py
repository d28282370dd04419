"""One ball of several sharp pictures of it, all in the same light."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.ball import SharpBall

DRAWS = 8
"""Of the errors of each picture's light."""


def mean_ball(balls: Sequence[SharpBall]) -> SharpBall:
    """Give the mean of what several pictures show of one ball, with light that it may have as well.

    The other lights have the spread of a mean: that which the pictures' own scatter tells, and that
    which each picture tells of itself. A caller that takes the mean of squares over all of them has
    both, weighted by how many there are.

    Args:
        balls: seen in the same light and turned alike, the one that gives the disc first.
    """
    if len(balls) == 1:
        return balls[0]
    size = max(ball.rgb.shape[-1] for ball in balls)
    lights = torch.stack([_resized(ball.rgb[None], size)[0] for ball in balls])
    mean = lights.mean(0)
    others = mean + (lights - mean) / math.sqrt(len(balls) - 1)
    if all(ball.others is not None for ball in balls):
        generator = torch.Generator().manual_seed(0)
        own = torch.stack([_resized(_drawn(ball, generator), size) for ball in balls]).mean(0)
        others = torch.cat([others, own])
    return replace(balls[0], rgb=mean, clipped=max(ball.clipped for ball in balls), others=others)


def _drawn(ball: SharpBall, generator: torch.Generator) -> Tensor:
    """Draw lights that a ball may have as well, each with all its errors [DRAWS, 3, N, N]."""
    if ball.others is None:
        return ball.rgb[None]
    amounts = torch.randn(DRAWS, len(ball.others), generator=generator)
    errors = (ball.others - ball.rgb) / math.sqrt(len(ball.others))
    return ball.rgb + torch.einsum("de,ecyx->dcyx", amounts, errors)


def _resized(light: Tensor, size: int) -> Tensor:
    """Lay out grids [D, 3, N, N] anew with `size` nodes along a side; the rim stays the rim."""
    if light.shape[-1] == size:
        return light
    return torch.nn.functional.interpolate(
        light, size=(size, size), mode="bilinear", align_corners=True
    )
