"""How a flight follows the camera through which it was seen, to first order."""

import torch
from torch import Tensor
from torch.nn.functional import normalize

from toolkit.axis_curve import nearest_parameter, to_centre
from toolkit.camera import Camera
from toolkit.flight import (
    DURATION,
    SIZE,
    Flight,
    FlightFit,
    FlightLook,
    crossing_opacity,
    free_parameters,
    line_of_sight,
)
from toolkit.least_squares import invert_information


def answer_to_camera(
    fit: FlightFit, camera: Camera, ball_radius: float, opacity_std: float, size: int
) -> Tensor:
    """Give how coefficients and duration follow the camera's parameters, [10, 4 + K].

    To first order, by the fit's own equations; what was conditioned on the opacity or levelled
    stays so.

    Args:
        fit: conditioned by `with_known_opacity`, perhaps levelled.
        camera: it was made through.
        ball_radius: m.
        opacity_std: as `with_known_opacity` had it.
        size: as `fit_flight` had it.
    """
    look, free = FlightLook.through(camera, fit.seen, ball_radius), free_parameters(size)
    parameters = torch.cat([fit.flight.coefficients.flatten(), fit.duration[None]])
    residual, J = look.residual(parameters)
    J = J[:, free]
    inverse = invert_information((J.mT @ J)[None])[0]
    answer = torch.zeros(DURATION + 1, len(camera.parameters), dtype=torch.float64)
    answer[free] = -inverse @ (J.mT @ J_camera(look, parameters))
    scale = max(float(residual @ residual) / (fit.seen.count + 2 - int(free.sum())), 1.0)
    covariance = torch.zeros(DURATION + 1, DURATION + 1, dtype=torch.float64)
    covariance[torch.outer(free, free)] = (scale * inverse).flatten()
    gain = covariance[:, DURATION] / (covariance[DURATION, DURATION] + opacity_std**2)
    gain[DURATION] = 0
    answer = answer - torch.outer(gain, answer[DURATION])
    if fit.is_level:
        along = line_of_sight(fit)
        variance = along @ fit.covariance @ along
        answer = answer - torch.outer(fit.covariance @ along / variance, along @ answer)
    return answer


def J_camera(look: FlightLook, parameters: Tensor) -> Tensor:
    """Give the derivative of the residual in the camera's parameters [..., 4 + K].

    Rays turn under what is seen; how their passing by the ball follows from that is known from
    the points of the flight nearest to them.
    """
    seen, flight = look.seen, Flight(coefficients=parameters[:SIZE].reshape(3, 3))
    turn = _turn(look.camera, look.rays)
    time = nearest_parameter(flight, seen.time[:, None].expand(-1, 2), look.rays)
    point = flight(time)
    unit = normalize(torch.linalg.cross(point, look.rays), dim=-1)
    pull = torch.linalg.cross(unit, point)
    per_px = (pull * look.swing).sum(-1, keepdim=True)
    sides = (pull[..., None, :] @ turn)[..., 0, :] / per_px
    middle = seen.opacity.rays
    opacity, _ = crossing_opacity(flight, seen.time, middle, look.ball_radius)
    fall = _fall_with_ray(flight, nearest_parameter(flight, seen.time, middle), middle)
    fainter = (fall[:, None] @ _turn(look.camera, middle))[:, 0]
    dimmer = (parameters[DURATION] * opacity)[:, None] * fainter
    profiles = look.whiten @ torch.cat([to_centre(sides), dimmer[:, None]], dim=1)
    moved = look.camera.J_parameters(flight(torch.tensor([-0.5, 0.5], dtype=torch.float64)))
    along = seen.end_along / seen.end_std[:, None]
    return torch.cat([profiles.flatten(0, 1), -(along[:, None] @ moved)[:, 0]])


def _fall_with_ray(flight: Flight, time: Tensor, rays: Tensor) -> Tensor:
    """Give by what share the opacity falls as the rays [P, 3] turn, [P, 3]; it is 2R / |v x u|.

    The ball passes a ray that is turned along its motion at another time, with another velocity.
    """
    point, velocity = flight.point_and_tangent(time)
    bend = (2 * flight.coefficients[2]).expand_as(rays)
    crossing = torch.linalg.cross(velocity, rays)

    def along(vectors: Tensor) -> Tensor:
        total: Tensor = (vectors * rays).sum(-1, keepdim=True)
        return total

    # the time of passing makes p.v - (p.u)(v.u) vanish
    by_ray = point * along(velocity) + velocity * along(point)
    by_time = (velocity * velocity + point * bend).sum(-1, keepdim=True)
    by_time = by_time - along(velocity) ** 2 - along(point) * along(bend)
    quickening = (crossing * torch.linalg.cross(bend, rays)).sum(-1, keepdim=True)
    fall = torch.linalg.cross(crossing, velocity) + quickening * by_ray / by_time
    share: Tensor = fall / (crossing * crossing).sum(-1, keepdim=True)
    return share


def _turn(camera: Camera, rays: Tensor) -> Tensor:
    """Give how rays [..., 3] of fixed pixels follow the camera's parameters [..., 3, 4 + K]."""
    _, J = camera.unproject_and_J(camera.project(rays))
    return -J @ camera.J_parameters(rays)
