"""The opacity across a streak: a semi-ellipse, averaged over the width of what smooths it.

A ball that crosses a line at constant speed covers the point y of it for a time proportional to its
chord there, so that alpha(y) = k sqrt(1 - ((y - c) / r)^2) inside the streak and 0 outside.
Source: Caglioti & Giusti 2007, eq. (2). Deviations: the two cases, exchanged in the paper's text,
stand the right way round; the slope is infinite at the edge, so the curve is averaged in closed
form over a window (pixel area, interpolation and lens together), whose standard deviation is the
`blur`.
"""

import math

import torch
from torch import Tensor

WINDOW_PER_BLUR = 2 * math.sqrt(3)
"""Width of the averaging window over its standard deviation."""


def semi_ellipse(
    offset: Tensor, centre: Tensor, half_width: Tensor, opacity: Tensor, blur: Tensor
) -> Tensor:
    """Give the opacity at each offset across the streak.

    Args:
        offset: px, broadcast against the rest.
        centre: c, px.
        half_width: r, px, positive.
        opacity: k, alpha at the centre of an unsmoothed profile.
        blur: standard deviation of the averaging window, px, positive.

    Returns:
        alpha, of the broadcast shape.
    """
    half_window = blur * (WINDOW_PER_BLUR / 2)
    upper = _area((offset + half_window - centre) / half_width)
    lower = _area((offset - half_window - centre) / half_width)
    return opacity * half_width * (upper - lower) / (2 * half_window)


def semi_ellipse_and_J(
    offset: Tensor, centre: Tensor, half_width: Tensor, opacity: Tensor, blur: Tensor
) -> tuple[Tensor, Tensor]:
    """Give `semi_ellipse`, and its derivatives in (centre, half_width, opacity, blur) [..., 4]."""
    half_window = blur * (WINDOW_PER_BLUR / 2)
    upper = ((offset + half_window - centre) / half_width).clamp(-1, 1)
    lower = ((offset - half_window - centre) / half_width).clamp(-1, 1)
    height_upper = (1 - upper * upper).sqrt()
    height_lower = (1 - lower * lower).sqrt()
    arc = (torch.asin(upper) - torch.asin(lower)) / 2
    moment = (upper * height_upper - lower * height_lower) / 2
    per_window = 1 / (2 * half_window)
    alpha_per_opacity = half_width * (arc + moment) * per_window
    alpha = opacity * alpha_per_opacity
    J_centre = opacity * (height_lower - height_upper) * per_window
    J_half_width = opacity * (arc - moment) * per_window
    J_half_window = opacity * (height_upper + height_lower) * per_window - alpha / half_window
    J_blur = J_half_window * (WINDOW_PER_BLUR / 2)
    columns = (J_centre, J_half_width, alpha_per_opacity, J_blur)
    return alpha, torch.stack([column.expand_as(alpha) for column in columns], dim=-1)


def start_from_moments(
    offset: Tensor, alpha: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Give a closed-form first guess of (centre, half_width, opacity) from the moments of alpha.

    Over the whole profile the mean of alpha is c, its variance r^2 / 4 and its area pi k r / 2.
    [derived]

    Args:
        offset: px, one sample a px on average [..., S].
        alpha: measured opacity [..., S].
        weight: 1 where a sample may be used, else 0 [..., S].
    """
    alpha = alpha * weight
    area = alpha.sum(-1).clamp_min(1e-6)
    centre = (alpha * offset).sum(-1) / area
    variance = (alpha * (offset - centre[..., None]) ** 2).sum(-1) / area
    half_width = 2 * variance.clamp_min(1.0).sqrt()
    return centre, half_width, 2 * area / (math.pi * half_width)


def _area(share: Tensor) -> Tensor:
    """Integral of sqrt(1 - s^2) from 0 to `share`, constant beyond the rim."""
    s = share.clamp(-1, 1)
    return (s * (1 - s * s).sqrt() + torch.asin(s)) / 2
