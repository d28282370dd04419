"""How large a resting ball is, or how far away, by the cone that its disc fills.

A sphere of radius R about a point at the distance d from the viewpoint lies within the cone of half
angle b about the ray to its centre, sin b = R / d, through any lens: its outline, pixel by pixel,
turned into rays, tells that ratio. One picture tells no more. [derived]
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.camera import Camera
from toolkit.errors import CalibrationError, MismatchError

RIM_POINTS = 64
RIM_ERROR, ALIKE = 0.05, 3.5
"""px by which a shaded ball's disc comes out wrong, and standard deviations of its outline: all
directions that see the same patch err alike. Measured on rendered balls, 20 to 80 px large."""
DISTANCE_STD = 0.01
"""Metre by which a distance may err of which nobody tells how well it is known: the viewpoint lies
somewhere within the lens."""
CONTRADICTION = 4.0
"""Standard deviations from the others beyond which a picture contradicts them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeInView:
    """What one picture tells: a ball's radius over its distance."""

    ratio: float
    noise_std: float  # of its logarithm, other in each picture
    rim_std: float  # of its logarithm, alike in all pictures of a ball
    J_camera: Tensor  # of its logarithm in the camera's parameters, [4 + K]
    camera_std: float  # of its logarithm, alike in all pictures

    @property
    def own_std(self) -> float:
        """Standard deviation of its logarithm but for the camera."""
        return math.hypot(self.noise_std, self.rim_std)

    @property
    def std(self) -> float:
        """Standard deviation of its logarithm."""
        return math.hypot(self.own_std, self.camera_std)


@dataclass(frozen=True, slots=True, kw_only=True)
class RadiusFound:
    """A ball's radius by pictures from known distances, metre."""

    radius: float
    std: float
    by_picture: tuple[float, ...]
    contradicting: tuple[int, ...]  # pictures left out, by their place


def size_in_view(disc: Disc, camera: Camera) -> SizeInView:
    """Tell a ball's radius over its distance from the disc that it shows.

    Args:
        disc: px of the whole picture.
        camera: of that picture.

    Raises:
        MismatchError: when the camera has no rays where the disc is.
    """
    angle = torch.arange(RIM_POINTS, dtype=torch.float64) * (math.tau / RIM_POINTS)
    rim = disc.from_unit(torch.stack([angle.cos(), angle.sin()], dim=-1))
    rays, J_rays = camera.unproject_and_J(rim)
    if not bool(torch.isfinite(rays).all()):
        raise MismatchError(
            f"the camera has no rays about ({disc.centre[0]:.0f}, {disc.centre[1]:.0f}) px, where "
            "the ball is; calibrate with boards that reach there, or move the ball"
        )
    # on the cone ray . m = 1 with m = axis / cos b; the misfit is the angle off it times sin b
    solve = torch.linalg.pinv(rays)
    m = solve.sum(1)
    squared = 1 - 1 / float(m @ m)
    # the pixels stay, so that each ray turns with the camera
    turned = torch.einsum("nij,njk->nik", -J_rays, camera.J_parameters(rays))
    m_change = -solve @ torch.einsum("nik,i->nk", turned, m)
    J_camera = (m @ m_change) / float(m @ m) ** 2 / squared
    half_angle = math.asin(math.sqrt(squared))
    radius = math.sqrt(disc.semi_axes[0] * disc.semi_axes[1])
    # ln sin b changes by cot b times the angle, which the radius in px stands for
    change = half_angle / math.tan(half_angle) / radius
    by_camera = 0.0
    if camera.covariance is not None:
        by_camera = math.sqrt(max(0.0, float(J_camera @ camera.covariance @ J_camera)))
    return SizeInView(
        ratio=math.sqrt(squared),
        noise_std=change * disc.std,
        rim_std=change * math.hypot(RIM_ERROR, ALIKE * disc.std),
        J_camera=J_camera,
        camera_std=by_camera,
    )


def find_radius(
    sizes: Sequence[SizeInView], distances: Sequence[float], distance_std: float, camera: Camera
) -> RadiusFound:
    """Tell the radius from pictures of one ball at known distances.

    What errs alike in all pictures (camera, rim, where the viewpoint is) does not shrink with their
    number; the rest is taken from the spread among them where that is larger.

    Args:
        sizes: in each picture.
        distances: of the ball's centre from the camera's viewpoint, metre, one a picture.
        distance_std: of all of them, metre.
        camera: of all of them.

    Raises:
        CalibrationError: when the pictures contradict each other, and not most of them agree.
    """
    radii = torch.tensor([size.ratio for size in sizes]).double() * torch.tensor(distances).double()
    own = radii * torch.tensor([size.own_std for size in sizes]).double()
    placed = distance_std / torch.tensor(distances).double()
    kept = _agreeing(radii, torch.hypot(own, radii * placed))
    weight = torch.where(kept, own**-2, 0.0)
    weight = weight / weight.sum()
    radius = float(weight @ radii)
    alike = weight @ torch.tensor([size.rim_std for size in sizes]).double()
    J = weight @ torch.stack([size.J_camera for size in sizes])
    by_camera = 0.0 if camera.covariance is None else J @ camera.covariance @ J
    noise = torch.tensor([size.noise_std for size in sizes]).double()
    spread = _spread(radii[kept] / radius, noise[kept], weight[kept])
    variance = spread + alike**2 + (weight @ placed) ** 2 + by_camera
    return RadiusFound(
        radius=radius,
        std=radius * math.sqrt(float(variance)),
        by_picture=tuple(radii.tolist()),
        contradicting=tuple((~kept).nonzero()[:, 0].tolist()),
    )


def _agreeing(values: Tensor, std: Tensor) -> Tensor:
    """Mark the values that agree with most others, [N] bool."""
    limit = CONTRADICTION * torch.hypot(std[:, None], std)
    agrees = (values[:, None] - values).abs() <= limit
    best = int(agrees.sum(1).argmax())
    kept = agrees[best]
    if 2 * int(kept.sum()) <= len(values) and len(values) > 1:
        told = ", ".join(
            f"{1000 * v:.2f} +/- {1000 * s:.2f} mm"
            for v, s in zip(values.tolist(), std.tolist(), strict=True)
        )
        raise CalibrationError(
            f"the pictures contradict each other: they give radii of {told}; check the distances, "
            "or add pictures"
        )
    return kept


def _spread(values: Tensor, std: Tensor, weight: Tensor) -> Tensor:
    """Give the variance of a weighted mean of N: by each one's noise, or more as they scatter."""
    by_noise = (weight**2 * std**2).sum()
    if len(values) == 1:
        return by_noise
    scatter = (weight * (values - weight @ values) ** 2).sum() / (len(values) - 1)
    return torch.maximum(by_noise, scatter)
