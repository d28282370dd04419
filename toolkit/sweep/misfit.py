"""What the most likely motion leaves unexplained, looked at in patches where noise averages out.

Noise leaves each patch, averaged with the weights of the opacity, a misfit of one standard
deviation. More of it tells of correlated noise, as in compressed pictures, or of a model that does
not hold: a pattern on the ball, a changed background, a wrong response.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.ranks import HALF_OF_NORMAL
from toolkit.sweep.fit import SweepFit, outline
from toolkit.sweep.likelihood import Comparison
from toolkit.sweep.pixels import Frame

PATCH = 8
"""px along the side of a patch: that of a block of JPEG."""
SMALLEST, MOST_PATCHES = 2, 800
"""px along the side of a small patch, of which there are about so many at most."""
LANES = 24
"""Across the streak, over its whole length: what all of it misses alike."""
CHANCE = 3.5
"""Standard deviations by which a mean square may exceed 1 by chance."""
COVERED = 1e-4
"""Opacity from which a pixel counts as covered."""
CORRELATED = 1.5
"""Mean square of patches beside the streak from which noise is not that of single pixels."""
ALIKE = 4.0
"""Times this to which the streak may miss by such noise alone, in its largest patches."""
FEWEST = 6
"""Patches from which there is something to be said."""
FEWEST_COARSE = 12
"""The same of larger ones, of which what is fitted takes a larger share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfit:
    """Mean squares of the misfit, 1 where there is only noise."""

    pixels: float  # of single pixels
    patches: float
    lanes: float
    patch_place: Tensor  # [B, 2] px
    patch_sigma: Tensor  # [B] misfit of the opacity's mean, standard deviations
    factor: float  # by which the covariance is to be widened
    is_patchy: bool  # patches beyond chance
    is_common: bool  # lanes beyond chance: all of the streak misses alike

    @property
    def significant(self) -> bool:
        """Whether there is more than noise."""
        return self.is_patchy or self.is_common


def mean_square(seen: Comparison) -> float:
    """Give the mean squared misfit of what was compared before the ball: pixels or squares."""
    is_used = (seen.coverage.alpha > COVERED) & (seen.residual != 0)
    used = int(is_used.sum())
    return float((seen.residual**2 * is_used).sum()) / used if used else 1.0


def _of_single_pixels(fit: SweepFit) -> float:
    """Give the mean squared misfit of single pixels, where squares stand for many of them too.

    In a square noise averages out, and what all its pixels miss alike does not.
    """
    seen, pixels = fit.seen, fit.pixels
    is_used = (seen.coverage.alpha > COVERED) & (seen.residual != 0)
    if not bool(is_used.any()):
        return 1.0
    counts = torch.cat([torch.full((len(s),), float(s.side**2)) for s in pixels.squares])
    of_noise = (counts - 1) / pixels.excess
    total = ((seen.residual**2 + of_noise) * is_used).sum()
    return float(total / (counts * is_used).sum())


def bulk_excess(seen: Comparison) -> float:
    """Give the same of the bulk of the pixels, whatever a few do, at least 1."""
    is_covered = seen.coverage.alpha > COVERED
    size = seen.residual[:, is_covered].abs()
    used = size[size > 0]
    return max(1.0, float(used.median() / HALF_OF_NORMAL) ** 2) if len(used) else 1.0


def look_for_misfit(fit: SweepFit) -> Misfit:
    """Compare what is left in patches and lanes with what noise would leave."""
    seen, pixels = fit.seen, fit.pixels
    index = (seen.coverage.alpha > COVERED).nonzero()[:, 0]
    score, sure = seen.pull[index], seen.hold[index]
    place, passage = pixels.place[index], seen.coverage.passage
    sigma, used, inverse = _patch_sigmas(_cell(place, PATCH), score, sure)
    offset = (1 - passage.room[index] / fit.model.ball_radius**2).clamp(0, 1.2).sqrt()
    offset = offset * passage.side[index]
    lane = ((offset + 1.1) / 2.2 * LANES).long().clamp(0, LANES - 1)
    lanes, _, _ = _patch_sigmas(lane, score, sure)
    patches = _mean_square(sigma)
    by_lane = _mean_square(lanes)
    single = mean_square(seen)
    # variances that were raised to the misfit before a shade was fitted hide what is left
    hidden = min(single, 1.0) if pixels.excess > 1 else 1.0
    is_patchy = _is_beyond_chance(patches / hidden, len(sigma))
    is_common = _is_beyond_chance(by_lane / hidden, len(lanes))
    factor = max(single, 1.0)
    if is_patchy:
        factor = max(factor, patches)
    if is_common:
        factor = max(factor, by_lane)
    return Misfit(
        pixels=_of_single_pixels(fit),
        patches=patches,
        lanes=by_lane,
        patch_place=_middles(place[used], inverse, len(sigma)),
        patch_sigma=sigma,
        factor=factor,
        is_patchy=is_patchy,
        is_common=is_common,
    )


def is_noise(fit: SweepFit, misfit: Misfit, frame: Frame) -> bool:
    """Say whether the misfit is that of correlated noise, such as is seen beside the streak too."""
    beside = patches_beside(fit, frame)
    return beside > CORRELATED and misfit.factor * fit.pixels.excess < ALIKE * beside


def patches_beside(fit: SweepFit, frame: Frame) -> float:
    """Give the mean square of patches beside the streak: more than 1 where noise is correlated.

    Compression takes fine noise away and leaves what is alike over a few pixels: then single
    pixels tell less of the noise than patches do, with a ball or without.
    """
    path_px, half_width = outline(fit.model, fit.parameters)
    signal, ground, shot, empty = frame.read_beside(path_px, half_width, side=PATCH)
    gain, offset = (numbers[:, None] for numbers in fit.model.split(fit.parameters)[3:])
    size = (signal - gain * ground - offset).abs() / (shot + gain**2 * empty).sqrt()
    used = size[size > 0]
    return float(used.median() / HALF_OF_NORMAL) ** 2 if len(used) >= FEWEST else 1.0


def with_coarse_misfit(misfit: Misfit, fit: SweepFit) -> Misfit:
    """Widen by what larger patches miss too: a pattern on the ball is alike far beyond 8 px.

    The more of the streak misses alike, the less it averages out, and the further the motion may be
    off; patches twice as wide show it until too few are left.
    """
    index = (fit.seen.coverage.alpha > COVERED).nonzero()[:, 0]
    score, sure = fit.seen.pull[index], fit.seen.hold[index]
    side, factor, is_patchy = 2 * PATCH, misfit.factor, misfit.is_patchy
    while True:
        sigma, _, _ = _patch_sigmas(_cell(fit.pixels.place[index], side), score, sure)
        if len(sigma) < FEWEST_COARSE:
            return replace(misfit, factor=factor, is_patchy=is_patchy)
        excess = _mean_square(sigma)
        if _is_beyond_chance(excess, len(sigma)):
            factor, is_patchy = max(factor, excess), True
        side *= 2


def beside_excess(fit: SweepFit) -> float:
    """Give the mean squared misfit of patches that the ball never covers, 1 where only noise is."""
    index = (fit.seen.coverage.alpha <= COVERED).nonzero()[:, 0]
    if not len(index):
        return 1.0
    residual = fit.seen.residual[:, index]
    used = (residual != 0).sum(0).double()
    sigma, _, _ = _patch_sigmas(_cell(fit.pixels.place[index], PATCH), residual.sum(0), used)
    return _mean_square(sigma) * fit.pixels.excess


def small_patches(fit: SweepFit) -> tuple[Tensor, Tensor]:
    """Give places [B, 2] px of patches as small as can be told apart, and their misfit [B]."""
    index = (fit.seen.coverage.alpha > COVERED).nonzero()[:, 0]
    place = fit.pixels.place[index]
    side = max(SMALLEST, math.ceil(math.sqrt(len(index) / MOST_PATCHES)))
    sigma, used, inverse = _patch_sigmas(
        _cell(place, side), fit.seen.pull[index], fit.seen.hold[index]
    )
    return _middles(place[used], inverse, len(sigma)), sigma


def _middles(place: Tensor, inverse: Tensor, count: int) -> Tensor:
    """Give the mean place of the pixels in each patch [B, 2]."""
    counts = torch.bincount(inverse, minlength=count).double().clamp_min(1)
    return torch.stack(
        [torch.bincount(inverse, weights=p, minlength=count) / counts for p in place.mT], dim=-1
    )


def _cell(place: Tensor, side: int) -> Tensor:
    """Number the squares that hold the places [N, 2] px."""
    cell = (place / side).floor().long()
    cell = cell - cell.amin(0)
    return cell[:, 1] * (int(cell[:, 0].max()) + 1) + cell[:, 0]


def _is_beyond_chance(mean_square: float, count: int) -> bool:
    return mean_square > 1 + CHANCE * math.sqrt(2 / max(count, 1))


def _patch_sigmas(number: Tensor, score: Tensor, sure: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give the misfit of each patch, which pixels were used, and the patch of each of these."""
    total = torch.bincount(number, weights=sure)
    enough = total > 0.2 * total.mean()
    used = enough[number]
    labels = (enough.long().cumsum(0) - 1)[number[used]]
    size = int(enough.sum())
    pull = torch.bincount(labels, weights=score[used], minlength=size)
    hold = torch.bincount(labels, weights=sure[used], minlength=size)
    return pull / hold.clamp_min(1e-300).sqrt(), used, labels


def _mean_square(sigma: Tensor) -> float:
    return float((sigma * sigma).mean()) if len(sigma) >= FEWEST else 1.0
