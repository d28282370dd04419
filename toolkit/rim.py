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
FINE = 0.25
"""px between the places at which the unblurred light is known."""
REACH_SPREADS, MIN_REACH, OUTSIDE = 2.5, 2.2, 3.0
"""Half width of the zone that holds the transition, in standard deviations of it and in px at
least, and the px beyond it in which background must be seen."""
STEPS = 4
SPREAD_PRIOR = 0.1
"""Weight of the common blur in each direction's own, 1 / px^4."""
USUAL_MISFIT = 2.0
"""Chi-square per sample above which a direction counts for less."""
MIN_INFORMATION = 4.0
"""1 / px^2: the rim is known to half a pixel."""
SEARCHED_STD, AGREEMENT = 0.5, 0.5
"""px: error of the first search, and how far from it a fitted rim may lie."""
INSIDE = 2.5
"""px inwards at which the ball's light is looked up in the first search."""
MAX_OUTSIDE = 0.05
"""Opacity beyond the rim from which a direction counts as disturbed: a shadow, a stand."""
MIN_CONTRAST = 4.0
"""Contrast at the rim over its standard deviation, summed over channels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rim:
    """What was found in D directions about the disc's centre."""

    angle: Tensor  # [D] radians, on the unit disc
    shift: Tensor  # [D] px, of the rim from that of the disc, outwards
    variance: Tensor  # [D] px^2, infinite where nothing can be told
    spread: Tensor  # [D] px^2, variance of the transition; NaN where that is not known


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
    misfit = ((light - fitted) ** 2 / sample_variance(noise, light, 1.0)).mean((1, 2))
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
    whitened = (seen - empty) / sample_variance(noise, seen, 1 + 1 / background.frames).sqrt()
    lag = round(INSIDE / STEP)
    change, inside = whitened[:, lag:], whitened[:, :-lag]
    energy = (inside**2).sum(-1)
    remains = (change * inside).sum(-1) / energy.clamp_min(1e-9)
    is_ball = (remains > 0.5) & (energy > MIN_CONTRAST**2)
    last = is_ball.shape[1] - 1 - is_ball.flip(1).int().argmax(1)
    found = is_ball.any(1) & (last < is_ball.shape[1] - 1) & (last > 0)
    row, following = torch.arange(len(angle)), (last + 1).clamp_max(is_ball.shape[1] - 1)
    above, below = remains[row, last], remains[row, following]
    share = ((above - 0.5) / (above - below).clamp_min(1e-9)).clamp(0, 1)
    return Rim(
        angle=angle,
        shift=offset[lag:][last] + STEP * share,
        variance=torch.where(found, SEARCHED_STD**2, torch.inf).double(),
        spread=torch.full_like(angle, torch.nan),
    )


def find_rim(
    image: LinearImage,
    background: LinearImage,
    noise: NoiseModel,
    disc: Disc,
    blur: float,
) -> Rim:
    """Find the rim near that of `disc` in every direction, by fitting the mixed pixels.

    Along a ray the picture is background + blurred (step at the rim times (ball - background)); the
    step's place and the blur's variance are fitted in each direction. [derived]

    Args:
        image: the ball, B = 1.
        background: the same view without it, in the same light.
        noise: of one picture.
        disc: right to about a pixel.
        blur: rough standard deviation of the transition, px.
    """
    angle = directions(disc)
    zone = _read_zone(image, background, noise, disc, angle, blur)
    fit = _fit_steps(zone)
    # a blurred disc has its half height a little inside its rim
    shift = fit.shift + blur**2 / (2 * rim_radius(disc, angle))
    usable = (
        (fit.information > MIN_INFORMATION)
        & (_alpha_outside(zone, fit.residual) < MAX_OUTSIDE)
        & (shift.abs() < zone.reach)
        & zone.is_exposed
    )
    # a pattern's edge in the zone shows as misfit, and then little is known about the rim
    variance = (fit.chi2 / USUAL_MISFIT).clamp_min(1) ** 4 / fit.information
    # where the pattern's edge hid just inside the rim, the search saw it and the fit did not
    searched = search_rim(image, background, noise, disc, zone.reach)
    is_believed = usable & ((shift - searched.shift).abs() < AGREEMENT)
    is_believed &= variance < searched.variance
    otherwise = torch.where(usable, searched.variance, torch.inf)
    return Rim(
        angle=angle,
        shift=torch.where(is_believed, shift, searched.shift),
        variance=torch.where(is_believed, variance, otherwise),
        spread=torch.where(is_believed, fit.spread, torch.nan),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Zone:
    """What is seen near the rim, D directions: S places that are seen, U where light is known."""

    place: Tensor  # [S] px outwards of the disc's rim
    fine: Tensor  # [U] px, the same, closer together
    reach: float  # px on either side of the rim that hold the transition
    blur: float  # px, rough standard deviation of the transition
    change: Tensor  # [D, S, 3] picture minus background
    variance: Tensor  # [D, S, 3] of it, as if the samples were independent
    contrast: Tensor  # [D, U, 3] ball minus background
    is_exposed: Tensor  # [D] bool, False where a pixel met white


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """Rims fitted in D directions."""

    shift: Tensor  # [D] px
    spread: Tensor  # [D] px^2
    information: Tensor  # [D] 1 / variance of the shift, if nothing but noise disturbs
    residual: Tensor  # [D, S, 3] with the common blur
    chi2: Tensor  # [D] per sample, with each direction's own blur


def _read_zone(
    image: LinearImage,
    background: LinearImage,
    noise: NoiseModel,
    disc: Disc,
    angle: Tensor,
    blur: float,
) -> _Zone:
    """Read both pictures near the rim, and extend the ball's light to it from inside."""
    radius = rim_radius(disc, angle)[:, None]
    reach = max(MIN_REACH, REACH_SPREADS * blur)
    place = torch.arange(-reach, reach + OUTSIDE + STEP / 2, STEP, dtype=angle.dtype)
    seen, is_clipped = _sample(image, disc, angle, 1 + place / radius)
    empty, is_empty_clipped = _sample(background, disc, angle, 1 + place / radius)
    fine = torch.arange(float(place[0]) - 4 * blur, float(place[-1]) + 4 * blur, FINE).to(angle)
    behind, _ = _sample(background, disc, angle, 1 + fine / radius)
    light = inner_light(image, noise, disc, angle, reach)
    facing = (1 - (1 + fine / radius) ** 2).clamp_min(0).sqrt()[..., None]
    return _Zone(
        place=place,
        fine=fine,
        reach=reach,
        blur=blur,
        change=seen - empty,
        variance=CORRELATION
        * sample_variance(noise, (seen + empty) / 2, 1 + 1 / background.frames),
        contrast=light[:, None, 0] + facing * light[:, None, 1] - behind,
        is_exposed=~(is_clipped | is_empty_clipped).any(1),
    )


def _fit_steps(zone: _Zone) -> _Fit:
    """Fit the place of a blurred step, and the variance of its blur, in each direction."""
    shift = torch.zeros(len(zone.change), dtype=zone.change.dtype)
    prior = torch.tensor([1e-9, SPREAD_PRIOR]).to(shift).diag()
    for _ in range(STEPS):
        model, J = _step_model(zone, shift)
        residual = zone.change - model
        normal = (J[:, :, None] * J[:, None] / zone.variance[:, None, None]).sum((-2, -1)) + prior
        pull = (J * (residual / zone.variance)[:, None]).sum((-2, -1))
        step = torch.linalg.solve(normal, pull[..., None])[..., 0]
        shift = (shift + step[:, 0].clamp(-1, 1)).clamp(-zone.reach, zone.reach)
    unexplained = residual - J[:, 1] * step[:, 1, None, None]
    return _Fit(
        shift=shift,
        spread=zone.blur**2 + step[:, 1],
        information=normal[:, 0, 0],
        residual=residual,
        chi2=(unexplained**2 / zone.variance).mean((1, 2)),
    )


def _step_model(zone: _Zone, shift: Tensor) -> tuple[Tensor, Tensor]:
    """Give what a ball with its rim at `shift` px [D] adds [D, S, 3], and derivatives [D, 2, S, 3].

    They are in the shift and in the variance of the blur there.
    """
    kernel = torch.exp(-0.5 * ((zone.place[:, None] - zone.fine) / zone.blur) ** 2)
    kernel = kernel / kernel.sum(1, keepdim=True)
    is_ball = ((shift[:, None] - zone.fine) / FINE + 0.5).clamp(0, 1)
    model = torch.einsum("su,duc->dsc", kernel, is_ball[..., None] * zone.contrast)
    at = ((shift - zone.fine[0]) / FINE).round().long().clamp(0, len(zone.fine) - 1)
    z = (zone.place - shift[:, None]) / zone.blur
    density = torch.exp(-0.5 * z**2) / (math.sqrt(math.tau) * zone.blur)
    J_shift = density[..., None] * zone.contrast[torch.arange(len(shift)), at][:, None]
    return model, torch.stack([J_shift, J_shift * z[..., None] / (2 * zone.blur)], dim=1)


def _alpha_outside(zone: _Zone, residual: Tensor) -> Tensor:
    """Give how much beyond the rim looks like ball, less three standard deviations, [D]."""
    beyond = zone.place > zone.reach
    variance = zone.variance[:, beyond]
    usual = zone.contrast[:, zone.contrast.shape[1] // 2][:, None]
    information = (usual**2 / variance).sum((1, 2)).clamp_min(1e-9)
    alpha = (usual * residual[:, beyond] / variance).sum((1, 2)) / information
    return alpha.abs() - 3 / information.sqrt()


def sample_variance(noise: NoiseModel, level: Tensor, share: float) -> Tensor:
    """Give `share` of the variance of one picture at a level [..., 3]."""
    read, gain, density = (
        v.to(level).reshape(3) for v in (noise.read_variance, noise.gain, noise.density)
    )
    return (read + gain * level.clamp_min(0)) * share / density


def rim_radius(disc: Disc, angle: Tensor) -> Tensor:
    """Give the distance from the centre to the rim, px [D], in directions of the unit disc."""
    rim = disc.from_unit(unit_vectors(angle)) - torch.tensor(disc.centre, dtype=angle.dtype)
    length: Tensor = torch.linalg.vector_norm(rim, dim=-1)
    return length


def unit_vectors(angle: Tensor) -> Tensor:
    """Give the directions of angles [D], x and y [D, 2]."""
    return torch.stack([angle.cos(), angle.sin()], dim=-1)


def _sample(image: LinearImage, disc: Disc, angle: Tensor, rho: Tensor) -> tuple[Tensor, Tensor]:
    """Give the light [D, S, 3] and whether it met white [D, S] at places of the unit disc."""
    points = disc.from_unit(unit_vectors(angle)[:, None] * rho[..., None])
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
