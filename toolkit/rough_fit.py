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
LENS = 0.7
"""px of blur behind an ordinary lens."""
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
"""Travel along the line of sight over all of it and the ball's radius: nothing unusual."""
BEND = 2.0
"""The same of an acceleration, per exposure squared: it bends the path by an eighth of that."""
LATEST_CORNER = 0.45
"""Share of the exposure from its middle up to which a corner may lie."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughPath:
    """Where the ball is at shares t = -0.5 to 0.5 of the exposure.

    Without a corner the coefficients multiply 1, t and perhaps t^2. With one at t = q they multiply
    1, t - q before it, t - q after it and perhaps (t - q)^2: one acceleration acts on both arms.
    """

    coefficients: Tensor  # [K, 3] m
    corner: float | None = None

    def basis(self, time: Tensor) -> Tensor:
        """Give the functions of time that the coefficients multiply, [T, K]."""
        passed = time - (self.corner or 0.0)
        slopes = [passed] if self.corner is None else [passed.clamp_max(0), passed.clamp_min(0)]
        functions = [torch.ones_like(time), *slopes, passed * passed]
        return torch.stack(functions[: len(self.coefficients)], dim=-1)

    def at(self, time: Tensor) -> Tensor:
        """Give the places at times [T], [T, 3] m."""
        return self.basis(time) @ self.coefficients

    def J_corner(self, time: Tensor) -> Tensor:
        """Give the derivative of `at` in the corner's time, [T, 3]."""
        passed = time - (self.corner or 0.0)
        steps = [torch.zeros_like(time), -(passed < 0).double(), -(passed >= 0).double()]
        return torch.stack([*steps, -2 * passed][: len(self.coefficients)], -1) @ self.coefficients

    @property
    def parameters(self) -> Tensor:
        """The coefficients, and the corner's time where there is one, [M]."""
        corner = self.coefficients.new_tensor([] if self.corner is None else [self.corner])
        return torch.cat([self.coefficients.flatten(), corner])

    def with_parameters(self, parameters: Tensor) -> "RoughPath":
        """Give a path of the same kind with other `parameters` [M]."""
        size = self.coefficients.numel()
        return RoughPath(
            coefficients=parameters[:size].reshape(-1, 3),
            corner=None if self.corner is None else float(parameters[size]),
        )

    def accelerated(self) -> "RoughPath":
        """Give the same path as one that may accelerate."""
        none = torch.zeros_like(self.coefficients[:1])
        return replace(self, coefficients=torch.cat([self.coefficients, none]))


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughFit:
    """The path that fits best, and what was left open of the ball's looks."""

    path: RoughPath
    colour: Tensor | None  # [A]
    cost: float  # sum of robust squared residuals
    count: int  # of residuals


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
        travel = _travel(path)
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
        inside = (self.ball_radius - distance) / self.softness
        slope = (-inside * inside / 2).exp() / (math.sqrt(2 * math.pi) * self.softness)
        return torch.special.ndtr(inside), slope, distance, along


def fit_disc(
    blocks: Blocks, estimator: AlphaEstimator, camera: Camera, start: RoughPath, ball_radius: float
) -> RoughFit:
    """Fit a path, and what the estimator leaves open, to the change that every block shows.

    Args:
        blocks: about the streak.
        estimator: of the ball's opacity.
        camera: of the shot.
        start: a path of the kind that is fitted.
        ball_radius: m.
    """
    look = _look(blocks, estimator, camera, start, ball_radius)
    unknowns = _first_unknowns(blocks, look, start, ball_radius)
    path, unknowns, cost = _fit(blocks, look, start, unknowns, ball_radius)
    for _ in range(LOOKS - 1 if _varies(estimator) else 0):
        look = _look(blocks, estimator, camera, path, ball_radius)
        path, unknowns, cost = _fit(blocks, look, path, unknowns, ball_radius)
    return RoughFit(
        path=path,
        colour=unknowns if len(unknowns) else None,
        cost=cost,
        count=int(torch.isfinite(blocks.variance).sum()),
    )


def _fit(
    blocks: Blocks, look: _Look, start: RoughPath, unknowns: Tensor, ball_radius: float
) -> tuple[RoughPath, Tensor, float]:
    """Fit path and unknowns with given colours, from a start."""
    size = len(start.parameters)
    first = torch.cat([start.parameters, unknowns])
    limit = torch.full_like(first, torch.inf)
    if start.corner is not None:
        limit[size - 1] = LATEST_CORNER
    contrast = look.colour(unknowns) - blocks.ground
    std = (blocks.variance + (MODEL_ERROR * contrast) ** 2).sqrt()
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
        lower=-limit[None],
        upper=limit[None],
        huber=HUBER,
        max_iterations=STEPS,
        tolerance=TOLERANCE,
    )
    found = solution.parameters[0]
    return start.with_parameters(found[:size]), found[size:], float(solution.cost[0])


def _held(start: RoughPath, first: Tensor, ball_radius: float) -> Tensor:
    """Give what holds weakly what the opacity may leave open, linear in all parameters [R, P].

    The motion along the line of sight is not much longer than across it, and an acceleration does
    not bend the path by more than its length.
    """
    sight = torch.nn.functional.normalize(start.at(torch.zeros(1, dtype=torch.float64))[0], dim=0)
    travel = _travel(start) + ball_radius
    slopes = 1 if start.corner is None else 2
    rows = []
    for index in range(1, len(start.coefficients)):
        is_bend = index > slopes
        for direction in torch.eye(3, dtype=torch.float64) if is_bend else sight[None]:
            row = torch.zeros_like(first)
            row[3 * index : 3 * index + 3] = direction / (BEND if is_bend else SLANT) / travel
            rows.append(row)
    return torch.stack(rows)


def _travel(path: RoughPath) -> float:
    """Give about how far the ball goes, m."""
    points = path.at(torch.linspace(-0.5, 0.5, 17, dtype=torch.float64))
    return float(torch.linalg.vector_norm(points.diff(dim=0), dim=-1).sum())


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
