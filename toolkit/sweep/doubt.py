"""What the answer inherits from noise, camera, radius, exposure and response, each kept apart."""

from dataclasses import replace

import torch
from torch import Tensor

from toolkit.motion import PATH_POINTS, SPEED, Motion
from toolkit.sweep.fit import SweepFit
from toolkit.sweep.misfit import Misfit
from toolkit.sweep.relight import JointLight
from toolkit.uncertainty import Uncertainty


def motion_of(fit: SweepFit) -> Motion:
    """Give the state at mid-exposure and the path, lengths per exposure."""
    time = torch.linspace(-0.5, 0.5, PATH_POINTS, dtype=torch.float64)
    arcs = fit.model.path.arcs(fit.parameters[: fit.model.path.size])
    path, displacement = arcs.at(time)
    middle = PATH_POINTS // 2
    return Motion(
        position=path[middle],
        displacement=displacement[middle],
        path=path,
        path_displacement=displacement,
        duration=torch.ones((), dtype=torch.float64),
    )


def J_state(fit: SweepFit) -> Tensor:
    """Give the derivative of `Motion.state` in the path's parameters [8 + 3 N, K]."""
    time = torch.linspace(-0.5, 0.5, PATH_POINTS, dtype=torch.float64)
    arcs = fit.model.path.arcs(fit.parameters[: fit.model.path.size])
    J_path, J_displacement = arcs.J_at(time)
    middle = PATH_POINTS // 2
    _, displacement = arcs.at(time[middle : middle + 1])
    ahead = torch.nn.functional.normalize(displacement, dim=-1)
    speed = ahead @ J_displacement[middle]
    duration = torch.zeros_like(speed)
    return torch.cat(
        [J_path[middle], J_displacement[middle], speed, duration, J_path.flatten(0, 1)]
    )


def sweep_uncertainty(
    fit: SweepFit,
    misfit: Misfit,
    *,
    others: tuple[SweepFit, ...] = (),
    light: JointLight | None = None,
    ball_radius_std: float,
    exposure_std_share: float,
    response_changes: Tensor,
) -> Uncertainty:
    """Propagate every source to the state.

    All lengths scale with the ball radius, and speeds with 1 / exposure, exactly. What camera and
    response change is found to first order, by the fit's own equations.

    Args:
        fit: the most likely motion.
        misfit: widens what comes from noise.
        others: as good, with a less smooth shade or other marks: what each changes is taken for one
            standard deviation.
        light: the equations of motion and light together, where the light is not wholly known.
        ball_radius_std: m.
        exposure_std_share: standard deviation of the exposure over itself.
        response_changes: of signal less ground behind alpha [M, Q, N], for one standard deviation
            of each independent error of the response; none where it is known.
    """
    k, J = fit.model.path.size, J_state(fit)
    state = motion_of(fit).state()
    lengths = torch.ones_like(state)
    lengths[SPEED + 1] = 0
    speeds = torch.zeros_like(state)
    speeds[3 : SPEED + 1] = 1
    by_radius = state * lengths * (ball_radius_std / fit.model.ball_radius)
    by_exposure = state * speeds * exposure_std_share
    by_response = torch.zeros(len(J), len(J), dtype=torch.float64)
    for change in response_changes:
        answer = J @ _answer_to_response(fit, change)[:k]
        by_response += torch.outer(answer, answer)
    by_light = _light_covariance(fit, J)
    if light is not None:
        by_light += _joint_light_covariance(light)
    by_order = torch.zeros_like(by_response)
    for other in others:
        change = motion_of(other).state() - state
        by_order += torch.outer(change, change)
    return Uncertainty(
        noise=J @ fit.path_covariance @ J.mT * misfit.factor,
        order=by_order + by_light,
        camera=_camera_covariance(fit, J),
        radius=torch.outer(by_radius, by_radius),
        exposure=torch.outer(by_exposure, by_exposure),
        brightness=by_response,
    )


def _joint_light_covariance(light: JointLight) -> Tensor:
    """Carry what the light leaves open where it was found with the motion: marks change little."""
    J, k = J_state(light.fit), light.fit.model.path.size
    open_light: Tensor = J @ (light.path_covariance(k) - light.fit.path_covariance) @ J.mT
    return open_light


def _light_covariance(fit: SweepFit, J: Tensor) -> Tensor:
    """Carry what the estimator takes for the ball's light and may err, as its other lights tell."""
    covariance = torch.zeros(len(J), len(J), dtype=torch.float64)
    others = fit.model.estimator.other_lights()
    seen, k = fit.seen, fit.model.path.size
    if not others:
        return covariance
    before = fit.model.colours(fit.parameters, fit.pixels, seen.coverage).colour
    for other in others:
        model = replace(fit.model, estimator=other)
        colour = model.colours(fit.parameters, fit.pixels, seen.coverage).colour
        change = seen.coverage.alpha * (colour - before) / _variance(fit).sqrt()
        answer = J @ seen.answer(change)[:k]
        covariance += torch.outer(answer, answer) / len(others)
    return covariance


def _answer_to_response(fit: SweepFit, change: Tensor) -> Tensor:
    return fit.seen.answer(change / _variance(fit).sqrt())


def _variance(fit: SweepFit) -> Tensor:
    rest = 1 - fit.seen.coverage.alpha
    return fit.pixels.shot_variance + rest**2 * fit.pixels.ground_variance


def _camera_covariance(fit: SweepFit, J: Tensor) -> Tensor | None:
    camera = fit.model.camera
    if camera.covariance is None:
        return None
    nothing = torch.zeros(len(J), len(J), dtype=torch.float64)
    if not bool(camera.covariance.any()):
        return nothing
    k = fit.model.path.size
    slope = fit.model.opacity_slope(fit.parameters, fit.pixels, fit.seen.coverage)
    rays = fit.pixels.rays.unit.mT
    # what is seen stays where it is while the model moves, by this for each parameter
    moved = torch.einsum("xn,nxp->pn", slope, camera.J_parameters(rays))
    change = J @ fit.seen.answer(moved[:, None] * fit.seen.contrast)[:, :k].mT
    return change @ camera.covariance @ change.mT
