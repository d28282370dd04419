"""The opacity across a streak: a semi-ellipse, averaged over the width of what smooths it.

A ball that crosses a line at constant speed covers the point y of it for a time proportional to its
chord there, so that alpha(y) = k sqrt(1 - ((y - c) / r)^2) inside the streak and 0 outside.
Source: Caglioti & Giusti 2007, eq. (2). Deviations: the two cases, exchanged in the paper's text,
stand the right way round; the slope is infinite at the edge, so the curve is averaged in closed
form over a window (pixel area and lens together), whose standard deviation is the `blur`; and a
path that bends covers the points on the inner side for longer, which multiplies the semi-ellipse
by 1 + bend s + bend^2 (3/2 s^2 + (1 - s^2) / 6), with s = (y - c) / r and bend = r / (2 bending
radius): the arc 2 rho theta on a circle of radius rho, to second order in r / rho. [derived] The
linear term is a parameter of its own, `skew`, since shading of the ball leans the profile as well.
"""

import math

import torch
from torch import Tensor

WINDOW_PER_BLUR = 2 * math.sqrt(3)
"""Width of the averaging window over its standard deviation."""


def semi_ellipse(
    offset: Tensor,
    centre: Tensor,
    half_width: Tensor,
    opacity: Tensor,
    skew: Tensor,
    blur: Tensor,
    bend: Tensor | None = None,
) -> Tensor:
    """Give the opacity at each offset across the streak.

    Args:
        offset: px, broadcast against the rest.
        centre: c, px.
        half_width: r, px, positive.
        opacity: k, alpha at the centre of an unsmoothed profile.
        skew: relative rise of the opacity from the centre to the right edge, to first order.
        blur: standard deviation of the averaging window, px, positive.
        bend: half width over twice the path's bending radius; None where it is straight.

    Returns:
        alpha, of the broadcast shape.
    """
    return semi_ellipse_and_J(offset, centre, half_width, opacity, skew, blur, bend)[0]


def semi_ellipse_and_J(
    offset: Tensor,
    centre: Tensor,
    half_width: Tensor,
    opacity: Tensor,
    skew: Tensor,
    blur: Tensor,
    bend: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Give `semi_ellipse`, and its derivatives in (centre, ... blur), in their order [..., 5]."""
    half_window = blur * (WINDOW_PER_BLUR / 2)
    upper = ((offset + half_window - centre) / half_width).clamp(-1, 1)
    lower = ((offset - half_window - centre) / half_width).clamp(-1, 1)
    height_upper = (1 - upper * upper).sqrt()
    height_lower = (1 - lower * lower).sqrt()
    area_upper, area_lower = _area(upper, height_upper), _area(lower, height_lower)
    cube_upper, cube_lower = height_upper**2 * height_upper, height_lower**2 * height_lower
    lean = (cube_lower - cube_upper) / 3  # integral of s sqrt(1 - s^2)
    area = area_upper - area_lower + skew * lean
    factor_upper, factor_lower = 1 + skew * upper, 1 + skew * lower
    if isinstance(bend, Tensor):
        squares = (area_upper - area_lower - upper * cube_upper + lower * cube_lower) / 4
        bow = 4 / 3 * squares + (area_upper - area_lower) / 6  # of (8 s^2 + 1) / 6
        area = area + bend**2 * bow
        factor_upper = factor_upper + bend**2 * (8 * upper * upper + 1) / 6
        factor_lower = factor_lower + bend**2 * (8 * lower * lower + 1) / 6
    rise_upper, rise_lower = height_upper * factor_upper, height_lower * factor_lower
    per_window = 1 / (2 * half_window)
    alpha_per_opacity = half_width * area * per_window
    alpha = opacity * alpha_per_opacity
    scale = opacity * per_window
    J_centre = scale * (rise_lower - rise_upper)
    J_half_width = scale * (area - (upper * rise_upper - lower * rise_lower))
    J_half_window = scale * (rise_upper + rise_lower) - alpha / half_window
    J_blur = J_half_window * (WINDOW_PER_BLUR / 2)
    J_skew = scale * half_width * lean
    columns = (J_centre, J_half_width, alpha_per_opacity, J_skew, J_blur)
    return alpha, torch.stack([column.expand_as(alpha) for column in columns], dim=-2).mT


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


def _area(share: Tensor, height: Tensor) -> Tensor:
    """Integral of sqrt(1 - s^2) from 0 to `share`, where it has the given height."""
    return (share * height + torch.asin(share)) / 2
