"""The pixels of a sharp ball that its light is fitted to, with their noise."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.disc import BallView
from toolkit.disc_sight import REACH
from toolkit.ranks import HALF_OF_NORMAL
from toolkit.rim import sample_variance
from toolkit.rim_light import transition
from toolkit.types import NoiseModel

LARGEST = 60.0
"""px of the radius from which pixels are averaged before they are fitted."""
LEAST_COVERAGE, DISTURBED_COVERAGE = 0.2, 0.97
"""Share of the ball in the pixels used; and where something else is seen beside it."""
LEAST_SPREAD, MOST_SPREAD = 0.02, 4.0
"""px^2, variance of the lens's blur."""
INNER, FEWEST, MOST_EXCESS = 0.9, 100, 4.0
"""Share of the radius within which the ball's own noise is measured, from so many differences on,
and the factor by which its variance may differ from what the background tells."""
PATCH, PATCH_MISFIT = 5, 6.0
"""px along the side of a patch, and standard deviations by which it may be missed as a whole."""
RING = (6.0, 11.0)
"""px beyond the outline where nothing but background may be seen."""


def is_clear(view: BallView) -> bool:
    """Say whether nothing but the background is seen in a ring about the ball."""
    light, behind = (x.rgb[0].movedim(0, -1).double() for x in (view.image, view.background))
    y, x = torch.meshgrid(torch.arange(light.shape[0]), torch.arange(light.shape[1]), indexing="ij")
    rho = torch.linalg.vector_norm(view.disc.to_unit(torch.stack([x, y], dim=-1).double()), dim=-1)
    away = (rho - 1) * view.disc.semi_axes[1]
    in_ring = ((away > RING[0]) & (away < RING[1]))[..., None]
    share = 1 + 1 / view.background.frames
    noise = sample_variance(view.noise, behind, share).clamp_min(1e-9).sqrt()
    return _worst_patch(((light - behind) / noise * in_ring).movedim(-1, 0)) < PATCH_MISFIT


def _worst_patch(missed: Tensor) -> float:
    """Give by how many standard deviations a patch of [3, H, W] is missed as a whole, at most."""
    mean = torch.nn.functional.avg_pool2d(missed[None], PATCH, stride=1, padding=PATCH // 2)
    return float(mean.abs().max()) * PATCH


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothPixels:
    """P pixels of ball and rim, averaged in blocks where there are many."""

    place: Tensor  # [P, 2] px of the averaged window
    index: Tensor  # [P] in it
    shape: tuple[int, int]  # of it
    light: Tensor  # [P, 3]
    behind: Tensor  # [P, 3]
    noise: Tensor  # [P, 3] variance of the light
    behind_noise: Tensor  # [P, 3] variance of what is behind
    is_disturbed: Tensor  # [P] bool
    disc: Disc  # px of the averaged window
    spread: float  # px^2, variance of the lens's blur, as found at the rim
    model: NoiseModel
    level: Tensor  # [3] mean light of the ball
    excess: Tensor  # [3] variance of the ball's noise over the one that the background tells
    block: int
    used: Tensor | None = None  # [P] bool; by the coverage where None

    @classmethod
    def of(cls, view: BallView) -> "SmoothPixels":
        """Take what may show any of the ball."""
        blur, is_disturbed = transition(view)
        block = max(1, math.ceil(view.disc.semi_axes[0] / LARGEST))
        light_map, behind_map, clipped = (
            torch.nn.functional.avg_pool2d(x.double(), block)[0]
            for x in (view.image.rgb, view.background.rgb, view.image.clipped)
        )
        disc = _scaled(view.disc, block, (block - 1) / 2)
        # samples between pixels are blurred once more
        spread = min(max((blur**2 - 1 / 6) / block**2 - 1 / 12, LEAST_SPREAD), MOST_SPREAD)
        height, width = light_map.shape[1:]
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        place = torch.stack([x, y], dim=-1).double().reshape(-1, 2)
        unit = disc.to_unit(place)
        rho = torch.linalg.vector_norm(unit, dim=-1)
        reach = 1 + REACH * math.sqrt(spread + 1 / 12) / disc.semi_axes[1]
        index = ((rho < reach) & (clipped.flatten() == 0)).nonzero()[:, 0]
        turn = torch.atan2(unit[index, 1], unit[index, 0]) / math.tau % 1 * len(is_disturbed)
        light, behind = (v.flatten(1).mT[index] for v in (light_map, behind_map))
        share = 1 / block**2
        is_inner = ((rho < INNER) & (clipped.flatten() == 0)).reshape(height, width)
        noise = _picture_noise(light_map, is_inner, view.noise, share)
        return cls(
            place=place[index],
            index=index,
            shape=(height, width),
            light=light,
            behind=behind,
            noise=(noise * sample_variance(view.noise, light, share)).clamp_min(1e-9),
            behind_noise=sample_variance(view.noise, behind, share / view.background.frames),
            is_disturbed=is_disturbed[turn.long() % len(is_disturbed)],
            disc=disc,
            spread=spread,
            model=view.noise,
            level=light_map[:, is_inner].mean(1).clamp_min(1e-3),
            excess=noise,
            block=block,
        )

    def with_noise_of(self, light: Tensor) -> "SmoothPixels":
        """Give the same with the noise of smooth light; noisy light's would favour what is dark."""
        share = 1 / self.block**2
        noise = self.excess * sample_variance(self.model, light, share)
        return replace(self, noise=noise.clamp_min(1e-9))

    def full(self, disc: Disc) -> Disc:
        """Give a disc in px of the whole window."""
        return _scaled(disc, 1 / self.block, -(1 - 1 / self.block) / 2)

    def seen_by(self, coverage: Tensor) -> tuple[Tensor, Tensor]:
        """Give what the ball itself adds to each pixel, and its weight, [P, 3].

        Pixels that hold hardly any of it, and those disturbed, have none.
        """
        rest = 1 - coverage[:, None]
        used = self._used(coverage) if self.used is None else self.used
        weight = used[:, None] / (self.noise + rest**2 * self.behind_noise)
        return self.light - rest * self.behind, weight

    def _used(self, coverage: Tensor) -> Tensor:
        least = torch.where(self.is_disturbed, DISTURBED_COVERAGE, LEAST_COVERAGE)
        return coverage > least

    def held(self, coverage: Tensor) -> "SmoothPixels":
        """Give the same of which those are used from now on that are used at this coverage."""
        return replace(self, used=self._used(coverage))

    def worst_patch(self, missed: Tensor) -> float:
        """Give by how many standard deviations the worst patch of what is missed [P, 3] is."""
        whole = torch.zeros(3, self.shape[0] * self.shape[1], dtype=torch.float64)
        whole[:, self.index] = missed.mT
        return _worst_patch(whole.reshape(3, *self.shape))


def _picture_noise(light: Tensor, is_inner: Tensor, noise: NoiseModel, share: float) -> Tensor:
    """Give the variance of a ball's noise over that of a model, for each channel [3].

    The model knows the background's brightness, which the ball's may be far from. The noise is what
    differs from pixel to pixel otherwise than a smooth shade does: their fourth differences.

    Args:
        light: [3, H, W].
        is_inner: pixels that show the ball alone [H, W].
        noise: as the background tells it.
        share: of the variance of one picture.
    """
    weights = torch.tensor([1.0, -4, 6, -4, 1], dtype=torch.float64) / math.sqrt(70)
    expected = sample_variance(noise, light.movedim(0, -1), share).movedim(-1, 0).clamp_min(1e-9)
    found = []
    for picture, variance, inner in (
        (light, expected, is_inner),
        (light.mT, expected.mT, is_inner.mT),
    ):
        if picture.shape[-1] >= 5:
            change = picture.unfold(-1, 5, 1) @ weights
            is_used = inner.unfold(-1, 5, 1).all(-1)
            found.append((change / variance[..., 2:-2].sqrt())[:, is_used])
    size = torch.cat(found, dim=1).abs() if found else light[:, 0, :0]
    if size.shape[1] < FEWEST:
        return torch.ones(len(light), dtype=torch.float64)
    return (size.median(1).values / HALF_OF_NORMAL).square().clamp(1 / MOST_EXCESS, MOST_EXCESS)


def _scaled(disc: Disc, block: float, shift: float = 0.0) -> Disc:
    """Give a disc in pixels larger by `block`."""
    x, y = ((c - shift) / block for c in disc.centre)
    longer, shorter = (axis / block for axis in disc.semi_axes)
    return replace(disc, centre=(x, y), semi_axes=(longer, shorter))
