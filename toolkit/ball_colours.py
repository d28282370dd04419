"""What a sharp ball's colours span: a plane through black, a line, or all of colour space.

Two pigments, all their mixtures and darker shades lie in one plane through black; one pigment and
its shades lie on a line, and so do black and white.
Source: Caglioti & Giusti 2007, section 3.2.3. Deviation: the plane is found robustly from the
pixels of a sharp picture, with its uncertainty.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from toolkit.ball_file import Colour
from toolkit.disc import BallView
from toolkit.errors import CalibrationError

Kind = Literal["plane", "line", "solid"]

RIM = 3.0
"""px inside the outline where pixels may be mixed with the background."""
MOST_PIXELS = 20_000
MIN_PIXELS = 50
DRAWS, DRAWN_FROM = 300, 3000
"""Planes through two pixels that are tried, and the pixels that judge them."""
MODEL_ERROR = 0.01
"""Share of its own brightness by which a real pixel leaves the plane: lenses, demosaicing."""
OUTLIER = 4.0
"""Standard deviations from the plane beyond which a pixel is another colour, or a highlight."""
MAX_OFF = 0.25
"""Share of such pixels beyond which the ball's colours lie in no plane."""
EXTREME = 0.08
"""Share of the pixels on either side that may lie beyond a pigment: highlights within the plane."""
MIN_HUE = math.radians(4)
"""Angle between two pigments below which they cannot be told apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallColours:
    """The colours of a ball's pixels, linear R,G,B, sensor white = 1."""

    kind: Kind
    mean: Colour  # over the disc
    pigments: tuple[Colour, ...]  # two in a plane, the mean of a line, none where all is spanned
    normal: Colour | None  # unit, of the plane through black; None where there is no plane
    normal_std: float | None  # radian
    off: float  # share of the pixels that are neither: highlights, a third colour


def learn_colours(views: Sequence[BallView]) -> BallColours:
    """Learn a ball's colours from one or several sharp views, together.

    Raises:
        CalibrationError: when too few pixels are well exposed, or all are black.
    """
    seen = [ball_pixels(view) for view in views]
    return fit_plane(torch.cat([light for light, _ in seen]), torch.cat([var for _, var in seen]))


def ball_pixels(view: BallView) -> tuple[Tensor, Tensor]:
    """Give the light of the disc's pixels and its variance, [N, 3] each; white ones are left out.

    Args:
        view: where the ball is.
    """
    image, disc = view.image, view.disc
    y, x = torch.meshgrid(torch.arange(image.height), torch.arange(image.width), indexing="ij")
    rho = torch.linalg.vector_norm(disc.to_unit(torch.stack([x, y], dim=-1).double()), dim=-1)
    usable = (rho < 1 - RIM / disc.semi_axes[1]) & ~image.clipped[0, 0]
    light = image.rgb[0][:, usable].mT.double()
    light = light[:: max(1, len(light) // MOST_PIXELS)]
    read, gain = (v.double().reshape(3) for v in (view.noise.read_variance, view.noise.gain))
    return light, read + gain * light.clamp_min(0)


def fit_plane(light: Tensor, variance: Tensor) -> BallColours:
    """Fit the plane through black that most pixels lie in, and the two pigments that span it.

    Args:
        light: of the ball's pixels, linear [N, 3] float64.
        variance: of each [N, 3].

    Raises:
        CalibrationError: when there are fewer than 50 pixels, or all are black.
    """
    mean = light.mean(0) if len(light) else torch.zeros(3, dtype=torch.float64)
    noise = float(variance.mean().sqrt()) if len(light) else 0.0
    if len(light) < MIN_PIXELS or float(mean.norm()) < 2 * noise:
        raise CalibrationError(
            f"the ball's colours cannot be told: {len(light)} of its pixels are well exposed and "
            f"their mean is {float(mean.norm()):.3g} of white; expose so that the ball is bright"
        )
    normal, weight = _refine(_draw_plane(light, variance), light, variance)
    is_near = weight > 0
    off_plane = 1 - float(is_near.double().mean())
    pigments, is_on_line = _pigments(light[is_near], variance[is_near], normal)
    colour = _colour(mean)
    if off_plane > MAX_OFF:
        return BallColours(
            kind="solid", mean=colour, pigments=(), normal=None, normal_std=None, off=off_plane
        )
    if len(pigments) < 2:
        off = 1 - float(is_on_line.double().sum()) / len(light)
        return BallColours(
            kind="line", mean=colour, pigments=(colour,), normal=None, normal_std=None, off=off
        )
    return BallColours(
        kind="plane",
        mean=colour,
        pigments=pigments,
        normal=_colour(normal),
        normal_std=_normal_std(normal, light[is_near], weight[is_near]),
        off=off_plane,
    )


def share_off(colours: BallColours, light: Tensor, variance: Tensor) -> float:
    """Give the share of pixels [N, 3] that lie off what a ball's colours span; 0 where that is all.

    Args:
        colours: of the ball.
        light: of the pixels, linear [N, 3] float64.
        variance: of each [N, 3].
    """
    if colours.normal is not None:
        squared = _squared(light, variance, torch.tensor([colours.normal]).double())[:, 0]
        return float((squared > OUTLIER**2).double().mean())
    if colours.kind == "solid":
        return 0.0
    length = torch.linalg.vector_norm(light, dim=-1).clamp_min(1e-9)
    mean = torch.tensor(colours.mean).double()
    angle = torch.acos((light @ mean / length / mean.norm()).clamp(-1, 1))
    std = ((variance.mean(-1) + _model_variance(light)).sqrt() / length).clamp_max(math.pi)
    # off in either of two directions, so a little further than in one
    return float((angle > OUTLIER * std + MIN_HUE / 2).double().mean())


def _draw_plane(light: Tensor, variance: Tensor) -> Tensor:
    """Give the normal of the best of many planes through black and two pixels, [3]."""
    generator = torch.Generator().manual_seed(0)
    few = torch.randperm(len(light), generator=generator)[:DRAWN_FROM]
    drawn = few[torch.randint(len(few), (2, DRAWS), generator=generator)]
    across = torch.linalg.cross(light[drawn[0]], light[drawn[1]])
    # of colours that are all alike any plane through them serves
    normals = across / torch.linalg.vector_norm(across, dim=-1, keepdim=True).clamp_min(1e-12)
    cost = (_squared(light[few], variance[few], normals) / OUTLIER**2).clamp_max(1).mean(0)
    is_plane = torch.linalg.vector_norm(normals, dim=-1) > 0.5
    best: Tensor = normals[torch.where(is_plane, cost, torch.inf).argmin()]
    return best


def _squared(light: Tensor, variance: Tensor, normals: Tensor) -> Tensor:
    """Give the squared distance of N pixels from M planes over its variance, [N, M]."""
    distance2 = (light @ normals.mT) ** 2
    return distance2 / (variance @ (normals**2).mT + _model_variance(light)[:, None])


def _model_variance(light: Tensor) -> Tensor:
    return (MODEL_ERROR**2) * (light**2).sum(-1)


def _refine(normal: Tensor, light: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Fit the plane by reweighted eigenvectors: its normal [3] and each pixel's weight [N]."""
    weight = torch.ones(len(light), dtype=light.dtype)
    for _ in range(10):
        off = _squared(light, variance, normal[None])[:, 0] / OUTLIER**2
        precision = 1 / (variance @ (normal**2) + _model_variance(light))
        weight = precision * (1 - off).clamp_min(0) ** 2
        # the smallest eigenvector; noise that is alike in all channels does not turn it
        moments = (weight[:, None] * light).mT @ light
        found = torch.linalg.eigh(moments).eigenvectors[:, 0]
        turned = float((found @ normal).abs())
        normal = found * (1 if float(found.sum()) >= 0 else -1)
        if turned > 1 - 1e-12:
            break
    return normal, weight


def _pigments(light: Tensor, variance: Tensor, normal: Tensor) -> tuple[tuple[Colour, ...], Tensor]:
    """Give the extreme colours of the plane, and which pixels lie on the line of the usual one.

    Only one colour is given where the extremes cannot be told apart.
    """
    ahead = light.mean(0) - (light.mean(0) @ normal) * normal
    ahead = ahead / ahead.norm()
    aside = torch.linalg.cross(normal, ahead)
    hue = torch.atan2(light @ aside, light @ ahead)
    length = torch.linalg.vector_norm(light, dim=-1).clamp_min(1e-9)
    # dark pixels tell little of their hue
    std = ((variance.mean(-1) + _model_variance(light)).sqrt() / length).clamp_max(math.pi)
    clear = std <= std.median().clamp_min(MIN_HUE / 2)
    usual = hue[clear].median()
    is_on_line = (hue - usual).abs() < OUTLIER * std + MIN_HUE / 2
    ends = [_typical(hue[clear], std[clear], share) for share in (EXTREME, 1 - EXTREME)]
    blurred = 2 * 1.6 * float(std[clear].median())  # noise alone parts the quantiles by so much
    apart = float(ends[1][0] - ends[0][0])
    if apart < max(MIN_HUE, blurred):
        return (_colour(light.mean(0)),), is_on_line
    chosen = [light[clear][near].mean(0) for _, near in ends]
    return tuple(_colour(light_ - (light_ @ normal) * normal) for light_ in chosen), is_on_line


def _typical(hue: Tensor, std: Tensor, share: float) -> tuple[Tensor, Tensor]:
    """Give the usual hue near a quantile, and which pixels it is the mean of."""
    end = hue.quantile(share)
    near = (hue - end).abs() <= 2 * std + MIN_HUE / 8
    near = near if bool(near.any()) else hue == hue[(hue - end).abs().argmin()]
    return hue[near].median(), near


def _normal_std(normal: Tensor, light: Tensor, weight: Tensor) -> float:
    """Give the standard deviation of the normal's direction, radian, from the misfit found."""
    distance = light @ normal
    scale = float((weight * distance**2).sum() / max(len(light) - 2, 1))
    moments = torch.linalg.eigvalsh((weight[:, None] * light).mT @ light)[1:]
    return math.sqrt(max(scale, 1e-12) * float((1 / moments.clamp_min(1e-12)).sum()))


def _colour(values: Tensor) -> Colour:
    r, g, b = values.tolist()
    return r, g, b
