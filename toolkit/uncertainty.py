"""What the answer inherits from noise, camera, ball radius and exposure time, each kept apart."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.common_residual import misfit_variance
from toolkit.following import Reconstruction, flight_answer, opacity_data, opacity_doubt
from toolkit.motion import DURATION, SPEED, describe_motion, noise_covariance, propagate, repace
from toolkit.reconstruction import refit_axis


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """Covariances of `Motion.state`, lengths in metres and displacements in metres per exposure."""

    noise: Tensor  # [K, K]
    order: Tensor  # [K, K], what a finer curve would change; 0 for a flight or an even line
    camera: Tensor | None  # [K, K]; None when the camera file has no covariance
    radius: Tensor  # [K, K]
    exposure: Tensor  # [K, K], of the displacement per the exposure time stated
    brightness: Tensor  # [K, K], of the opacities' scale

    @property
    def total(self) -> Tensor:
        """Sum of all sources [K, K]."""
        camera = torch.zeros_like(self.noise) if self.camera is None else self.camera
        return self.noise + self.order + camera + self.radius + self.exposure + self.brightness


def covariances(
    found: Reconstruction,
    camera: Camera,
    ball_radius: float,
    *,
    ball_radius_std: float,
    exposure_std_share: float,
) -> Uncertainty:
    """Propagate every source to the state.

    All lengths scale with the ball radius, and speeds with 1 / exposure, exactly. Where the
    distance between the ends contradicts the opacity by more than noise allows, colour, response or
    exposure is wrong by about as much, and the speed with it. Where the colour was found in the
    fit, the scale of all opacities errs, and the speed again.

    Args:
        found: the reconstruction.
        camera: its covariance is carried by refitting the path through shifted cameras.
        ball_radius: m.
        ball_radius_std: m.
        exposure_std_share: standard deviation of the exposure time over itself.
    """
    state = found.motion.state()
    noise = _noise_covariance(found, ball_radius)
    lengths = torch.ones_like(state)
    lengths[DURATION] = 0
    speeds = torch.zeros_like(state)
    speeds[3 : SPEED + 1] = 1
    by_radius = state * lengths * (ball_radius_std / ball_radius)
    by_exposure = state * speeds * exposure_std_share
    allowed = 2 * duration_std(found, noise)
    contradiction = max(abs(float(found.motion.duration) - 1) - allowed, 0.0)
    by_brightness = state * speeds * (contradiction**2 + found.opacity_std**2) ** 0.5
    return Uncertainty(
        noise=_widened(noise, misfit_variance(found.fit)),
        order=_order_covariance(found, camera, ball_radius),
        camera=_camera_covariance(found, camera, ball_radius),
        radius=torch.outer(by_radius, by_radius),
        exposure=torch.outer(by_exposure, by_exposure),
        brightness=torch.outer(by_brightness, by_brightness),
    )


def duration_std(found: Reconstruction, noise: Tensor) -> float:
    """Give by how much the duration that opacity and ends tell may differ from 1 by chance."""
    by_colour = 0.0 if found.opacity_std else opacity_doubt(found.fit)
    return float((noise[DURATION, DURATION] + by_colour**2).sqrt())


def _widened(noise: Tensor, factor: float) -> Tensor:
    """Scale the covariance but for the duration, by which colour and exposure are checked."""
    scale = torch.full_like(noise[0], factor**0.5)
    scale[DURATION] = 1
    return scale[:, None] * noise * scale


def _noise_covariance(found: Reconstruction, ball_radius: float) -> Tensor:
    if found.flight is not None:
        return found.flight.state_covariance()
    return noise_covariance(
        found.axis, found.opacity, found.pace, found.ends.s, found.ends.std, ball_radius
    )


def _order_covariance(found: Reconstruction, camera: Camera, ball_radius: float) -> Tensor:
    """Covariance of not knowing how far a bent path or an uneven pace goes on bending.

    The order was chosen by the same data; what two more coefficients each would change is taken for
    one standard deviation. [derived]
    """
    state, is_even = found.motion.state(), found.pace.basis.size == 1
    if found.flight is not None or (found.axis.curve.is_line and is_even):
        return torch.zeros(len(state), len(state), dtype=state.dtype)
    finer = refit_axis(found.fit, found.axis.curve, found.opacity.s, camera, ball_radius, extra=2)
    basis = replace(found.pace.basis, size=found.pace.basis.size + 2)
    pace = repace(finer, found.opacity, replace(found.pace, basis=basis), ball_radius)
    change = describe_motion(finer, pace, found.ends.s).state() - state
    return torch.outer(change, change)


def _camera_covariance(found: Reconstruction, camera: Camera, ball_radius: float) -> Tensor | None:
    if camera.covariance is None:
        return None
    if not bool(camera.covariance.any()):  # known exactly: no path needs refitting
        size = len(found.motion.state())
        return torch.zeros(size, size, dtype=torch.float64)

    if found.flight is not None:
        flight, answer = found.flight, flight_answer(found, camera, ball_radius)
        return propagate(lambda x: flight.moved(answer @ x).motion().state(), camera.covariance)

    def state(shift: Tensor) -> Tensor:
        shifted = camera.with_parameters(camera.parameters + shift)
        curve = refit_axis(found.fit, found.axis.curve, found.opacity.s, shifted, ball_radius)
        data = opacity_data(found.fit, found.opacity.s, shifted)
        pace = repace(curve, data, found.pace, ball_radius)
        return describe_motion(curve, pace, found.ends.s).state()

    return propagate(state, camera.covariance)
