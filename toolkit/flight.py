"""The ball's path as free flight: constant acceleration during the exposure, nine numbers in all.

Contours, opacity and ends are explained together by C(t) = p + v t + a t^2 / 2, so that the shape
of the path tells the pace along it as well. Splines know of no such bond; they remain for paths
that are no parabola. [derived]
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import normalize

from toolkit.axis_curve import Curve, Edges, graze_residual, nearest_parameter, to_centre, whitening
from toolkit.camera import Camera
from toolkit.ends import Ends
from toolkit.least_squares import minimise
from toolkit.motion import PATH_POINTS, Motion, OpacityData, propagate

MAX_STEPS = 20
SIZE = 9
"""Numbers in a flight."""
STRAIGHT = 6
"""Numbers in a flight that is not accelerated."""
DURATION = 9
"""Place behind them of the duration that the opacity tells, in exposures."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """A path of constant acceleration; time runs from -1/2 to 1/2 exposure."""

    coefficients: Tensor  # [3, 3] of 1, t and t^2: m, m per exposure, m per exposure^2

    def __call__(self, t: Tensor) -> Tensor:
        """Points of the path at t [...] exposures after the middle: [..., 3] m."""
        return _powers(t) @ self.coefficients

    def tangent(self, t: Tensor) -> Tensor:
        """Velocity at t [...]: [..., 3] m per exposure."""
        return _slopes(t) @ self.coefficients

    def point_and_tangent(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Both at t [...]."""
        return self(t), self.tangent(t)

    def J_point(self, t: Tensor) -> Tensor:
        """Derivative of the points at t [...] in the nine coefficients: [..., 3, 9]."""
        return _for_each_axis(_powers(t))

    @property
    def span(self) -> float:
        """How far the parameter runs along the streak."""
        return 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sightings:
    """All that tells of the flight, P profiles and two ends."""

    edges: Edges
    opacity: OpacityData
    time: Tensor  # [P] rough, exposures after the middle
    end: Tensor  # [2, 2] pixels where the ball stood when the exposure began and ended
    end_along: Tensor  # [2, 2] unit, the motion's direction in the picture there
    end_std: Tensor  # [2] px along it

    @property
    def count(self) -> int:
        """Numbers that the usable profiles tell."""
        return 3 * int((self.opacity.weight > 0).sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightFit:
    """A fitted flight with the covariance of its parameters."""

    flight: Flight
    duration: Tensor  # of the way between the ends as the opacity tells it, in exposures
    covariance: Tensor  # [10, 10] of coefficients and duration
    seen: Sightings
    chi2: float  # of the profiles, about the free flight
    converged: bool
    is_level: bool = False
    """Whether an acceleration along the line of sight was too small to be told from none."""

    def motion(self) -> Motion:
        """Give the state at mid-exposure and the path."""
        time = torch.linspace(-0.5, 0.5, PATH_POINTS, dtype=torch.float64)
        return Motion(
            position=self.flight.coefficients[0],
            displacement=self.flight.coefficients[1],
            path=self.flight(time),
            path_displacement=self.flight.tangent(time),
            duration=self.duration,
        )

    def state_covariance(self) -> Tensor:
        """Carry the covariance to `Motion.state`, [8 + 3 N, 8 + 3 N]."""
        return propagate(lambda shift: self.moved(shift).motion().state(), self.covariance)

    def moved(self, shift: Tensor) -> "FlightFit":
        """Give the same with coefficients and duration shifted by [10]."""
        coefficients = self.flight.coefficients + shift[:SIZE].reshape(3, 3)
        return replace(
            self,
            flight=Flight(coefficients=coefficients),
            duration=self.duration + shift[DURATION],
        )


def start_flight(motion: Motion) -> Flight:
    """Give the flight nearest to a path found otherwise."""
    time = torch.linspace(-0.5, 0.5, len(motion.path), dtype=torch.float64)
    return Flight(coefficients=torch.linalg.lstsq(_powers(time), motion.path).solution)


def see_ends(curve: Curve, ends: Ends, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Give pixels, directions [2, 2] and standard deviations [2] px of ends found on a curve."""
    points = curve(ends.s)
    along = (camera.J_project(points) @ curve.tangent(ends.s)[..., None])[..., 0]
    px = torch.linalg.vector_norm(along, dim=-1)
    return camera.project(points), along / px[:, None], ends.std * px


def fit_flight(
    start: Flight,
    seen: Sightings,
    camera: Camera,
    ball_radius: float,
    *,
    size: int = SIZE,
    steps: int = MAX_STEPS,
) -> FlightFit:
    """Fit the flight to contours, opacity and ends at once.

    The duration scales the opacity: it is 1 where ball colour, response and exposure are right.

    Args:
        start: to search from.
        seen: what is to be explained.
        camera: with distortion.
        ball_radius: m.
        size: STRAIGHT holds the acceleration at 0.
        steps: of the search, at most.
    """
    free = free_parameters(size)

    def whole(parameters: Tensor) -> Tensor:
        return torch.zeros(DURATION + 1, dtype=torch.float64).masked_scatter(free, parameters)

    look = FlightLook.through(camera, seen, ball_radius)

    def problem(parameters: Tensor, _: Tensor) -> tuple[Tensor, Tensor]:
        residual, J = look.residual(whole(parameters[0]))
        return residual[None], J[None, :, free]

    first = torch.cat([start.coefficients.flatten(), torch.ones(1, dtype=torch.float64)])
    solution = minimise(problem, first[None, free], tolerance=1e-3, max_iterations=steps)
    parameters, chi2 = whole(solution.parameters[0]), float(solution.cost[0])
    covariance = torch.zeros(DURATION + 1, DURATION + 1, dtype=torch.float64)
    covariance[torch.outer(free, free)] = solution.covariance[0].flatten()
    flight = Flight(coefficients=parameters[:SIZE].reshape(3, 3))
    ends, _ = _end_residual(flight, seen, camera)
    dof = seen.count + 2 - int(free.sum())
    return FlightFit(
        flight=flight,
        duration=parameters[DURATION],
        covariance=covariance * max(chi2 / dof, 1.0),
        seen=seen,
        chi2=chi2 - float(ends @ ends),
        converged=bool(solution.converged[0]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightLook:
    """What is seen of a flight, through one camera."""

    camera: Camera
    seen: Sightings
    ball_radius: float
    rays: Tensor  # [P, 2, 3] of the edges
    swing: Tensor  # [P, 2, 3] their change for one px
    whiten: Tensor  # [P, 3, 3]

    @classmethod
    def through(cls, camera: Camera, seen: Sightings, ball_radius: float) -> "FlightLook":
        """Find the rays once, for any flight."""
        rays, swing = seen.edges.rays(camera)
        return cls(
            camera=camera,
            seen=seen,
            ball_radius=ball_radius,
            rays=rays,
            swing=swing,
            whiten=whitening(seen.opacity.covariance, seen.opacity.weight),
        )

    def residual(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Give by how many standard deviations a flight [10] misses all, and the derivative."""
        seen, flight = self.seen, Flight(coefficients=parameters[:SIZE].reshape(3, 3))
        sides, J_sides = graze_residual(flight, seen.time, self.rays, self.swing, self.ball_radius)
        opacity, J_opacity = crossing_opacity(
            flight, seen.time, seen.opacity.rays, self.ball_radius
        )
        duration = parameters[DURATION]
        dimmer = (seen.opacity.opacity - duration * opacity)[:, None]
        J_dimmer = -torch.cat([duration * J_opacity, opacity[:, None]], dim=1)[:, None]
        ends, J_ends = _end_residual(flight, seen, self.camera)
        profiles = self.whiten @ torch.cat([to_centre(sides), dimmer], dim=1)[..., None]
        J_profiles = self.whiten @ torch.cat([_widened(to_centre(J_sides)), J_dimmer], dim=1)
        residual = torch.cat([profiles.flatten(), ends])
        return residual, torch.cat([J_profiles.flatten(0, 1), _widened(J_ends)])


def free_parameters(size: int) -> Tensor:
    """Tell which of coefficients and duration are fitted [10] bool."""
    free = torch.ones(DURATION + 1, dtype=torch.bool)
    free[size:SIZE] = False
    return free


def with_known_opacity(fit: FlightFit, std: float = 0.0) -> FlightFit:
    """Condition the flight on a duration of 1; the fitted one stays to be reported.

    Args:
        fit: free flight.
        std: relative standard deviation of the scale of all opacities.
    """
    cause = torch.zeros_like(fit.covariance[0])
    cause[DURATION] = 1
    gain = fit.covariance @ cause / (fit.covariance[DURATION, DURATION] + std**2)
    covariance = fit.covariance - torch.outer(gain, fit.covariance[DURATION])
    covariance[DURATION, DURATION] = fit.covariance[DURATION, DURATION]
    shift = gain * (1 - fit.duration)
    shift[DURATION] = 0
    return replace(fit.moved(shift), covariance=covariance)


def levelled(fit: FlightFit, is_level: bool | None = None) -> FlightFit:
    """Take an acceleration along the line of sight for none, where no more is told from noise.

    Contours tell it least by far. The covariance stays that of a flight in which it is free, so
    that one which is there unnoticed is allowed for.

    Args:
        fit: free flight.
        is_level: None to let the Bayesian information criterion decide.
    """
    along = line_of_sight(fit)
    found = along[:SIZE] @ fit.flight.coefficients.flatten()
    variance = along @ fit.covariance @ along
    if float(variance) == 0:  # not accelerated at all
        return fit
    if is_level is None:
        is_level = float(found**2 / variance) < math.log(fit.seen.count)
    if not is_level:
        return fit
    return replace(fit.moved(-fit.covariance @ along * (found / variance)), is_level=True)


def line_of_sight(fit: FlightFit) -> Tensor:
    """Give the direction of an acceleration along the line of sight, among the parameters [10]."""
    along = torch.zeros_like(fit.covariance[0])
    along[6:SIZE] = normalize(fit.flight.coefficients[0], dim=0)
    return along


def crossing_opacity(
    flight: Flight, time: Tensor, rays: Tensor, ball_radius: float
) -> tuple[Tensor, Tensor]:
    """Give the opacity that profiles would show, and its derivative.

    It is 2R / |v x u| with v the velocity when the ball is nearest to the ray u. Profiles are
    fitted as if the ball kept its pace while it crosses; with an acceleration across the ray of b
    it is faster on average over the crossing and the chords, by 1 + 2/15 (b R / |v x u|^2)^2.
    [derived]

    Args:
        flight: the path.
        time: rough, of each profile [P].
        rays: unit, to the profiles' centres [P, 3].
        ball_radius: m.

    Returns:
        Opacity [P] and its derivative in the nine coefficients [P, 9].
    """
    time = nearest_parameter(flight, time, rays)
    crossing = torch.linalg.cross(flight.tangent(time), rays)
    squared = (crossing * crossing).sum(-1)
    bending = torch.linalg.cross((2 * flight.coefficients[2]).expand_as(rays), rays)
    quickening = (bending * crossing).sum(-1)
    across = (bending * bending).sum(-1) - quickening**2 / squared
    opacity = (
        2 * ball_radius / squared.sqrt() / (1 + 2 / 15 * across * (ball_radius / squared) ** 2)
    )
    # the instant of passing follows the flight; its path misses the ray by too little to matter
    pull = torch.linalg.cross(rays, crossing)[:, None, :]
    J_time = -(pull @ flight.J_point(time))[:, 0] / squared[:, None]
    J_tangent = (pull @ _for_each_axis(_slopes(time)))[:, 0] + quickening[:, None] * J_time
    return opacity, -(opacity / squared)[:, None] * J_tangent


def _end_residual(flight: Flight, seen: Sightings, camera: Camera) -> tuple[Tensor, Tensor]:
    """Standard deviations by which the ends lie off along the motion [2], and derivative [2, 9]."""
    time = torch.tensor([-0.5, 0.5], dtype=torch.float64)
    points = flight(time)
    along = seen.end_along / seen.end_std[:, None]
    residual = (along * (seen.end - camera.project(points))).sum(-1)
    J = -along[:, None, :] @ camera.J_project(points) @ flight.J_point(time)
    return residual, J[:, 0]


def _widened(J: Tensor) -> Tensor:
    """Append the derivative in the duration, 0."""
    return torch.cat([J, torch.zeros_like(J[..., :1])], dim=-1)


def _powers(t: Tensor) -> Tensor:
    return torch.stack([torch.ones_like(t), t, t * t], dim=-1)


def _slopes(t: Tensor) -> Tensor:
    return torch.stack([torch.zeros_like(t), torch.ones_like(t), 2 * t], dim=-1)


def _for_each_axis(powers: Tensor) -> Tensor:
    """Derivative of powers [..., 3] times coefficients [3, 3] in these, [..., 3, 9]."""
    identity = torch.eye(3, dtype=powers.dtype)
    return (powers[..., None, :, None] * identity[:, None, :]).flatten(-2)
