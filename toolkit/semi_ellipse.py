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
NEXT_TO_NOTHING = 1e-30
"""Roots of it take torch a tenth of the time of those of 0, which most offsets would have."""


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
    share, reach = (offset - centre) / half_width, half_window / half_width
    # the window's upper and lower edge in one tensor: half as many operations
    s = torch.stack([share + reach, share - reach]).clamp(-1, 1)
    squared = 1 - s * s
    height = squared.clamp_min(NEXT_TO_NOTHING).sqrt()
    cube = squared * height
    even = _between(s * height + torch.asin(s)) / 2  # integral of sqrt(1 - s^2)
    lean = -_between(cube) / 3  # of s sqrt(1 - s^2)
    area = even + skew * lean
    factor = 1 + skew * s
    if isinstance(bend, Tensor):
        squares = (even - _between(s * cube)) / 4
        bow = 4 / 3 * squares + even / 6  # of (8 s^2 + 1) / 6
        area = area + bend**2 * bow
        factor = factor + bend**2 * (8 * s * s + 1) / 6
    rise = height * factor
    per_window = 1 / (2 * half_window)
    alpha_per_opacity = half_width * per_window * area
    alpha = opacity * alpha_per_opacity
    scale = opacity * per_window
    J_centre = -scale * _between(rise)
    J_half_width = scale * (area - _between(s * rise))
    J_blur = (WINDOW_PER_BLUR / 2) * (scale * (rise[0] + rise[1]) - alpha / half_window)
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


def _between(integral: Tensor) -> Tensor:
    """Give an integral between the lower and the upper edge of the window [2, ...]."""
    return integral[0] - integral[1]
