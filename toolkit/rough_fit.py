"""A path fitted to the opacity as the mean of the discs that a ball covers at many instants.

A disc's rim is soft, about as wide as a block of pixels, so that the opacity changes smoothly with
the path, however short that is. [derived]
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.camera import Camera
from toolkit.least_squares import minimise
from toolkit.rough_path import RoughPath
from toolkit.rough_pixels import Blocks

INSTANTS_PER_HALF_WIDTH = 4
MIN_INSTANTS, MAX_INSTANTS = 9, 128
RIM = math.sqrt(5)
"""Half width of a parabola over its standard deviation."""
LENS = 0.7
"""px of blur behind an ordinary lens."""
MODEL_ERROR = 0.08
"""Of a channel's change, root mean square: soft rims and blocks come no closer to the truth."""
HUBER = 4.0
"""Standard deviations."""
STEPS = 30
TOLERANCE = 0.1
"""Standard deviations of a step that ends the search."""
LOOKS = 3
"""How often the colours that each pixel saw are found from the path, where they vary."""
LOOK_INSTANTS = 16
"""Instants at which they are looked up."""
SLANT = 2.0
"""Travel along the line of sight over all of it and the ball's radius: nothing unusual."""
BEND = 2.0
"""The same of an acceleration, per exposure squared: it bends the path by an eighth of that."""
NEAREST, FARTHEST = 0.7, 2.0
"""Bounds of the distance over that told by the mask's width, which is rather too large."""
LATEST_CORNER = 0.45
"""Share of the exposure from its middle up to which a corner may lie."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughFit:
    """The path that fits best, and what was left open of the ball's looks."""

    path: RoughPath
    colour: Tensor | None  # [A]
    cost: float  # sum of robust squared residuals
    count: int  # of residuals
    noise: float  # what noise alone adds to their sum

    @property
    def excess(self) -> float:
        """What of the cost the path does not explain, but for noise."""
        return max(self.cost - self.noise, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """The colour that each block saw of the ball: constant + per_unknown @ unknowns."""

    constant: Tensor  # [N, Q]
    per_unknown: Tensor  # [N, Q, A]

    def colour(self, unknowns: Tensor) -> Tensor:
        return self.constant + self.per_unknown @ unknowns


@dataclass(frozen=True, slots=True, kw_only=True)
class _Discs:
    """The discs whose mean is the opacity: when, how large, and how soft at the rim."""

    time: Tensor  # [T] the middles of equal parts of the exposure
    ball_radius: float  # m
    softness: float  # m at the ball, standard deviation

    @classmethod
    def along(
        cls, path: RoughPath, blocks: Blocks, ball_radius: float, count: int | None = None
    ) -> "_Discs":
        """Choose instants that are not far apart on a path, or as many as told."""
        travel = path.travel()
        if count is None:
            count = math.ceil(INSTANTS_PER_HALF_WIDTH * travel / ball_radius)
            count = min(max(count, MIN_INSTANTS), MAX_INSTANTS)
        # the lens, a block and the way from one instant to the next smear the rim
        pixel = ball_radius / blocks.half_width
        smeared = (LENS * pixel) ** 2 + ((blocks.size * pixel) ** 2 + (travel / count) ** 2) / 12
        time = (torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5
        return cls(time=time, ball_radius=ball_radius, softness=math.sqrt(smeared))

    def cover(self, centre: Tensor, rays: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Give how far the discs of balls at centres [T, 3] cover rays [N, 3].

        Returns:
            The share, its rise as a ray comes nearer (1/m), the ray's distance from the centre and
            its length up to there (m), all [T, N].
        """
        along = centre @ rays.mT
        distance = ((centre * centre).sum(-1, keepdim=True) - along * along).clamp_min(1e-18).sqrt()
        # a rim of parabolic shape, far quicker than a Gaussian one
        reach = RIM * self.softness
        inside = ((self.ball_radius - distance) / reach).clamp(-1, 1)
        squared = inside * inside
        return (
            0.5 + inside * (0.75 - 0.25 * squared),
            (0.75 - 0.75 * squared) / reach,
            distance,
            along,
        )


def fit_disc(
    blocks: Blocks,
    estimator: AlphaEstimator,
    camera: Camera,
    start: RoughPath,
    ball_radius: float,
    *,
    steps: int = STEPS,
) -> RoughFit:
    """Fit a path, and what the estimator leaves open, to the change that every block shows.

    Args:
        blocks: about the streak.
        estimator: of the ball's opacity.
        camera: of the shot.
        start: a path of the kind that is fitted.
        ball_radius: m.
        steps: after which the search ends.
    """
    look = _look(blocks, estimator, camera, start, ball_radius)
    unknowns = _first_unknowns(blocks, look, start, ball_radius)
    found = _fit(blocks, look, start, unknowns, ball_radius, steps)
    for _ in range(LOOKS - 1 if _varies(estimator) and steps >= STEPS else 0):
        look = _look(blocks, estimator, camera, found.path, ball_radius)
        found = _fit(blocks, look, found.path, unknowns, ball_radius, steps)
    return found


def _fit(
    blocks: Blocks,
    look: _Look,
    start: RoughPath,
    unknowns: Tensor,
    ball_radius: float,
    steps: int,
) -> RoughFit:
    """Fit path and unknowns with given colours, from a start."""
    size = len(start.parameters)
    first = torch.cat([start.parameters, unknowns])
    lower, upper = _bounds(start, first, blocks, ball_radius)
    variance = blocks.variance + _model_variance(blocks)
    std = variance.sqrt()
    discs = _Discs.along(start, blocks, ball_radius)
    J_held = _held(start, first, ball_radius)

    def problem(parameters: Tensor, _: Tensor) -> tuple[Tensor, Tensor]:
        path = start.with_parameters(parameters[0, :size])
        alpha, J_alpha = _coverage(path, discs, blocks)
        contrast = look.colour(parameters[0, size:]) - blocks.ground
        residual = (alpha[:, None] * contrast - blocks.change) / std
        J_path = contrast[..., None] * J_alpha[:, None, :] / std[..., None]
        J_unknowns = alpha[:, None, None] * look.per_unknown / std[..., None]
        J = torch.cat([J_path, J_unknowns], dim=-1).flatten(0, 1)
        return (
            torch.cat([residual.flatten(), J_held @ parameters[0]])[None],
            torch.cat([J, J_held])[None],
        )

    solution = minimise(
        problem,
        first[None],
        lower=lower[None],
        upper=upper[None],
        huber=HUBER,
        max_iterations=steps,
        tolerance=TOLERANCE,
    )
    found = solution.parameters[0]
    is_seen = torch.isfinite(blocks.variance)
    return RoughFit(
        path=start.with_parameters(found[:size]),
        colour=found[size:] if len(unknowns) else None,
        cost=float(solution.cost[0]),
        count=int(is_seen.sum()),
        noise=float((blocks.variance / variance)[is_seen].sum()),
    )


def _model_variance(blocks: Blocks) -> Tensor:
    """Give the variance by which the model may err, in proportion to each channel's change [Q]."""
    is_seen = torch.isfinite(blocks.variance)
    signal = torch.where(is_seen, blocks.change**2 - blocks.variance, 0).sum(0)
    return MODEL_ERROR**2 * (signal / is_seen.sum(0).clamp_min(1)).clamp_min(0)


def _bounds(
    start: RoughPath, first: Tensor, blocks: Blocks, ball_radius: float
) -> tuple[Tensor, Tensor]:
    """Bound the depth by the width of the streak's mask, and the time of a corner, [P] each.

    A large, transparent ball may explain a bent streak better than any other on a straight path.
    """
    lower, upper = torch.full_like(first, -torch.inf), torch.full_like(first, torch.inf)
    place = start.coefficients[0]
    depth = float(place[2] / torch.linalg.vector_norm(place)) * ball_radius / blocks.half_angle
    lower[2], upper[2] = NEAREST * depth, FARTHEST * depth
    if start.corner is not None:
        corner = len(start.parameters) - 1
        lower[corner], upper[corner] = -LATEST_CORNER, LATEST_CORNER
    return lower, upper


def _held(start: RoughPath, first: Tensor, ball_radius: float) -> Tensor:
    """Give what holds weakly what the opacity may leave open, linear in all parameters [R, P].

    The motion along the line of sight is not much longer than across it, and an acceleration does
    not bend the path by more than its length.
    """
    sight = torch.nn.functional.normalize(start.at(torch.zeros(1, dtype=torch.float64))[0], dim=0)
    travel = start.travel() + ball_radius
    slopes = 1 if start.corner is None else 2
    rows = []
    for index in range(1, len(start.coefficients)):
        is_bend = index > slopes
        for direction in torch.eye(3, dtype=torch.float64) if is_bend else sight[None]:
            row = torch.zeros_like(first)
            row[3 * index : 3 * index + 3] = direction / (BEND if is_bend else SLANT) / travel
            rows.append(row)
    return torch.stack(rows)


def _coverage(path: RoughPath, discs: _Discs, blocks: Blocks) -> tuple[Tensor, Tensor]:
    """Give the share of the instants at which the ball covers each block, and its derivative.

    Returns:
        Opacity [N], and derivative in the path's parameters [N, M].
    """
    time = discs.time
    basis = path.basis(time)
    centre = basis @ path.coefficients
    covered, slope, distance, along = discs.cover(centre, blocks.rays)
    pull = slope / distance / len(time)  # [T, N]
    # the ray's distance grows along the part of the centre that is square to the ray
    weighted = basis[:, :, None] * centre[:, None, :]  # [T, K, 3]
    J = -torch.einsum("tn,tkc->nkc", pull, weighted)
    J = J + torch.einsum("tn,tk->nk", pull * along, basis)[..., None] * blocks.rays[:, None, :]
    if path.corner is None:
        return covered.mean(0), J.flatten(1)
    swing = path.J_corner(time)
    J_corner = (pull * (along * (swing @ blocks.rays.mT))).sum(0)
    J_corner = J_corner - (pull * (centre * swing).sum(-1, keepdim=True)).sum(0)
    return covered.mean(0), torch.cat([J.flatten(1), J_corner[:, None]], dim=1)


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
    discs = _Discs.along(path, blocks, ball_radius, LOOK_INSTANTS if _varies(estimator) else 1)
    centre = path.at(discs.time)
    covered, *_ = discs.cover(centre, blocks.rays)
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
    alpha, _ = _coverage(path, _Discs.along(path, blocks, ball_radius), blocks)
    design = alpha[:, None, None] * look.per_unknown
    rest = blocks.change - alpha[:, None] * (look.constant - blocks.ground)
    weight = 1 / blocks.variance
    normal = torch.einsum("nqu,nq,nqv->uv", design, weight, design)
    right = torch.einsum("nqu,nq,nq->u", design, weight, rest)
    unknowns: Tensor = torch.linalg.lstsq(normal, right[:, None]).solution[:, 0]
    return unknowns
