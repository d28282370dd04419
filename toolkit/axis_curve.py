"""One smooth curve in space that explains all contour points of a streak.

Each contour ray u grazes the tube the ball swept: the smallest distance of the axis from it, min
over s of |A(s) x u|, equals the ball radius. This needs neither tangents nor coupling, holds for
any lens, and is the maximum-likelihood use of the profiles' edges. [derived]

The curve is A(s) = (x(s), y(s), 1) / q(s) with splines x, y in normalised image coordinates and q,
the inverse depth. A line in space is then exactly linear in s, whatever its tilt. The image of the
curve may move across itself only, which pins the parameter s: that of a profile stays where it was
along the streak.
"""

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.least_squares import Solution, minimise
from toolkit.splines import SIZES, SplineBasis, fit_smooth, fit_spline

GRAZE_STEPS = 3
"""Gauss-Newton steps to the point of the axis nearest to a ray; each gains two digits or more."""
GRAZED = 1e-4
"""Share of the streak's length that the last step may be long: the distance hardly changes."""
MAX_STEPS = 40
IMAGE_CONTINUATION, DEPTH_CONTINUATION = 2, 1
"""Degrees with which path and inverse depth go on beyond the contours, over the streak's ends."""
DEPTH_SIZES = (2, 3, 4, 5, 6, 8)
"""Coefficients tried for the inverse depth."""


class Curve(Protocol):
    """A path of the ball's centre with a parameter that runs along the streak."""

    def __call__(self, s: Tensor, /) -> Tensor:
        """Points of the curve at s [...]: [..., 3] m."""

    def tangent(self, s: Tensor, /) -> Tensor:
        """Derivative of the point in s [..., 3]."""

    def point_and_tangent(self, s: Tensor, /) -> tuple[Tensor, Tensor]:
        """Both at s [...]."""

    def J_point(self, s: Tensor, /) -> Tensor:
        """Derivative of points at fixed s in the curve's K parameters: [..., 3, K]."""

    @property
    def span(self) -> float:
        """How far s runs along the streak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisCurve:
    """The path of the ball's centre; s runs along the streak, in px of an ideal lens."""

    image_basis: SplineBasis
    depth_basis: SplineBasis
    image: Tensor  # [K, 2] coefficients of (x/z, y/z)
    inverse_depth: Tensor  # [L] coefficients of 1/z, 1/m
    across: Tensor  # [K, 2] unit vectors along which the image coefficients may move

    def __call__(self, s: Tensor) -> Tensor:
        """Points of the curve at s [...]: [..., 3] m."""
        normalised, inverse_depth = self._parts(s)
        return _homogeneous(normalised, 1.0) / inverse_depth

    def tangent(self, s: Tensor) -> Tensor:
        """Derivative of the point in s, [..., 3] m per px."""
        return self.point_and_tangent(s)[1]

    def point_and_tangent(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """Give both at s [...], [..., 3] each: much of the work is the same."""
        at = s.numpy()
        (x, y), (x_slope, y_slope) = self.image_basis.value_and_slope(at, self.image.numpy())
        (q,), (q_slope,) = self.depth_basis.value_and_slope(at, self.inverse_depth.numpy()[:, None])
        z = 1 / q
        x, y, fall = x * z, y * z, q_slope * z
        point = np.stack([x, y, z], axis=-1)
        tangent = [x_slope * z - x * fall, y_slope * z - y * fall, -z * fall]
        return torch.from_numpy(point), torch.from_numpy(np.stack(tangent, axis=-1))

    def J_point(self, s: Tensor) -> Tensor:
        """Derivative of points at fixed s in (across [K], inverse depth [L]): [..., 3, K + L]."""
        image, depth = self.image_basis(s), self.depth_basis(s)
        inverse_depth = (depth @ self.inverse_depth)[..., None]
        sideways = _homogeneous(self.across, 0.0).mT * image[..., None, :]
        point = _homogeneous(image @ self.image, 1.0) / inverse_depth
        deeper = -point[..., None] * depth[..., None, :]
        return torch.cat([sideways, deeper], dim=-1) / inverse_depth[..., None]

    @property
    def span(self) -> float:
        """How far s runs along the streak, px."""
        return self.image_basis.stop - self.image_basis.start

    @property
    def is_line(self) -> bool:
        """Whether the curve is straight in space."""
        return len(self.image) == 2 and len(self.inverse_depth) == 2

    @property
    def parameters(self) -> Tensor:
        """(shift across [K], inverse depth [L]), the shift being 0 where the curve stands."""
        return torch.cat([torch.zeros_like(self.image[:, 0]), self.inverse_depth])

    def moved(self, parameters: Tensor) -> "AxisCurve":
        """Give the curve with other parameters [K + L]."""
        shift, inverse_depth = parameters[: len(self.image)], parameters[len(self.image) :]
        return replace(
            self, image=self.image + shift[:, None] * self.across, inverse_depth=inverse_depth
        )

    def curvature_radius(self, s: Tensor) -> Tensor:
        """Radius of the curve's bend at s [N], m; infinite where straight."""
        step = self.span / 200
        tangent = self.tangent(s)
        bend = (self.tangent(s + step) - self.tangent(s - step)) / (2 * step)
        speed = torch.linalg.vector_norm(tangent, dim=-1)
        radius: Tensor = speed**3 / torch.linalg.vector_norm(
            torch.linalg.cross(tangent, bend), dim=-1
        )
        return radius

    def _parts(self, s: Tensor) -> tuple[Tensor, Tensor]:
        normalised = self.image_basis(s) @ self.image
        return normalised, (self.depth_basis(s) @ self.inverse_depth)[..., None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Edges:
    """What the profiles say about the contours, P of them."""

    s: Tensor  # [P] px along the streak, ideal lens
    pixels: Tensor  # [P, 2, 2] left and right edge
    normal: Tensor  # [P, 2] unit
    covariance: Tensor  # [P, 2, 2] of centre and half width, px^2
    weight: Tensor  # [P] 1, or less for outliers, 0 for profiles to ignore

    def rays(self, camera: Camera) -> tuple[Tensor, Tensor]:
        """Unit rays of both edges and their change for one px along the normal, [P, 2, 3] each."""
        rays, J = camera.unproject_and_J(self.pixels)
        return rays, (J @ self.normal[:, None, :, None])[..., 0]


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisFit:
    """The fitted curve with the covariance of its parameters."""

    curve: AxisCurve
    covariance: Tensor  # [K + L, K + L]
    gain: Tensor  # [P, K + L, 2] how the parameters follow each profile's centre and half width
    chi2: float
    chi2_per_dof: float
    converged: bool


def start_curve(
    centres: Tensor,
    s: Tensor,
    weight: Tensor,
    depth: Tensor,
    depth_weight: Tensor,
    sizes: tuple[int, ...] = SIZES,
) -> AxisCurve:
    """Make a first curve from the middles of the profiles and rough depths.

    Args:
        centres: normalised image coordinates of the profile centres [P, 2].
        s: px along the streak [P].
        weight: of each centre, 1 / variance in normalised units [P].
        depth: rough depth at each profile [P] m.
        depth_weight: [P].
        sizes: numbers of coefficients to choose from for the image of the curve.
    """
    chosen = fit_smooth(s, centres, weight, sizes)
    basis = replace(chosen.basis, continuation=IMAGE_CONTINUATION)
    depth_basis = SplineBasis(
        start=basis.start, stop=basis.stop, size=2, continuation=DEPTH_CONTINUATION
    )
    inverse_depth, _ = fit_spline(depth_basis, s, 1 / depth[:, None], depth_weight)
    return start_curve_on(basis, centres, s, chosen.weight, depth_basis, inverse_depth[:, 0])


def start_curve_on(
    basis: SplineBasis,
    centres: Tensor,
    s: Tensor,
    weight: Tensor,
    depth_basis: SplineBasis,
    inverse_depth: Tensor,
) -> AxisCurve:
    """Make a first curve on a given basis; the arguments are those of `start_curve`."""
    image, _ = fit_spline(basis, s, centres, weight)
    slope = basis(_greville(basis), 1) @ image
    across = torch.stack([-slope[:, 1], slope[:, 0]], dim=-1)
    return AxisCurve(
        image_basis=basis,
        depth_basis=depth_basis,
        image=image,
        inverse_depth=inverse_depth,
        across=across / torch.linalg.vector_norm(across, dim=-1, keepdim=True),
    )


def fit_axis(
    start: AxisCurve,
    edges: Edges,
    camera: Camera,
    ball_radius: float,
    sizes: tuple[int, ...] = DEPTH_SIZES,
    steps: int = MAX_STEPS,
) -> AxisFit:
    """Fit the curve whose tube all contour rays graze, its depth as flexible as the data ask for.

    Args:
        start: first curve.
        edges: contour points with their covariance.
        camera: with distortion.
        ball_radius: m.
        sizes: numbers of depth coefficients to choose from; two without gain end the search.
        steps: most Gauss-Newton steps for each.

    Returns:
        AxisFit of the smallest Bayesian information criterion.
    """
    rays, swing = edges.rays(camera)
    per_coefficient = math.log(2 * float((edges.weight > 0).sum()))
    curve, best, lowest, since_best = start, None, math.inf, 0
    for size in sizes:
        fit = _fit_one(_with_depth_size(curve, size), edges, rays, swing, ball_radius, steps)
        curve = fit.curve
        criterion = fit.chi2 + per_coefficient * size
        if best is None or criterion < lowest:
            best, lowest, since_best = fit, criterion, 0
        else:
            since_best += 1
        if since_best == 2:
            break
    if best is None:
        raise ConfigError("no number of depth coefficients was given to choose from")
    return best


def _fit_one(
    curve: AxisCurve, edges: Edges, rays: Tensor, swing: Tensor, ball_radius: float, steps: int
) -> AxisFit:
    whiten = whitening(edges.covariance, edges.weight)
    usable = float((edges.weight > 0).sum())

    def raw(parameters: Tensor) -> tuple[Tensor, Tensor]:
        return graze_residual(curve.moved(parameters), edges.s, rays, swing, ball_radius)

    def problem(parameters: Tensor, _: Tensor) -> tuple[Tensor, Tensor]:
        residual, J = raw(parameters[0])
        residual = (whiten @ to_centre(residual)[..., None])[..., 0]
        J = whiten @ to_centre(J)
        return residual.reshape(1, -1), J.reshape(1, -1, J.shape[-1])

    solution: Solution = minimise(
        problem, curve.parameters[None], tolerance=1e-3, max_iterations=steps
    )
    parameters = solution.parameters[0]
    chi2 = float(solution.cost[0])
    covariance = solution.covariance[0]
    J = problem(solution.parameters, torch.zeros(1))[1].reshape(len(edges.s), 2, -1)
    return AxisFit(
        curve=curve.moved(parameters),
        covariance=covariance,
        gain=-covariance @ (J.mT @ whiten),
        chi2=chi2,
        chi2_per_dof=chi2 / max(2 * usable - len(parameters), 1.0),
        converged=bool(solution.converged[0]),
    )


def graze_residual(
    curve: Curve, s: Tensor, rays: Tensor, swing: Tensor, ball_radius: float
) -> tuple[Tensor, Tensor]:
    """Say by how many px each contour point lies inside (-) or outside (+) the curve's tube.

    Args:
        curve: the axis.
        s: where along it to start looking for the nearest point [P].
        rays: of the left and right edges [P, 2, 3].
        swing: derivative of those rays for one px along the profile's normal [P, 2, 3].
        ball_radius: m.

    Returns:
        Residuals along the normal [P, 2] px, and their derivative in the parameters [P, 2, K].
    """
    nearest = nearest_parameter(curve, s[:, None].expand(-1, 2), rays)
    point = curve(nearest)
    moment = torch.linalg.cross(point, rays)
    distance = torch.linalg.vector_norm(moment, dim=-1, keepdim=True)
    unit = moment / distance
    # |A x u| changes with the point by (u x m), with the ray by (m x A), m being the unit moment
    per_px = (torch.linalg.cross(unit, point) * swing).sum(-1)
    residual = (distance[..., 0] - ball_radius) / per_px
    # the derivative belongs to where the contour is predicted: taken at the noisy edge it would
    # follow the noise, which draws the ball nearer by the square of noise over half width
    predicted = torch.nn.functional.normalize(rays - residual[..., None] * swing, dim=-1)
    unit = torch.nn.functional.normalize(torch.linalg.cross(point, predicted), dim=-1)
    pull = torch.linalg.cross(predicted, unit)[..., None, :] @ curve.J_point(nearest)
    return residual, pull[..., 0, :] / per_px[..., None]


def nearest_parameter(curve: Curve, s: Tensor, rays: Tensor) -> Tensor:
    """Give the parameter at which the curve is nearest to each ray, starting from s [...]."""
    for _ in range(GRAZE_STEPS):
        point, tangent = curve.point_and_tangent(s)
        moment, slope = torch.linalg.cross(point, rays), torch.linalg.cross(tangent, rays)
        step = -(moment * slope).sum(-1) / (slope * slope).sum(-1).clamp_min(1e-300)
        s = s + step.clamp(-curve.span / 4, curve.span / 4)
        if float(step.abs().max()) < GRAZED * curve.span:
            break
    return s


def to_centre(sides: Tensor) -> Tensor:
    """Turn shifts of the left and right edge [P, 2, ...] into those of centre and half width."""
    left, right = sides[:, 0], sides[:, 1]
    return torch.stack([(left + right) / 2, (right - left) / 2], dim=1)


def whitening(covariance: Tensor, weight: Tensor) -> Tensor:
    """Give W with W'W the inverse covariance [P, K, K] times the weight [P]; 0 without weight."""
    identity = torch.eye(covariance.shape[-1], dtype=covariance.dtype).expand_as(covariance)
    usable = torch.where((weight > 0)[:, None, None], covariance, identity)
    factor: Tensor = torch.linalg.cholesky(torch.linalg.inv(usable)).mT
    return factor * weight.sqrt()[:, None, None]


def _with_depth_size(curve: AxisCurve, size: int) -> AxisCurve:
    """Give the same curve with another number of depth coefficients."""
    if size == len(curve.inverse_depth):
        return curve
    basis = replace(curve.depth_basis, size=size)
    s = torch.linspace(basis.start, basis.stop, 10 * size, dtype=curve.image.dtype)
    values = curve.depth_basis(s) @ curve.inverse_depth
    coefficients, _ = fit_spline(basis, s, values[:, None], torch.ones_like(s))
    return replace(curve, depth_basis=basis, inverse_depth=coefficients[:, 0])


def _greville(basis: SplineBasis) -> Tensor:
    """Where each coefficient acts most: averages of `degree` successive knots."""
    degree, pieces = basis.degree, basis.size - basis.degree
    knots = torch.arange(-degree, pieces + degree + 1, dtype=torch.float64).clamp(0, pieces)
    inner = knots[1:-1].unfold(0, degree, 1).mean(-1)
    return basis.start + (basis.stop - basis.start) * inner / pieces


def _homogeneous(values: Tensor, last: float) -> Tensor:
    return torch.cat([values, torch.full_like(values[..., :1], last)], dim=-1)
