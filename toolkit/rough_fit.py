"""A path fitted to the opacity as the mean of the discs that a ball covers at many instants.

A disc's rim is soft, about as wide as a block of pixels, so that the opacity changes smoothly with
the path, however short that is. [derived]
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.camera import Camera
from toolkit.least_squares import minimise
from toolkit.rough_pixels import Blocks

INSTANTS_PER_HALF_WIDTH = 4
MIN_INSTANTS, MAX_INSTANTS = 9, 64
SOFTNESS = 0.1
"""Half widths from the middle of a soft rim to where 16 % or 84 % are covered."""
MODEL_ERROR = 0.05
"""Of the opacity: soft rims and blocks come no closer to the truth."""
HUBER = 4.0
"""Standard deviations."""
STEPS = 30
TOLERANCE = 0.1
"""Standard deviations of a step that ends the search."""
LOOKS = 3
"""How often the colours that each pixel saw are found from the path, where they vary."""
LOOK_INSTANTS = 12
"""Instants at which they are looked up."""
SLANT = 2.0
"""Travel along the line of sight over that across it and the ball's radius: nothing unusual."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughPath:
    """Where the ball is at shares t = -0.5 to 0.5 of the exposure: a straight line or an arc."""

    coefficients: Tensor  # [K, 3] m, of 1, t and perhaps t^2

    def basis(self, time: Tensor) -> Tensor:
        """Give the functions of time that the coefficients multiply, [T, K]."""
        return torch.stack([time**power for power in range(len(self.coefficients))], dim=-1)

    def at(self, time: Tensor) -> Tensor:
        """Give the places at times [T], [T, 3] m."""
        return self.basis(time) @ self.coefficients


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughFit:
    """The path that fits best, and what was left open of the ball's looks."""

    path: RoughPath
    colour: Tensor | None  # [A]
    cost: float  # sum of robust squared residuals


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """The colour that each block saw of the ball: constant + per_unknown @ unknowns."""

    constant: Tensor  # [N, Q]
    per_unknown: Tensor  # [N, Q, A]

    def colour(self, unknowns: Tensor) -> Tensor:
        return self.constant + self.per_unknown @ unknowns


def fit_disc(
    blocks: Blocks, estimator: AlphaEstimator, camera: Camera, start: RoughPath, ball_radius: float
) -> RoughFit:
    """Fit a path, and what the estimator leaves open, to the change that every block shows."""
    look = _look(blocks, estimator, camera, start, ball_radius)
    unknowns = _first_unknowns(blocks, look, start, ball_radius)
    path, unknowns, cost = _fit(blocks, look, start, unknowns, ball_radius)
    for _ in range(LOOKS - 1 if _varies(estimator) else 0):
        look = _look(blocks, estimator, camera, path, ball_radius)
        path, unknowns, cost = _fit(blocks, look, path, unknowns, ball_radius)
    return RoughFit(path=path, colour=unknowns if len(unknowns) else None, cost=cost)


def _fit(
    blocks: Blocks, look: _Look, start: RoughPath, unknowns: Tensor, ball_radius: float
) -> tuple[RoughPath, Tensor, float]:
    """Fit path and unknowns with given colours, from a start."""
    size = start.coefficients.numel()
    first = torch.cat([start.coefficients.flatten(), unknowns])
    contrast = look.colour(unknowns) - blocks.ground
    std = (blocks.variance + (MODEL_ERROR * contrast) ** 2).sqrt()
    time = _instants(start, ball_radius)
    sight = torch.nn.functional.normalize(start.coefficients[0], dim=0)
    travel = float(torch.linalg.vector_norm(start.at(time[-1:]) - start.at(time[:1])))
    slant = SLANT * (travel + ball_radius)

    def problem(parameters: Tensor, _: Tensor) -> tuple[Tensor, Tensor]:
        path = replace(start, coefficients=parameters[0, :size].reshape(-1, 3))
        alpha, J_alpha = _coverage(path, time, blocks, ball_radius)
        contrast = look.colour(parameters[0, size:]) - blocks.ground
        residual = (alpha[:, None] * contrast - blocks.change) / std
        J_path = contrast[..., None] * J_alpha[:, None, :] / std[..., None]
        J_unknowns = alpha[:, None, None] * look.per_unknown / std[..., None]
        J = torch.cat([J_path, J_unknowns], dim=-1).flatten(0, 1)
        along = (path.coefficients[1:] @ sight) / slant
        J_along = torch.zeros(len(along), len(first), dtype=torch.float64)
        for row in range(len(along)):
            J_along[row, 3 * (row + 1) : 3 * (row + 2)] = sight / slant
        return torch.cat([residual.flatten(), along])[None], torch.cat([J, J_along])[None]

    solution = minimise(
        problem, first[None], huber=HUBER, max_iterations=STEPS, tolerance=TOLERANCE
    )
    found = solution.parameters[0]
    path = replace(start, coefficients=found[:size].reshape(-1, 3))
    return path, found[size:], float(solution.cost[0])


def _instants(path: RoughPath, ball_radius: float) -> Tensor:
    """Choose instants, the middles of equal parts of the exposure, not far apart on the path."""
    ends = path.at(torch.linspace(-0.5, 0.5, 9, dtype=torch.float64))
    travel = float(torch.linalg.vector_norm(ends.diff(dim=0), dim=-1).sum())
    count = math.ceil(INSTANTS_PER_HALF_WIDTH * travel / ball_radius)
    count = min(max(count, MIN_INSTANTS), MAX_INSTANTS)
    return (torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5


def _coverage(
    path: RoughPath, time: Tensor, blocks: Blocks, ball_radius: float
) -> tuple[Tensor, Tensor]:
    """Give the share of the instants at which the ball covers each block, and its derivative.

    Returns:
        Opacity [N], and derivative in the path's parameters [N, 3 K].
    """
    basis = path.basis(time)
    centre = basis @ path.coefficients
    covered, slope, distance, along = _discs(centre, blocks.rays, ball_radius)
    pull = slope / distance / len(time)  # [T, N]
    # the ray's distance grows along the part of the centre that is square to the ray
    weighted = basis[:, :, None] * centre[:, None, :]  # [T, K, 3]
    J = -torch.einsum("tn,tkc->nkc", pull, weighted)
    J = J + torch.einsum("tn,tk->nk", pull * along, basis)[..., None] * blocks.rays[:, None, :]
    return covered.mean(0), J.flatten(1)


def _discs(
    centre: Tensor, rays: Tensor, ball_radius: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Give how far balls at centres [T, 3] cover rays, with a soft rim, and the way to the rays.

    Returns:
        The share, its rise as a ray comes nearer (1/m), the ray's distance from the centre and its
        length up to there (m), all [T, N].
    """
    along = centre @ rays.mT
    distance = ((centre * centre).sum(-1, keepdim=True) - along * along).clamp_min(1e-18).sqrt()
    softness = SOFTNESS * ball_radius
    inside = (ball_radius - distance) / softness
    slope = (-inside * inside / 2).exp() / (math.sqrt(2 * math.pi) * softness)
    return torch.special.ndtr(inside), slope, distance, along


def _varies(estimator: AlphaEstimator) -> bool:
    """Whether a ball shows several colours, so that a pixel's depends on the path."""
    unknowns = _zeros(estimator)
    chord = Chord(
        offset=torch.linspace(-0.5, 0.5, 3, dtype=torch.float64),
        direction=torch.zeros(1, dtype=torch.float64),
    )
    return estimator.foreground_and_slope(chord, unknowns)[1] is not None


def _zeros(estimator: AlphaEstimator) -> Tensor | None:
    count = estimator.unknowns()
    return torch.zeros(count, dtype=torch.float64) if count else None


def _look(
    blocks: Blocks, estimator: AlphaEstimator, camera: Camera, path: RoughPath, ball_radius: float
) -> _Look:
    """Average the colours of the disc that passed over each block, as often as it was there."""
    count = LOOK_INSTANTS if _varies(estimator) else 1
    time = (torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5
    centre = path.at(time)
    covered, *_ = _discs(centre, blocks.rays, ball_radius)
    # what no disc covered sees the rim
    weight = (covered + 1e-6) / (covered + 1e-6).sum(0)
    chord = _points_of_discs(blocks, camera, centre, ball_radius)
    zeros, values = _zeros(estimator), torch.eye(estimator.unknowns(), dtype=torch.float64)

    def mean(unknowns: Tensor | None) -> Tensor:
        colour = estimator.foreground(chord, unknowns).reshape(*weight.shape, -1)
        return torch.einsum("tn,tnq->nq", weight, colour)

    constant = mean(zeros)
    units = [mean(unit) - constant for unit in values]
    per_unknown = torch.stack(units, dim=-1) if units else constant.new_zeros(*constant.shape, 0)
    return _Look(constant=constant, per_unknown=per_unknown)


def _points_of_discs(blocks: Blocks, camera: Camera, centre: Tensor, ball_radius: float) -> Chord:
    """Give short parts of chords, at which blocks lie on the discs about centres [T N]."""
    middle = camera.project(centre)
    heading = middle[-1] - middle[0]
    direction = torch.atan2(heading[1], heading[0])
    tangent = torch.stack([direction.cos(), direction.sin()])
    normal = torch.stack([-direction.sin(), direction.cos()])
    squared = (centre * centre).sum(-1) - ball_radius**2
    half_width = ball_radius * math.sqrt(camera.fx * camera.fy) / squared.sqrt()
    apart = (blocks.place - middle[:, None]) / half_width[:, None, None]
    offset = (apart @ normal).clamp(-1, 1).flatten()
    half_chord = (1 - offset * offset).clamp_min(1e-6).sqrt()
    along = ((apart @ tangent).flatten() / half_chord).clamp(-1, 1)
    return Chord(
        offset=offset,
        direction=direction[None],
        start=(along - 0.1).clamp_min(-1),
        stop=(along + 0.1).clamp_max(1),
        place=middle[len(middle) // 2][None],
    )


def _first_unknowns(blocks: Blocks, look: _Look, path: RoughPath, ball_radius: float) -> Tensor:
    """Find what is linear in the change, for a given path, by least squares [A]."""
    alpha, _ = _coverage(path, _instants(path, ball_radius), blocks, ball_radius)
    design = alpha[:, None, None] * look.per_unknown
    rest = blocks.change - alpha[:, None] * (look.constant - blocks.ground)
    weight = 1 / blocks.variance
    normal = torch.einsum("nqu,nq,nqv->uv", design, weight, design)
    right = torch.einsum("nqu,nq,nq->u", design, weight, rest)
    unknowns: Tensor = torch.linalg.lstsq(normal, right[:, None]).solution[:, 0]
    return unknowns
