"""The light of a sharp ball as a smooth function of its surface's normal, seen through the lens.

Each pixel of the picture holds the ball's light, blurred by lens and pixel, and near the rim some
of the background. A shade that explains them all is free of that blur, and of most of the noise. It
is that of a matt ball in a room with one lamp, which ends somewhere on the ball, and a spline for
all else, held back by its curvature as strongly as there is evidence for. Disc and blur are fitted
with it: where a dark side fades into the background, they cannot be told without the shade. What
is left open is told by draws. [derived]
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.disc import BallView
from toolkit.disc_sight import REACH, Places, grown, look_places
from toolkit.rim import sample_variance
from toolkit.rim_light import transition
from toolkit.shade_basis import (
    ShadeTable,
    bending,
    dense_basis,
    lamp_directions,
    lamp_light,
    shade_size,
    sparse_basis,
    turned,
)
from toolkit.types import NoiseModel

STIFFNESS = tuple(10.0**power for power in range(-4, 9))
"""Penalties of the spline's squared second differences over its squared mean light, tried."""
LOOSE = 1e-6
"""Least stiffness of every number of the spline, so that all are told."""
LARGEST = 60.0
"""px of the radius from which pixels are averaged before they are fitted."""
LEAST_COVERAGE, DISTURBED_COVERAGE = 0.2, 0.97
"""Share of the ball in the pixels used; and where something else is seen beside it."""
STEPS, SETTLED, SEARCHES = 8, 0.2, (0, 2)
"""Rounds at most, standard deviations of a step below which it has settled, and the rounds in which
a lamp is sought."""
LEAST_GAIN = 25.0
"""By which a lamp must lower the squared residual over that of noise: it adds five numbers."""
TURN_STD = 0.3
"""Radians by which the lamp may turn in a round, a prior."""
OUTLINE_STD, BLUR_STD = 0.3, 0.3
"""How far the outline, px, and the variance of the blur, px^2, may move: priors."""
LEAST_SPREAD, MOST_SPREAD = 0.02, 4.0
"""px^2, variance of the lens's blur."""
MISFIT = 1.3
"""Squared residual over that of noise beyond which the light is not smooth."""
PATCH, PATCH_MISFIT = 5, 6.0
"""px along the side of a patch, and standard deviations by which it may be missed as a whole."""
RING = (6.0, 11.0)
"""px beyond the outline where nothing but background may be seen."""
DRAWS = 8
"""Lights that could be as well."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothLight:
    """What fits the light of a disc, and what could as well."""

    disc: Disc  # px of the window
    coefficients: Tensor  # [1 + DRAWS, K, 3], the most likely first
    lamps: Tensor  # [1 + DRAWS, 3] of each

    def at(self, place: Tensor) -> Tensor:
        """Give the light at places of the unit disc [..., 2], [1 + DRAWS, ..., 3]."""
        flat = place.reshape(-1, 2)
        light = dense_basis(flat) @ self.coefficients[:, :-1]
        lamps = lamp_light(flat, self.lamps).mT[..., None]
        light = light + lamps * self.coefficients[:, -1:]
        return light.reshape(len(light), *place.shape[:-1], 3)


def fit_smooth_light(view: BallView) -> SmoothLight | None:
    """Fit a smooth shade to all pixels of a disc.

    None where no such shade explains them, or where the background beside the ball is not what it
    is without it, as in a shadow: outline and shade could not be told apart there.
    """
    if not _is_clear(view):
        return None
    pixels = _Pixels.of(view)
    disc, spread = pixels.disc, pixels.spread
    lamp = torch.zeros(0, 3, dtype=torch.float64)
    for number in range(STEPS):
        if number in SEARCHES:
            lamp = _brightest(pixels, disc, spread, lamp)
        design, coverage = _design(pixels.place, disc, spread, lamp)
        shade = _Shade.of(design, coverage, pixels.seen_by(coverage))
        pixels = pixels.with_noise_of(pixels.light - shade.residual)
        slopes = _slopes(pixels, disc, spread, lamp, shade)
        equations = _Joint.of(shade, slopes)
        if number == STEPS - 1 or (number > max(SEARCHES) and equations.is_settled()):
            break
        moved, spread = _moved(disc, spread, equations.step)
        if moved is None:
            return None
        disc, lamp = moved, turned(lamp, equations.step[6:])
    if shade.misfit() > MISFIT or pixels.worst_patch(shade) > PATCH_MISFIT:
        return None
    widening = math.sqrt(max(1.0, shade.misfit()))
    disc = replace(pixels.full(disc), std=widening * pixels.block * equations.outline_std())
    coefficients, turns = equations.draws(widening)
    lamps = torch.cat([turned(lamp, turn) for turn in turns])
    return SmoothLight(disc=disc, coefficients=coefficients, lamps=lamps)


def _is_clear(view: BallView) -> bool:
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
class _Pixels:
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
    block: int

    @classmethod
    def of(cls, view: BallView) -> "_Pixels":
        """Take what may show any of the ball."""
        blur, is_disturbed = transition(view)
        block = max(1, math.ceil(view.disc.semi_axes[0] / LARGEST))
        light, behind, clipped = (
            torch.nn.functional.avg_pool2d(x.double(), block)[0]
            for x in (view.image.rgb, view.background.rgb, view.image.clipped)
        )
        disc = _scaled(view.disc, block, (block - 1) / 2)
        # samples between pixels are blurred once more
        spread = min(max((blur**2 - 1 / 6) / block**2 - 1 / 12, LEAST_SPREAD), MOST_SPREAD)
        height, width = light.shape[1:]
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        place = torch.stack([x, y], dim=-1).double().reshape(-1, 2)
        unit = disc.to_unit(place)
        rho = torch.linalg.vector_norm(unit, dim=-1)
        reach = 1 + REACH * math.sqrt(spread + 1 / 12) / disc.semi_axes[1]
        index = ((rho < reach) & (clipped.flatten() == 0)).nonzero()[:, 0]
        turn = torch.atan2(unit[index, 1], unit[index, 0]) / math.tau % 1 * len(is_disturbed)
        light, behind = (v.flatten(1).mT[index] for v in (light, behind))
        share = 1 / block**2
        return cls(
            place=place[index],
            index=index,
            shape=(height, width),
            light=light,
            behind=behind,
            noise=sample_variance(view.noise, light, share).clamp_min(1e-9),
            behind_noise=sample_variance(view.noise, behind, share / view.background.frames),
            is_disturbed=is_disturbed[turn.long() % len(is_disturbed)],
            disc=disc,
            spread=spread,
            model=view.noise,
            block=block,
        )

    def with_noise_of(self, light: Tensor) -> "_Pixels":
        """Give the same with the noise of smooth light; noisy light's would favour what is dark."""
        share = 1 / self.block**2
        return replace(self, noise=sample_variance(self.model, light, share).clamp_min(1e-9))

    def full(self, disc: Disc) -> Disc:
        """Give a disc in px of the whole window."""
        return _scaled(disc, 1 / self.block, -(1 - 1 / self.block) / 2)

    def seen_by(self, coverage: Tensor) -> tuple[Tensor, Tensor]:
        """Give what the ball itself adds to each pixel, and its weight, [P, 3].

        Pixels that hold hardly any of it, and those disturbed, have none.
        """
        rest = 1 - coverage[:, None]
        least = torch.where(self.is_disturbed, DISTURBED_COVERAGE, LEAST_COVERAGE)
        weight = (coverage > least)[:, None] / (self.noise + rest**2 * self.behind_noise)
        return self.light - rest * self.behind, weight

    def worst_patch(self, shade: "_Shade") -> float:
        """Give by how many standard deviations the worst patch is missed as a whole."""
        missed = torch.zeros(3, self.shape[0] * self.shape[1], dtype=torch.float64)
        missed[:, self.index] = (shade.residual * shade.weight.sqrt()).mT
        return _worst_patch(missed.reshape(3, *self.shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shade:
    """The most likely shade of one disc and blur, channel by channel."""

    design: Tensor  # [P, K]
    weight: Tensor  # [P, 3]
    residual: Tensor  # [P, 3]
    coefficients: Tensor  # [3, K]
    factor: Tensor  # [3, K, K] Cholesky's, of the equations

    @classmethod
    def of(cls, design: Tensor, coverage: Tensor, seen: tuple[Tensor, Tensor]) -> "_Shade":
        """Fit with the stiffness for which there is most evidence."""
        light, weight = seen
        scale = (weight * coverage[:, None] * light).sum(0) / (
            (weight * coverage[:, None] ** 2).sum(0).clamp_min(1e-9)
        )
        normal = torch.stack([design.mT @ (w[:, None] * design) for w in weight.mT])
        pull = (design.mT @ (weight * light)).mT
        penalty, rank = bending(design.shape[1])
        levels = scale.clamp_min(1e-3)[:, None, None] ** 2
        loose = LOOSE * torch.eye(design.shape[1], dtype=torch.float64)
        best, least = None, math.inf
        for stiffness in STIFFNESS:
            equations = normal + (stiffness * penalty + loose) / levels
            factor = torch.linalg.cholesky(equations)
            found = torch.cholesky_solve(pull[..., None], factor)[..., 0]
            misfit = -(found * pull).sum() + 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum()
            doubt = float(misfit) - 3 * rank * math.log(stiffness)
            if doubt < least:
                best, least = (found, factor), doubt
        assert best is not None
        found, factor = best
        return cls(
            design=design,
            weight=weight,
            residual=light - design @ found.mT,
            coefficients=found,
            factor=factor,
        )

    def misfit(self) -> float:
        """Give the mean squared residual over that of noise."""
        counted = int((self.weight > 0).sum())
        return float((self.residual**2 * self.weight).sum()) / max(1, counted)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Joint:
    """Equations of the shade together with disc and blur."""

    shade: _Shade
    answer: Tensor  # [3, K, 8] of the shade to what disc and blur do
    factor: Tensor  # [8, 8] Cholesky's, of the equations of disc and blur
    step: Tensor  # [8]

    @classmethod
    def of(cls, shade: _Shade, slopes: Tensor) -> "_Joint":
        """Solve them; `slopes` [P, 3, 8] is what disc and blur do to the pixels."""
        weighted = shade.weight[..., None] * slopes
        mixed = torch.einsum("pk,pcn->ckn", shade.design, weighted)
        answer = torch.cholesky_solve(mixed, shade.factor)
        prior = torch.tensor([OUTLINE_STD] * 5 + [BLUR_STD] + [TURN_STD] * 2).double() ** -2
        own = torch.einsum("pcm,pcn->mn", slopes, weighted) + prior.diag()
        factor = torch.linalg.cholesky(own - torch.einsum("ckm,ckn->mn", mixed, answer))
        pull = torch.einsum("pcn,pc->n", weighted, shade.residual)
        # what the penalty pulls is in the shade's own equations already
        step = torch.cholesky_solve(pull[:, None], factor)[:, 0]
        return cls(shade=shade, answer=answer, factor=factor, step=step)

    def is_settled(self) -> bool:
        """Say whether another step would change next to nothing."""
        return float(torch.linalg.vector_norm(self.factor.mT @ self.step)) < SETTLED

    def outline_std(self) -> float:
        """Give the standard deviation of the outline's place, px, of all directions together."""
        variance = torch.cholesky_inverse(self.factor).diagonal()[:5].tolist()
        x, y, all_round, along, diagonal = variance
        return math.sqrt((x + y + along + diagonal) / 2 + all_round)

    def draws(self, widening: float) -> tuple[Tensor, Tensor]:
        """Give the most likely coefficients and some that could be as well [1 + DRAWS, K, 3].

        And how the lamp turns with them, [1 + DRAWS, 2].
        """
        generator = torch.Generator().manual_seed(0)
        best = self.shade.coefficients - torch.einsum("ckn,n->ck", self.answer, self.step)
        own = torch.randn(DRAWS, *best.shape, 1, generator=generator, dtype=torch.float64)
        moved = torch.randn(DRAWS, 8, 1, generator=generator, dtype=torch.float64)
        own = torch.linalg.solve_triangular(self.shade.factor.mT, own, upper=True)[..., 0]
        moved = torch.linalg.solve_triangular(self.factor.mT, moved, upper=True)[..., 0]
        other = own - torch.einsum("ckn,dn->dck", self.answer, moved)
        turns = torch.cat([self.step[None], self.step + widening * moved])[:, 6:]
        return torch.cat([best[None], best + widening * other]).mT, turns


def _design(place: Tensor, disc: Disc, spread: float, lamps: Tensor) -> tuple[Tensor, Tensor]:
    """Give what each number of the shade adds to pixels [P, K], and the ball's share [P].

    Those of L lamps come last.
    """
    index, unit, weight = look_places(place, disc, spread)
    rows, columns, values = sparse_basis(unit)
    design = torch.zeros(len(place) * shade_size(), dtype=torch.float64)
    design.index_add_(0, index[rows] * shade_size() + columns, weight[rows] * values)
    design = design.reshape(len(place), shade_size())
    lit = torch.zeros(len(place), len(lamps), dtype=torch.float64)
    lit.index_add_(0, index, weight[:, None] * lamp_light(unit, lamps))
    coverage = torch.zeros(len(place), dtype=torch.float64).index_add_(0, index, weight)
    return torch.cat([design, lit], dim=1), coverage


def _brightest(pixels: _Pixels, disc: Disc, spread: float, lamp: Tensor) -> Tensor:
    """Find the lamp that explains most of what a shade without one misses [1, 3]; zero if none."""
    lamps = torch.cat([lamp_directions(), lamp])
    design, coverage = _design(pixels.place, disc, spread, lamps[:0])
    # without blur: this only tells where to start
    unit = disc.to_unit(pixels.place)
    unit = unit / torch.linalg.vector_norm(unit, dim=-1, keepdim=True).clamp_min(1)
    lit = coverage[:, None] * lamp_light(unit, lamps)
    shade = _Shade.of(design, coverage, pixels.seen_by(coverage))
    gain = torch.zeros(len(lamps), dtype=torch.float64)
    for weight, residual, factor in zip(
        shade.weight.mT, shade.residual.mT, shade.factor, strict=True
    ):
        weighted = weight[:, None] * lit
        mixed = torch.linalg.solve_triangular(factor, design.mT @ weighted, upper=False)
        left = (weighted * lit).sum(0) - (mixed * mixed).sum(0)
        gain += (weighted.mT @ residual) ** 2 / left.clamp_min(1e-9 * float(left.max()))
    # a lamp of no length sends no light
    return lamps[gain.argmax()][None] * (gain.max() > LEAST_GAIN)


def _slopes(pixels: _Pixels, disc: Disc, spread: float, lamp: Tensor, shade: _Shade) -> Tensor:
    """Give what px of the outline, px^2 of blur and turns of the lamp add to pixels, [P, 3, 8].

    The outline moves as a whole, by two numbers, and grows in three ways.
    """

    def model(places: Places, table: ShadeTable) -> Tensor:
        index, unit, weight = places
        light = weight[:, None] * table.at(unit)
        seen = torch.zeros(len(pixels.place), 4, dtype=torch.float64)
        seen.index_add_(0, index, torch.cat([light, weight[:, None]], dim=1))
        return seen[:, :3] + (1 - seen[:, 3:]) * pixels.behind

    h, table = 0.02, ShadeTable.of(shade.coefficients, lamp)
    places = look_places(pixels.place, disc, spread)
    steps = h * torch.eye(5, dtype=torch.float64)
    others = [look_places(pixels.place, grown(disc, step), spread) for step in steps]
    others.append(look_places(pixels.place, disc, spread + h))
    here, seen = model(places, table), [model(other, table) for other in others]
    for turn in h * torch.eye(2, dtype=torch.float64):
        seen.append(model(places, ShadeTable.of(shade.coefficients, turned(lamp, turn))))
    columns = [(other - here) / h for other in seen]
    return torch.stack(columns, dim=-1)


def _moved(disc: Disc, spread: float, step: Tensor) -> tuple[Disc | None, float]:
    """Give the next disc and blur; no disc where it runs away."""
    if not bool(torch.isfinite(step).all()) or float(step[:5].abs().max()) > 1:
        return None, spread
    return grown(disc, step[:5]), min(max(spread + float(step[5]), LEAST_SPREAD), MOST_SPREAD)


def _scaled(disc: Disc, block: float, shift: float = 0.0) -> Disc:
    """Give a disc in pixels larger by `block`."""
    x, y = ((c - shift) / block for c in disc.centre)
    longer, shorter = (axis / block for axis in disc.semi_axes)
    return replace(disc, centre=(x, y), semi_axes=(longer, shorter))
