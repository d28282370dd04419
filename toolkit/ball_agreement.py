"""What several sharp pictures of a ball say of its colours and light, and which differ."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.ball_colours import (
    MAX_OFF,
    BallColours,
    ball_pixels,
    fit_plane,
    share_off,
)
from toolkit.ball_file import Colour
from toolkit.disc import BallView
from toolkit.errors import CalibrationError

OTHER_LIGHT = 0.05
"""Share of a ball's brightness by which a picture may differ from the others."""
OUTLIER = 4.0
"""Times their usual scatter by which it must differ besides."""
SAME_SHADE = 0.03
"""Share of a ball's brightness by which its shade may differ from place to place, rms."""
CELLS = 17
"""Of the disc along a diameter, over which shades are compared."""
INSIDE = 0.85
"""Share of the radius within which they are: beyond, the outline's own error rules."""

OTHER_COLOUR = "shows another colour than the others: another ball, or light of another colour"
NO_PLANE = "shows colours beside the plane of the others: another ball, or light of another colour"


@dataclass(frozen=True, slots=True, kw_only=True)
class ColoursTogether:
    """The colours that several pictures agree on."""

    colours: BallColours
    std: tuple[Colour, ...]  # of each pigment, as linear R,G,B
    contradicting: dict[int, str]  # pictures left out by their place, and why


@dataclass(frozen=True, slots=True, kw_only=True)
class LightTogether:
    """The pictures whose light of the ball may be averaged."""

    alike: tuple[int, ...]  # by their place, the one nearest to all others first
    std: float  # of their mean beyond noise, as a share of the ball's brightness, by their spread
    others: dict[int, float]  # by how much of that each other picture differs, rms


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """One picture's pixels and what they say alone."""

    light: Tensor  # [N, 3]
    variance: Tensor  # [N, 3]
    alone: BallColours


def learn_colours_together(views: Sequence[BallView]) -> ColoursTogether:
    """Learn a ball's colours from several pictures; what contradicts most of them is left out.

    Each picture may show other places of the ball, so that two pigments may show in one picture
    each. The uncertainty of a pigment is that of its pixels in one picture and, where several show
    it, the spread among them.

    Raises:
        CalibrationError: when a ball is too dark, or too few of its pixels are well exposed.
    """
    seen = [_see(view) for view in views]
    kept, reasons = list(range(len(seen))), dict[int, str]()
    while 2 * (len(kept) - 1) > len(seen):
        odd = _odd_one_out([seen[i] for i in kept])
        if odd is None:
            break
        reasons[kept.pop(odd[0])] = odd[1]
    agreed = [seen[i] for i in kept]
    colours = _together(agreed)
    if len(agreed) > 1 and colours.normal is not None:
        colours = replace(colours, normal_std=_normal_std(colours, agreed))
    return ColoursTogether(
        colours=colours, std=_pigment_std(colours, agreed), contradicting=reasons
    )


def same_light(views: Sequence[BallView]) -> LightTogether:
    """Tell which pictures show the ball equally lit and turned.

    Raises:
        CalibrationError: when two pictures show no place of the ball alike.
    """
    shades = [_shade(view) for view in views]
    apart = torch.tensor([[_difference(one, other) for other in shades] for one in shades])
    near = apart <= SAME_SHADE
    best = int((near.sum(1) - apart.mean(1).clamp_max(0.5)).argmax())
    group = near[best].nonzero()[:, 0].tolist()
    chosen = (best, *(i for i in group if i != best))
    # two pictures differ by twice the variance of one
    variance = apart[group][:, group].square().sum() / 2 / max(1, len(group) * (len(group) - 1))
    return LightTogether(
        alike=chosen,
        std=math.sqrt(float(variance) / len(group)),
        others={i: float(apart[best, i]) for i in range(len(views)) if i not in chosen},
    )


def _see(view: BallView) -> _Seen:
    light, variance = ball_pixels(view)
    return _Seen(light=light, variance=variance, alone=fit_plane(light, variance))


def _together(seen: Sequence[_Seen]) -> BallColours:
    return fit_plane(torch.cat([s.light for s in seen]), torch.cat([s.variance for s in seen]))


def _odd_one_out(seen: Sequence[_Seen]) -> tuple[int, str] | None:
    """Find the picture without which all others agree better, where there is one."""
    whole = _together(seen)
    rests = [_together([*seen[:i], *seen[i + 1 :]]) for i in range(len(seen))]
    off = [share_off(rest, s.light, s.variance) for rest, s in zip(rests, seen, strict=True)]
    worst = max(range(len(seen)), key=lambda i: off[i])
    alone, rest = seen[worst].alone, rests[worst]
    if off[worst] > MAX_OFF and rest.kind == "plane":
        return worst, NO_PLANE
    # one that shows a second colour and the first is no contradiction: the ball was turned
    if off[worst] > MAX_OFF and (rest.kind, alone.kind) == ("line", "line"):
        return worst, OTHER_COLOUR
    return _other_brightness(seen) if whole.kind == "line" else None


def _other_brightness(seen: Sequence[_Seen]) -> tuple[int, str] | None:
    """Find the picture whose light is not that of the others; of a ball of one colour."""
    level = torch.stack([s.light.mean(0).norm() for s in seen])
    usual = level.median()
    off = (level / usual - 1).abs()
    worst = int(off.argmax())
    if float(off[worst]) <= max(OTHER_LIGHT, OUTLIER * 1.48 * float(off.median())):
        return None
    return worst, (
        f"is {float(level[worst] / usual):.2f} times as bright as the others: other light, or "
        "another exposure"
    )


def _normal_std(colours: BallColours, seen: Sequence[_Seen]) -> float:
    """Widen the uncertainty of the plane by how the planes of single pictures scatter, radian."""
    own = [s.alone.normal for s in seen if s.alone.normal is not None]
    by_pixels = colours.normal_std or 0.0
    if len(own) < 2:
        return by_pixels
    cosine = (torch.tensor(own).double() @ torch.tensor(colours.normal).double()).abs()
    scatter = torch.acos(cosine.clamp_max(1)).square().sum() / (len(own) - 1)
    return max(by_pixels, math.sqrt(float(scatter) / len(own)))


def _pigment_std(colours: BallColours, seen: Sequence[_Seen]) -> tuple[Colour, ...]:
    pigments = torch.tensor(colours.pigments).double().reshape(-1, 3)
    return tuple(_one_pigment_std(k, pigments, seen) for k in range(len(pigments)))


def _one_pigment_std(k: int, pigments: Tensor, seen: Sequence[_Seen]) -> Colour:
    """Give the standard deviation of one pigment, R,G,B."""
    ways = torch.nn.functional.normalize(pigments, dim=-1)
    found, noise = [], []
    for one in seen:
        unit = torch.nn.functional.normalize(one.light, dim=-1)
        mine = (unit @ ways.mT).argmax(1) == k
        shown = torch.tensor(one.alone.pigments).double().reshape(-1, 3)
        closest = torch.nn.functional.normalize(shown, dim=-1) @ ways.mT
        own = shown[closest.argmax(1) == k] if len(shown) else shown
        if len(own) and bool(mine.any()):
            found.append(own.mean(0))
            noise.append(one.variance[mine].mean(0) / int(mine.sum()))
    if not found:  # it shows only where pictures are taken together
        return _colour(torch.cat([one.variance for one in seen]).mean(0).sqrt())
    count = len(found)
    within = torch.stack(noise).sum(0) / count**2
    spread = torch.stack(found).var(0) / count if count > 1 else torch.zeros(3).double()
    return _colour(torch.maximum(within, spread).sqrt())


def _shade(view: BallView) -> tuple[Tensor, Tensor]:
    """Give the disc's light in cells [C, 3] and its variance; not finite where there is none."""
    image, disc = view.image, view.disc
    y, x = torch.meshgrid(torch.arange(image.height), torch.arange(image.width), indexing="ij")
    place = disc.to_unit(torch.stack([x, y], dim=-1).double())
    inside = (torch.linalg.vector_norm(place, dim=-1) < INSIDE) & ~image.clipped[0, 0]
    cell = ((place[inside] + 1) / 2 * CELLS).long().clamp(0, CELLS - 1)
    index = cell[:, 1] * CELLS + cell[:, 0]
    light = image.rgb[0][:, inside].mT.double()
    count = torch.zeros(CELLS**2).double().index_add_(0, index, torch.ones(len(index)).double())
    mean = torch.zeros(CELLS**2, 3).double().index_add_(0, index, light) / count[:, None]
    read, gain = (v.double().reshape(3) for v in (view.noise.read_variance, view.noise.gain))
    return mean, (read + gain * mean.clamp_min(0)) / count[:, None]


def _difference(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor]) -> float:
    """Give the rms difference of two shades beyond noise, as a share of their brightness."""
    (one, its_noise), (other, other_noise) = first, second
    both = torch.isfinite(one).all(1) & torch.isfinite(other).all(1)
    if not bool(both.any()):
        raise CalibrationError(
            "two pictures of the ball show no place of it alike; look at them again"
        )
    level = ((one[both] ** 2).mean() + (other[both] ** 2).mean()) / 2
    beyond = ((one - other)[both] ** 2 - (its_noise + other_noise)[both]).mean()
    return math.sqrt(max(0.0, float(beyond / level)))


def _colour(values: Tensor) -> Colour:
    r, g, b = values.tolist()
    return r, g, b
