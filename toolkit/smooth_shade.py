"""The most likely smooth shade of a disc, and how it hangs on disc, blur, lamp and nearness.

Each channel's shade is linear in its numbers; the spline among them is held back by its curvature
as strongly as there is evidence for. [derived]
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.disc_sight import Places, grown, look_places
from toolkit.shade_basis import (
    ShadeTable,
    bending,
    dense_basis,
    facing_places,
    lamp_directions,
    lamp_light,
    shade_size,
    sparse_basis,
    turned,
)
from toolkit.smooth_pixels import LEAST_SPREAD, MOST_SPREAD, SmoothPixels

STIFFNESS = tuple(10.0**power for power in range(-4, 9))
"""Penalties of the spline's squared second differences over its squared mean light, tried."""
LOOSE = 1e-6
"""Least stiffness of every number of the spline, so that all are told."""
LEAST_GAIN = 10.0
"""By which a lamp must raise the evidence: its direction adds two numbers."""
TURN_STD = 0.3
"""Radians by which the lamp may turn in a round, a prior."""
OUTLINE_STD, BLUR_STD = 0.3, 0.3
"""How far the outline, px, and the variance of the blur, px^2, may move: priors."""
NEAR, NEAR_STD = (0.02, 0.0, 0.0), (0.03, 0.02, 0.02)
"""Prior of the sine of the angle under which the ball's radius is seen, and of its middle's place
on the unit disc."""
LEAST_SINE, MOST_NEAR = 1e-3, 0.3
SINE = 8
"""Its place in a step."""
SETTLED = 0.2
"""Standard deviations of a step below which the search has settled."""
GRID, NEGLECTED, MOST_ERRORS = 33, 0.03, 24
"""Places across the disc at which errors of the light are compared, the share of their variance
that is left out, and how many of a channel's are told at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """What the shade's equations are not linear in."""

    disc: Disc  # px of the averaged window
    spread: float  # px^2, variance of the lens's blur
    near: Tensor  # [3] see `facing_places`
    lamp: Tensor  # [1, 3] its direction; of no length where there is none

    def moved(self, step: Tensor) -> "Guess | None":
        """Give the next one, a step [11] away; None where it runs away."""
        if not bool(torch.isfinite(step).all()) or float(step[:5].abs().max()) > 1:
            return None
        near = self.near + step[8:]
        near = torch.cat(
            [near[:1].clamp(LEAST_SINE, MOST_NEAR), near[1:].clamp(-MOST_NEAR, MOST_NEAR)]
        )
        return Guess(
            disc=grown(self.disc, step[:5]),
            spread=min(max(self.spread + float(step[5]), LEAST_SPREAD), MOST_SPREAD),
            near=near,
            lamp=turned(self.lamp, step[6:8]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Equations:
    """Those of a shade, channel by channel."""

    normal: Tensor  # [3, K, K]
    pull: Tensor  # [3, K]
    penalty: Tensor  # [3, K, K] of stiffness 1
    loose: Tensor  # [3, K, K]
    rank: int

    @classmethod
    def of(cls, design: Tensor, seen: tuple[Tensor, Tensor], level: Tensor) -> "_Equations":
        light, weight = seen
        penalty, rank = bending(design.shape[1])
        squares = level[:, None, None] ** 2
        loose = torch.full((design.shape[1],), LOOSE, dtype=torch.float64)
        loose[shade_size() :] = 1.0  # a lamp is about as bright as the ball
        return cls(
            normal=torch.stack([design.mT @ (w[:, None] * design) for w in weight.mT]),
            pull=(design.mT @ (weight * light)).mT,
            penalty=penalty / squares,
            loose=loose.diag() / squares,
            rank=rank,
        )

    def at(self, stiffness: float) -> tuple[Tensor, Tensor, float]:
        """Give Cholesky's factor, the most likely numbers [3, K], and minus twice the evidence."""
        factor = torch.linalg.cholesky(self.normal + stiffness * self.penalty + self.loose)
        found = torch.cholesky_solve(self.pull[..., None], factor)[..., 0]
        misfit = -(found * self.pull).sum() + 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum()
        return factor, found, float(misfit) - 3 * self.rank * math.log(stiffness)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shade:
    """The most likely shade of one guess, channel by channel."""

    design: Tensor  # [P, K]
    coverage: Tensor  # [P]
    weight: Tensor  # [P, 3]
    residual: Tensor  # [P, 3]
    coefficients: Tensor  # [3, K]
    factor: Tensor  # [3, K, K] Cholesky's, of the equations
    doubt: float  # minus twice the logarithm of the evidence

    @classmethod
    def of(cls, pixels: SmoothPixels, guess: Guess) -> "Shade":
        """Fit with the stiffness for which there is most evidence."""
        design, coverage = _design(pixels.place, guess, guess.lamp)
        shade = cls.with_design(design, coverage, pixels)
        far = (guess.near - torch.tensor(NEAR)) / torch.tensor(NEAR_STD)
        return replace(shade, doubt=shade.doubt + float((far * far).sum()))

    @classmethod
    def with_design(cls, design: Tensor, coverage: Tensor, pixels: SmoothPixels) -> "Shade":
        """Do so with what each number adds to pixels [P, K], and the ball's share there [P]."""
        light, weight = pixels.seen_by(coverage)
        equations = _Equations.of(design, (light, weight), pixels.level)
        factor, found, doubt = min(map(equations.at, STIFFNESS), key=lambda tried: tried[2])
        doubt += float((weight * light * light).sum() - weight[weight > 0].log().sum())
        return cls(
            design=design,
            coverage=coverage,
            weight=weight,
            residual=light - design @ found.mT,
            coefficients=found,
            factor=factor,
            doubt=doubt,
        )

    def misfit(self) -> float:
        """Give the mean squared residual over that of noise."""
        counted = int((self.weight > 0).sum())
        return float((self.residual**2 * self.weight).sum()) / max(1, counted)


def brightest(pixels: SmoothPixels, guess: Guess) -> Tensor:
    """Find the lamp for which there is most evidence [1, 3]; of no length if for none.

    Each stiffness of what else is on the ball is tried with each lamp.
    """
    lamps = torch.cat([lamp_directions(), guess.lamp])
    design, coverage = _design(pixels.place, guess, guess.lamp[:0])
    # without blur: this only tells where to start
    unit = guess.disc.to_unit(pixels.place)
    unit = unit / torch.linalg.vector_norm(unit, dim=-1, keepdim=True).clamp_min(1)
    lit = coverage[:, None] * lamp_light(facing_places(unit, guess.near), lamps)
    light, weight = pixels.seen_by(coverage)
    equations = _Equations.of(design, (light, weight), pixels.level)
    weighted = [w[:, None] * lit for w in weight.mT]
    mixed = torch.stack([design.mT @ column for column in weighted])
    own = torch.stack([(column * lit).sum(0) for column in weighted])
    toward = torch.stack([column.mT @ y for column, y in zip(weighted, light.mT, strict=True)])
    best, least, plain = lamps[:1] * 0, math.inf, math.inf
    for stiffness in STIFFNESS:
        factor, found, doubt = equations.at(stiffness)
        answer = torch.linalg.solve_triangular(factor, mixed, upper=False)
        prior = pixels.level[:, None] ** -2
        left = (own - (answer * answer).sum(1)).clamp_min(0) + prior
        pull = toward - torch.einsum("ckl,ck->cl", mixed, found)
        doubts = doubt - (pull * pull / left).sum(0) + (left / prior).log().sum(0)
        plain = min(plain, doubt)
        if float(doubts.min()) < least:
            best, least = lamps[doubts.argmin()][None], float(doubts.min())
    # a lamp of no length sends no light
    return best * (plain - least > LEAST_GAIN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """Equations of the shade together with all in a guess."""

    shade: Shade
    answer: Tensor  # [3, K, 11] of the shade to what the guess does
    system: Tensor  # [11, 11]
    pull: Tensor  # [11]
    near: Tensor  # [3] of the guess

    @classmethod
    def of(cls, pixels: SmoothPixels, guess: Guess, shade: Shade) -> "Joint":
        """Find them; what the guess does to the pixels is found by small changes of it."""
        return cls.with_slopes(shade, _slopes(pixels, guess, shade), guess.near)

    @classmethod
    def with_slopes(cls, shade: Shade, slopes: Tensor, near: Tensor) -> "Joint":
        """Put them together from what the guess does to the pixels [P, 3, 11]."""
        weighted = shade.weight[..., None] * slopes
        mixed = torch.einsum("pk,pcn->ckn", shade.design, weighted)
        answer = torch.cholesky_solve(mixed, shade.factor)
        std = [OUTLINE_STD] * 5 + [BLUR_STD] + [TURN_STD] * 2 + [*NEAR_STD]
        prior = torch.tensor(std).double() ** -2
        own = torch.einsum("pcm,pcn->mn", slopes, weighted) + prior.diag()
        # what the penalty pulls is in the shade's own equations already
        pull = torch.einsum("pcn,pc->n", weighted, shade.residual)
        pull[8:] -= (near - torch.tensor(NEAR)) * prior[8:]
        return cls(
            shade=shade,
            answer=answer,
            system=own - torch.einsum("ckm,ckn->mn", mixed, answer),
            pull=pull,
            near=near,
        )

    def step_of_first(self, count: int) -> Tensor:
        """Give the step [11] in which only the first numbers of a guess change."""
        step = torch.zeros_like(self.pull)
        step[:count] = torch.linalg.solve(self.system[:count, :count], self.pull[:count])
        return step

    def step(self, damping: float = 0.0) -> Tensor:
        """Give the step to a better guess [11], which leaves a ball from afar no further away."""
        system = self.system + damping * self.system.diagonal().diag()
        step: Tensor = torch.linalg.solve(system, self.pull)
        nearest = LEAST_SINE - float(self.near[0])
        if float(step[SINE]) < nearest:
            free = torch.arange(len(step)) != SINE
            pull = self.pull[free] - nearest * system[free, SINE]
            step[free] = torch.linalg.solve(system[free][:, free], pull)
            step[SINE] = nearest
        return step

    def is_settled(self) -> bool:
        """Say whether another step would change next to nothing."""
        step = self.step()
        return float(step @ self.system @ step) < SETTLED**2

    def outline_std(self) -> float:
        """Give the standard deviation of the outline's place, px, of all directions together."""
        variance = torch.linalg.inv(self.system).diagonal()[:5].tolist()
        x, y, all_round, along, diagonal = variance
        return math.sqrt((x + y + along + diagonal) / 2 + all_round)

    def errors(self, guess: Guess) -> tuple[Tensor, Tensor]:
        """Give independent errors of one standard deviation of all coefficients [E, K, 3].

        And what moves with them, [E, 11]: what the guess leaves open comes first. Of the rest
        the largest are given, those of each channel by themselves.
        """
        moved = torch.linalg.solve_triangular(
            torch.linalg.cholesky(self.system).mT, torch.eye(len(self.pull)).double(), upper=True
        ).mT
        joint = -torch.einsum("ckn,en->ekc", self.answer, moved)
        place = facing_places(_grid_places(), guess.near)
        basis = torch.cat([dense_basis(place), lamp_light(place, guess.lamp)], dim=1)
        own = []
        for channel, factor in enumerate(self.shade.factor):
            spread = torch.linalg.solve_triangular(factor, basis.mT, upper=False)
            size, vectors = torch.linalg.eigh(spread @ spread.mT)
            left = size.flip(0).cumsum(0) / size.sum()
            count = min(int((left < 1 - NEGLECTED).sum()) + 1, MOST_ERRORS)
            own_error = torch.linalg.solve_triangular(
                factor.mT, vectors.flip(1)[:, :count], upper=True
            )
            error = torch.zeros(count, *joint.shape[1:], dtype=torch.float64)
            error[..., channel] = own_error.mT
            own.append(error)
        errors = torch.cat([joint, *own])
        still = torch.zeros(len(errors) - len(moved), moved.shape[1], dtype=torch.float64)
        return errors, torch.cat([moved, still])


def _grid_places() -> Tensor:
    """Give places evenly over the unit disc, at which errors are compared [P, 2]."""
    line = torch.linspace(-1, 1, GRID, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1).reshape(-1, 2)
    return place[torch.linalg.vector_norm(place, dim=-1) < 1]


def _design(place: Tensor, guess: Guess, lamps: Tensor) -> tuple[Tensor, Tensor]:
    """Give what each number of the shade adds to pixels [P, K], and the ball's share [P].

    Those of L lamps come last.
    """
    index, unit, weight = look_places(place, guess.disc, guess.spread)
    unit = facing_places(unit, guess.near)
    rows, columns, values = sparse_basis(unit)
    design = torch.zeros(len(place) * shade_size(), dtype=torch.float64)
    design.index_add_(0, index[rows] * shade_size() + columns, weight[rows] * values)
    design = design.reshape(len(place), shade_size())
    lit = torch.zeros(len(place), len(lamps), dtype=torch.float64)
    lit.index_add_(0, index, weight[:, None] * lamp_light(unit, lamps))
    coverage = torch.zeros(len(place), dtype=torch.float64).index_add_(0, index, weight)
    return torch.cat([design, lit], dim=1), coverage


def _slopes(pixels: SmoothPixels, guess: Guess, shade: Shade) -> Tensor:
    """Give what disc, blur, lamp and nearness add to pixels, [P, 3, 11].

    These are px of the outline, which moves as a whole, by two numbers, and grows in three ways,
    px^2 of blur, two turns of the lamp and the three of `near`. How an outline grows is, pixel by
    pixel, how it moves there.
    """

    def model(places: Places, table: ShadeTable) -> Tensor:
        index, unit, weight = places
        light = weight[:, None] * table.at(unit)
        seen = torch.zeros(len(pixels.place), 4, dtype=torch.float64)
        seen.index_add_(0, index, torch.cat([light, weight[:, None]], dim=1))
        return seen[:, :3] + (1 - seen[:, 3:]) * pixels.behind

    h, disc, spread, near, lamp = 0.02, guess.disc, guess.spread, guess.near, guess.lamp
    table = ShadeTable.of(shade.coefficients, lamp, near)
    places = look_places(pixels.place, disc, spread)
    here = model(places, table)

    def slope(other: Tensor, step: float) -> Tensor:
        return (other - here) / step

    right, down = (
        slope(model(look_places(pixels.place, grown(disc, step), spread), table), h)
        for step in h * torch.eye(5, dtype=torch.float64)[:2]
    )
    x, y = disc.to_unit(pixels.place)[:, :, None].unbind(1)
    turns = [
        slope(model(places, ShadeTable.of(shade.coefficients, turned(lamp, turn), near)), h)
        for turn in h * torch.eye(2, dtype=torch.float64)
    ]
    nearer = [
        slope(model(places, replace(table, near=near + step)), h)
        for step in h * torch.eye(3, dtype=torch.float64)
    ]
    columns = [
        right,
        down,
        x * right + y * down,
        x * right - y * down,
        y * right + x * down,
        slope(model(look_places(pixels.place, disc, spread + h), table), h),
        *turns,
        *nearer,
    ]
    return torch.stack(columns, dim=-1)
