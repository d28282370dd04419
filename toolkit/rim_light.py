"""The light of a sharp ball up to its rim, read from the pixels there that hold background too."""

import math

import torch
from torch import Tensor

from toolkit.disc import BallView
from toolkit.rim import (
    FINE,
    STEP,
    directions,
    find_rim,
    inner_light,
    rim_radius,
    sample_light,
    sample_variance,
    unit_vectors,
)

RIM = 2.5
"""px inside the outline whose light is mixed with the background."""
BAND_SHARE, BAND_LEAST = 0.06, 2.5
"""Width of the band of unmixed light that is fitted too: share of the radius, and px."""
LEAST_ALPHA, DISTURBED_ALPHA = 0.5, 0.97
"""Opacity down to which mixed light is used: beyond, errors of the outline rule; and where
something else than the background, as a shadow, is seen beside the ball."""
WINDOW = 0.1
"""Radians along the rim, standard deviation, over which the light's fit is shared."""
BLUR, LEAST_BLUR, MOST_BLUR = 0.9, 0.5, 2.0
"""px, of the transition from ball to background, samples interpolated: usual, least and most."""
CURVED = 0.3
"""Standard deviation of the light's curvature in the facing part of the normal, a prior."""
MISFIT = 12.0
"""Variance of a direction's light about the fit, over that of noise, which tells of a pattern."""


def fit_rim_light(view: BallView) -> tuple[Tensor, Tensor]:
    """Fit the light near the rim by what a blurred outline shows of it before the background.

    Along a ray the picture is background + blurred (opacity times (light - background)), which is
    linear in light = p + q f + r f^2, f = sqrt(1 - rho^2): the part of the normal that faces the
    camera; its square stands for the part across. Neighbouring directions share their fit. Where a
    pattern spoils that, `inner_light` is taken. [derived]

    Returns:
        Angles on the unit disc [D] and coefficients p, q, r there, [D, 3, 3 channels].
    """
    angle = directions(view.disc)
    design, contrast, variance = _read(view, angle)
    # a black pixel of a picture without noise has none
    weight = 1 / variance.clamp_min(1e-9)
    normal = torch.einsum("dsi,dsj,dsc->dcij", design, design, weight)
    pull = torch.einsum("dsi,dsc->dci", design, weight * contrast)
    shared = _shares(angle)
    own = torch.einsum("de,ecij->dcij", shared, normal)
    own = own + torch.tensor([1e-6, 1e-6, CURVED**-2]).to(own).diag()
    coefficients = torch.linalg.solve(own, torch.einsum("de,eci->dci", shared, pull)).mT
    misfit = ((contrast - design @ coefficients) ** 2 * weight).mean((1, 2))
    plain = inner_light(view.image, view.noise, view.disc, angle, RIM)
    plain = torch.nn.functional.pad(plain, (0, 0, 0, 1))
    return angle, torch.where((misfit < MISFIT)[:, None, None], coefficients, plain)


def _read(view: BallView, angle: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give what a unit of each coefficient adds [D, S, 3], what is seen of it, its variance.

    The latter two are [D, S, 3 channels].
    """
    blur, is_disturbed = transition(view)
    radius = rim_radius(view.disc, angle)[:, None]
    width = max(BAND_SHARE * float(radius.max()), BAND_LEAST)
    place = torch.arange(-RIM - width, 2 * blur, STEP, dtype=angle.dtype)
    fine = torch.arange(float(place[0]) - 4 * blur, float(place[-1]) + 4 * blur, FINE).to(angle)
    kernel = torch.exp(-0.5 * ((place[:, None] - fine) / blur) ** 2)
    kernel = kernel / kernel.sum(1, keepdim=True)
    # a blurred disc has its half height a little inside its rim
    is_ball = ((-(blur**2) / (2 * radius) - fine) / FINE + 0.5).clamp(0, 1)
    facing = (1 - (1 + fine / radius) ** 2).clamp_min(0).sqrt()
    basis = torch.stack([torch.ones_like(facing), facing, facing**2], dim=-1)
    design = torch.einsum("su,du,dui->dsi", kernel, is_ball, basis)
    points = view.disc.from_unit(unit_vectors(angle)[:, None] * (1 + place / radius)[..., None])
    seen, _ = sample_light(view.image, points)
    behind, _ = sample_light(view.background, points)
    clear = 1 - design[..., :1]
    variance = sample_variance(view.noise, seen, 1.0)
    variance = variance + clear**2 * sample_variance(view.noise, behind, 1 / view.background.frames)
    least = torch.where(is_disturbed, DISTURBED_ALPHA, LEAST_ALPHA)[:, None, None]
    is_usable = design[..., :1] > least
    return design, seen - clear * behind, torch.where(is_usable, variance, torch.inf)


def transition(view: BallView) -> tuple[float, Tensor]:
    """Give the standard deviation of the transition from ball to background, px.

    And where it is disturbed, or not told from the background, [D] bool.
    """
    rim = find_rim(view.image, view.background, view.noise, view.disc, BLUR)
    spread = rim.spread[torch.isfinite(rim.spread)]
    usual = float(spread.median()) if len(spread) else BLUR**2
    blur = min(max(math.sqrt(max(usual, 0.0)), LEAST_BLUR), MOST_BLUR)
    return blur, torch.isinf(rim.variance)


def _shares(angle: Tensor) -> Tensor:
    """Give how much each direction takes from every other, [D, D]."""
    apart = torch.remainder(angle[:, None] - angle + math.pi, math.tau) - math.pi
    return torch.exp(-0.5 * (apart / WINDOW) ** 2)
