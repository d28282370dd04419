"""The rim of a sharp ball: where it lies in every direction, and the light just inside of it."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.types import LinearImage, NoiseModel

STEP = 0.5
"""px between the samples along a ray."""
CORRELATION = 2.0
"""Samples half a pixel apart, interpolated: a sum of them has about twice the variance."""
INNER_SHARE, INNER_LEAST = 0.1, 3.5
"""Width of the band from which the light at the rim is extended: share of the radius, and px."""
NEAREST = 1.0
"""px of the same band that are believed alone where it holds the edge of a pattern."""
MISFIT = 4.0
"""Variance of the band's light about its fit, over that of noise, which tells of such an edge."""
INSIDE = 2.5
"""px inwards at which the ball's light is looked up in the first search."""
MAX_OUTSIDE = 0.08
"""Opacity beyond the rim from which a direction counts as disturbed: a shadow, a stand."""
MIN_CONTRAST = 4.0
"""Contrast at the rim over its standard deviation, summed over channels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rim:
    """What was found in D directions about the disc's centre."""

    angle: Tensor  # [D] radians, on the unit disc
    shift: Tensor  # [D] px, of the rim from that of the disc, outwards
    variance: Tensor  # [D] px^2, infinite where nothing can be told
    spread: Tensor  # [D] px^2, variance of the transition from ball to background


def directions(disc: Disc) -> Tensor:
    """Give angles about a pixel apart along the rim, [D] float64."""
    count = int(min(max(math.tau * disc.semi_axes[0], 64), 720))
    return torch.arange(count, dtype=torch.float64) * (math.tau / count)


def inner_light(
    image: LinearImage, noise: NoiseModel, disc: Disc, angle: Tensor, depth: float
) -> Tensor:
    """Extend the light inside the disc to the rim, along rays from its centre.

    Along a ray the light of a matt ball is linear in the part of the surface normal that points to
    the camera, sqrt(1 - rho^2), since the part across hardly changes near the rim. Where the edge
    of a pattern spoils that, the light nearest to the rim is taken as it is. [derived]

    Args:
        image: the ball, B = 1.
        noise: of the picture.
        disc: where it is.
        angle: of the rays on the unit disc [D].
        depth: px inside the rim where the pixels are free of background.

    Returns:
        Light at the rim, and its rise with sqrt(1 - rho^2), [D, 2, 3].
    """
    radius = rim_radius(disc, angle)[:, None]
    width = (INNER_SHARE * radius).clamp_min(INNER_LEAST)
    steps = torch.linspace(0, 1, 1 + math.ceil(float(width.max()) / STEP), dtype=angle.dtype)
    rho = (1 - (depth + width * steps) / radius).clamp_min(0)
    light, _ = _sample(image, disc, angle, rho)
    facing = (1 - rho**2).sqrt()
    mean_facing, mean = facing.mean(1, keepdim=True), light.mean(1, keepdim=True)
    away = (facing - mean_facing)[..., None]
    rise = (away * (light - mean)).sum(1) / (away**2).sum(1)
    fitted = mean + away * rise[:, None]
    misfit = ((light - fitted) ** 2 / _variance(noise, light, 1.0)).mean((1, 2))
    nearest = light[:, : 1 + round(NEAREST / STEP)].mean(1)
    is_smooth = (misfit < MISFIT)[:, None]
    at_rim = torch.where(is_smooth, mean[:, 0] - rise * mean_facing, nearest)
    return torch.stack([at_rim, torch.where(is_smooth, rise, 0)], dim=1)


def search_rim(
    image: LinearImage, background: LinearImage, noise: NoiseModel, disc: Disc, reach: float
) -> Rim:
    """Find the rim of an unknown pattern to about a pixel, within `reach` px of that of `disc`.

    It is the outermost place where half of the light found a little further inside remains.
    """
    angle = directions(disc)
    radius = rim_radius(disc, angle)[:, None]
    offset = torch.arange(-reach - INSIDE, reach + STEP / 2, STEP, dtype=angle.dtype)
    seen, _ = _sample(image, disc, angle, 1 + offset / radius)
    empty, _ = _sample(background, disc, angle, 1 + offset / radius)
    whitened = (seen - empty) / _variance(noise, seen, 1 + 1 / background.frames).sqrt()
    lag = round(INSIDE / STEP)
    change, inside = whitened[:, lag:], whitened[:, :-lag]
    energy = (inside**2).sum(-1)
    is_ball = ((change * inside).sum(-1) > energy / 2) & (energy > MIN_CONTRAST**2)
    last = is_ball.shape[1] - 1 - is_ball.flip(1).int().argmax(1)
    found = is_ball.any(1) & (last < is_ball.shape[1] - 1) & (last > 0)
    return Rim(
        angle=angle,
        shift=offset[lag:][last] + STEP / 2,
        variance=torch.where(found, 0.5, torch.inf).double(),
        spread=torch.ones_like(angle),
    )


def find_rim(
    image: LinearImage,
    background: LinearImage,
    noise: NoiseModel,
    disc: Disc,
    reach: float,
) -> Rim:
    """Find the rim near that of `disc` in every direction, from the area under the mixed pixels.

    With alpha the share of the ball in a pixel, the radius r satisfies r^2 = rho0^2 + 2 integral of
    alpha rho over the mixed zone, whatever the lens's blur. [derived]

    Args:
        image: the ball, B = 1.
        background: the same view without it, in the same light.
        noise: of one picture.
        disc: roughly right.
        reach: px on either side of its rim that hold the transition.
    """
    angle = directions(disc)
    radius = rim_radius(disc, angle)[:, None]
    outer = max(3.0, reach)
    offset = torch.arange(-reach, reach + outer + STEP / 2, STEP, dtype=angle.dtype)
    rho = 1 + offset / radius
    seen, is_clipped = _sample(image, disc, angle, rho)
    empty, is_empty_clipped = _sample(background, disc, angle, rho)
    light = inner_light(image, noise, disc, angle, reach)
    facing = (1 - rho**2).clamp_min(0).sqrt()
    ball = light[:, None, 0] + facing[..., None] * light[:, None, 1]
    variance = _variance(noise, (seen + empty) / 2, 1 + 1 / background.frames)
    contrast = ball - empty
    information = (contrast**2 / variance).sum(-1)
    alpha = (contrast * (seen - empty) / variance).sum(-1) / information.clamp_min(1e-9)
    mixed = offset <= reach
    usable = (
        (information.sqrt().amin(1) > MIN_CONTRAST)
        & _is_free_outside(alpha[:, ~mixed], information[:, ~mixed])
        & ~(is_clipped | is_empty_clipped).any(1)
    )
    shift, spread = _moments(alpha[:, mixed], offset[mixed], radius)
    # the light extended to the rim is about as uncertain as one sample, and common to all of them
    shift_variance = CORRELATION * STEP**2 * (1 / information[:, mixed]).sum(1)
    shift_variance = shift_variance + (reach**2 / information[:, mixed]).mean(1)
    usable &= shift.abs() < reach
    return Rim(
        angle=angle,
        shift=shift,
        variance=torch.where(usable, shift_variance, torch.inf),
        spread=spread,
    )


def _moments(alpha: Tensor, offset: Tensor, radius: Tensor) -> tuple[Tensor, Tensor]:
    """Give the rim's offset and the variance of its transition, [D], from alpha [D, S]."""
    weight = torch.full_like(offset, STEP)
    weight[[0, -1]] = STEP / 2  # trapezoid
    start = radius[:, 0] + offset[0]
    area = (weight * alpha * (radius + offset)).sum(1)
    shift = (start**2 + 2 * area).clamp_min(0).sqrt() - radius[:, 0]
    # of a step at `shift` the integral of 2 (u - shift) alpha is -(shift - start)^2; blur adds its
    # variance
    moment = 2 * (weight * alpha * (offset - shift[:, None])).sum(1)
    return shift, moment + (shift - offset[0]) ** 2


def _is_free_outside(alpha: Tensor, information: Tensor) -> Tensor:
    """Tell where nothing but background is seen beyond the rim, [D]."""
    mean = alpha.mean(1).abs()
    std = (CORRELATION / information).mean(1).div(alpha.shape[1]).sqrt()
    return mean < MAX_OUTSIDE + 3 * std


def _variance(noise: NoiseModel, level: Tensor, share: float) -> Tensor:
    """Give the variance of a difference of two pictures at a level [..., 3]."""
    read, gain, density = (
        v.to(level).reshape(3) for v in (noise.read_variance, noise.gain, noise.density)
    )
    return (read + gain * level.clamp_min(0)) * share / density


def rim_radius(disc: Disc, angle: Tensor) -> Tensor:
    """Give the distance from the centre to the rim, px [D], in directions of the unit disc."""
    rim = disc.from_unit(_unit(angle)) - torch.tensor(disc.centre, dtype=angle.dtype)
    length: Tensor = torch.linalg.vector_norm(rim, dim=-1)
    return length


def _unit(angle: Tensor) -> Tensor:
    return torch.stack([angle.cos(), angle.sin()], dim=-1)


def _sample(image: LinearImage, disc: Disc, angle: Tensor, rho: Tensor) -> tuple[Tensor, Tensor]:
    """Give the light [D, S, 3] and whether it met white [D, S] at places of the unit disc."""
    points = disc.from_unit(_unit(angle)[:, None] * rho[..., None])
    return sample_light(image, points)


def sample_light(image: LinearImage, points: Tensor) -> tuple[Tensor, Tensor]:
    """Interpolate a picture between its pixels.

    Args:
        image: B = 1.
        points: [..., 2] px; beyond the border the picture goes on as it is there.

    Returns:
        Light [..., 3] in the points' type, and whether a pixel beside met white [...] bool.
    """
    size = torch.tensor([image.width - 1, image.height - 1], dtype=points.dtype)
    at = torch.minimum(points.clamp_min(0), size)
    low = torch.minimum(at.floor(), (size - 1).clamp_min(0))
    share = (at - low)[..., None]
    x, y = low.long().unbind(-1)
    right, below = (x + 1).clamp_max(image.width - 1), (y + 1).clamp_max(image.height - 1)
    light, clipped = image.rgb[0].movedim(0, -1), image.clipped[0, 0]
    top = light[y, x] * (1 - share[..., 0, :]) + light[y, right] * share[..., 0, :]
    bottom = light[below, x] * (1 - share[..., 0, :]) + light[below, right] * share[..., 0, :]
    met_white = clipped[y, x] | clipped[y, right] | clipped[below, x] | clipped[below, right]
    return top * (1 - share[..., 1, :]) + bottom * share[..., 1, :], met_white
