"""Backgrounds for rendered shots: the sharp scene behind the ball, [3, H, W] in linear light.

A texture is constant within each pixel; the lens blurs it later, together with the ball.
"""

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

Colour = tuple[float, float, float]

GREY: Colour = (0.3, 0.3, 0.3)


def flat_background(width: int, height: int, colour: Colour = GREY) -> Tensor:
    """Give a wall of one colour, [3, H, W]."""
    return torch.tensor(colour, dtype=torch.float32)[:, None, None].repeat(1, height, width)


def textured_background(
    width: int, height: int, *, colour: Colour = GREY, contrast: float = 0.1, seed: int = 0
) -> Tensor:
    """Give a smooth coloured texture with detail at every size from 2 px up.

    Args:
        width: columns.
        height: rows.
        colour: the mean.
        contrast: largest deviation from the mean in any channel.
        seed: equal seeds give equal textures.

    Returns:
        [3, H, W], never below zero.
    """
    generator = np.random.default_rng([seed, 101])
    octaves = max(2, int(math.log2(max(width, height))) - 1)
    texture = torch.zeros(1, 3, 1, 1)
    for octave in range(octaves, 0, -1):
        rows, columns = height // 2**octave + 2, width // 2**octave + 2
        lightness = generator.standard_normal((1, 1, rows, columns), dtype=np.float32)
        hue = generator.standard_normal((1, 3, rows, columns), dtype=np.float32)
        # finer detail is weaker, as in natural pictures
        texture = _enlarged(texture, rows, columns) + 2 ** (octave / 2) * torch.from_numpy(
            lightness + hue
        )
    texture = _enlarged(texture, height, width)
    texture = contrast * texture / texture.abs().max()
    return (flat_background(width, height, colour) + texture[0]).clamp_min(0)


def panelled_background(
    width: int, height: int, *, colour: Colour = GREY, contrast: float = 0.1, seed: int = 0
) -> Tensor:
    """Give a room's wall: upright panels of different shades over a floor, [3, H, W].

    Its edges are sharp.

    Args:
        width: columns.
        height: rows.
        colour: the mean.
        contrast: largest deviation from the mean in any channel.
        seed: equal seeds give equal walls.
    """
    generator = np.random.default_rng([seed, 102])
    panel = max(8, width // 12)
    shades = generator.uniform(-contrast, contrast, (3, width // panel + 1))
    wall = torch.from_numpy(np.repeat(shades, panel, axis=1)[:, :width].astype(np.float32))
    picture = flat_background(width, height, colour) + wall[:, None, :]
    picture[:, :, ::panel] = torch.tensor(colour)[:, None, None] - contrast
    skirting = int(0.8 * height)
    picture[:, skirting:] = torch.tensor(colour)[:, None, None] - contrast / 2
    picture[:, skirting : skirting + 3] = torch.tensor(colour)[:, None, None] + contrast
    return picture.clamp_min(0)


def checked_background(
    width: int, height: int, *, colour: Colour = GREY, contrast: float = 0.1, square: int = 16
) -> Tensor:
    """Give a checker of `colour` plus and minus `contrast` in squares of `square` px, [3, H, W]."""
    rows = torch.arange(height)[:, None] // square
    columns = torch.arange(width) // square
    sign = 1 - 2 * ((rows + columns) % 2).float()
    return (flat_background(width, height, colour) + contrast * sign).clamp_min(0)


def _enlarged(picture: Tensor, height: int, width: int) -> Tensor:
    return interpolate(picture, size=(height, width), mode="bicubic", align_corners=False)
