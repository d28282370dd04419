"""The mean of many sharp images of a ball.

Every sub-pixel's ray is tested against the sphere at every instant. No closed form of a streak is
used here, so that the result can stand as independent truth.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic.appearance import Appearance, PlainBall
from toolkit.synthetic.lens import Array, Window, normalised_grid, unit_rays
from toolkit.synthetic.paths import BallPath

LIMB_POINTS = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class BallLight:
    """What the ball adds to a window of the picture, on its sub-pixels, before any blur."""

    window: Window
    alpha: Array  # [H * s, W * s] share of the exposure during which the ball covers the ray
    colour: Array  # [3, H * s, W * s] its light, averaged over the whole exposure


def expose_ball(
    camera: Camera,
    path: BallPath,
    ball_radius: float,
    exposure: float,
    appearance: Appearance,
    *,
    step: float,
    supersampling: int,
    margin: int,
) -> BallLight:
    """Average the ball's sharp images over the exposure.

    The instants are the mid-points of equal slices of the exposure. A unit ray u meets the ball at
    C exactly when |C x u| <= R in front of the camera, that is when C.u >= sqrt(|C|^2 - R^2).

    Args:
        camera: the camera.
        path: the ball's path.
        ball_radius: metre.
        exposure: second.
        appearance: light sent by the ball's surface.
        step: the rim moves by at most this many px from one instant to the next.
        supersampling: rays along one side of a pixel.
        margin: px kept free around the streak.

    Raises:
        ConfigError: when the ball touches the camera's plane or is never in the picture.
    """
    time = _instants(camera, path, ball_radius, exposure, step)
    centres = path.position(time)
    boxes = _boxes(project_limb(camera, centres, ball_radius))
    window = _common_window(boxes, camera).grown(margin)
    rays = unit_rays(normalised_grid(camera, window, supersampling))
    light = _Exposure(rays, window, supersampling, ball_radius, appearance)
    for instant, centre, box in zip(time.tolist(), centres.numpy(), boxes.tolist(), strict=True):
        light.add(instant, centre, box)
    return BallLight(window=window, alpha=light.mean_alpha(), colour=light.mean_colour())


def project_limb(camera: Camera, centres: Tensor, ball_radius: float) -> Tensor:
    """Give points along the outline of the ball at each centre [T, 3] m, as pixels [T, 64, 2].

    Raises:
        ConfigError: when the ball is not wholly in front of the camera.
    """
    if bool((centres[:, 2] <= ball_radius).any()):
        raise ConfigError(
            f"the ball of radius {ball_radius} m comes within its radius of the camera's plane;"
            " move the path away"
        )
    # the rays that graze the ball touch it on a circle around the line of sight
    distance2 = (centres**2).sum(-1, keepdim=True)
    middle = centres * (1 - ball_radius**2 / distance2)
    circle_radius = ball_radius * (1 - ball_radius**2 / distance2).sqrt()
    helper = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand_as(centres)
    e1 = torch.nn.functional.normalize(torch.linalg.cross(helper, centres), dim=-1)
    e2 = torch.linalg.cross(torch.nn.functional.normalize(centres, dim=-1), e1)
    angle = torch.arange(LIMB_POINTS, dtype=torch.float64) * (2 * math.pi / LIMB_POINTS)
    ring = angle.cos()[:, None] * e1[:, None] + angle.sin()[:, None] * e2[:, None]
    return camera.project(middle[:, None] + circle_radius[:, None] * ring)


def _instants(
    camera: Camera, path: BallPath, ball_radius: float, exposure: float, step: float
) -> Tensor:
    """Mid-points of as many equal slices as keep the rim's movement below `step` px, [T] s."""
    coarse = torch.linspace(0, exposure, 513, dtype=torch.float64)
    limb = project_limb(camera, path.position(coarse), ball_radius)
    fastest = float(torch.linalg.vector_norm(limb.diff(dim=0), dim=-1).max()) * 512
    count = max(1, math.ceil(1.05 * fastest / step))
    return (torch.arange(count, dtype=torch.float64) + 0.5) * (exposure / count)


def _boxes(limb: Tensor) -> Tensor:
    """Pixels [T, 4] that hold the ball: left, top, right, bottom, the last two excluded."""
    # 64 points on the rim miss at most 0.12 % of its radius
    low, high = limb.amin(dim=1), limb.amax(dim=1)
    slack = 1 + 0.0013 * (high - low)
    return torch.cat([(low - slack).floor(), (high + slack).ceil() + 1], dim=-1).long()


def _common_window(boxes: Tensor, camera: Camera) -> Window:
    left, top = boxes[:, 0].amin().item(), boxes[:, 1].amin().item()
    right, bottom = boxes[:, 2].amax().item(), boxes[:, 3].amax().item()
    left, top = max(0, int(left)), max(0, int(top))
    right, bottom = min(camera.width, int(right)), min(camera.height, int(bottom))
    if right <= left or bottom <= top:
        raise ConfigError("the ball is never inside the picture; move its path or turn the camera")
    return Window(left=left, top=top, width=right - left, height=bottom - top)


class _Exposure:
    """Running sums over the sharp images, on the sub-pixels of one window."""

    def __init__(
        self,
        rays: Tensor,
        window: Window,
        supersampling: int,
        ball_radius: float,
        appearance: Appearance,
    ) -> None:
        # relative to one ray the others are small numbers, so that 32 bits lose nothing
        self.origin: NDArray[np.float64] = rays[:, rays.shape[1] // 2, rays.shape[2] // 2].numpy()
        self.rays: Array = (rays.numpy() - self.origin[:, None, None]).astype(np.float32)
        self.window = window
        self.supersampling = supersampling
        self.ball_radius = ball_radius
        self.appearance = appearance
        self.instants = 0
        self.hits: NDArray[np.uint32] = np.zeros(rays.shape[1:], dtype=np.uint32)
        # a plain ball's light follows from the hits alone
        self.is_plain = isinstance(appearance, PlainBall)
        shape = (0, 0, 3) if self.is_plain else (*rays.shape[1:], 3)
        self.light: Array = np.zeros(shape, dtype=np.float32)

    def add(self, time: float, centre: NDArray[np.float64], box: list[int]) -> None:
        """Add the sharp image of the ball at one instant."""
        rows, columns = self._samples(box)
        u = self.rays[:, rows, columns]
        x, y, z = centre.astype(np.float32)
        tangent = math.sqrt(float(centre @ centre) - self.ball_radius**2)
        # u.C - tangent, from small numbers only
        depth = u[0] * x
        depth += u[1] * y
        depth += u[2] * z
        depth += np.float32(float(self.origin @ centre) - tangent)
        hit = depth >= 0
        self.hits[rows, columns] += hit
        self.instants += 1
        if not self.is_plain:
            inside = np.flatnonzero(hit)
            rays = u.reshape(3, -1).take(inside, axis=1)
            normal = self._normals(rays, depth.take(inside), tangent, centre)
            # flat indices and whole rows of memory: twice as fast as picking pixels by row, column
            light = np.zeros((hit.size, 3), dtype=np.float32)
            light[inside] = self.appearance(torch.from_numpy(normal.T), time).numpy()
            self.light[rows, columns] += light.reshape(*hit.shape, 3)

    def mean_alpha(self) -> Array:
        """Give the share of the instants at which the ball covers each ray."""
        return self.hits.astype(np.float32) / np.float32(self.instants)

    def mean_colour(self) -> Array:
        """Give the ball's light, averaged over all instants, [3, H * s, W * s]."""
        if isinstance(self.appearance, PlainBall):
            colour = np.array(self.appearance.colour, dtype=np.float32)
            return colour[:, None, None] * self.mean_alpha()
        return np.moveaxis(self.light, -1, 0) / np.float32(self.instants)

    def _samples(self, box: list[int]) -> tuple[slice, slice]:
        left, top, right, bottom = box
        s, window = self.supersampling, self.window
        left, right = max(0, left - window.left), max(0, right - window.left)
        top, bottom = max(0, top - window.top), max(0, bottom - window.top)
        return slice(top * s, bottom * s), slice(left * s, right * s)

    def _normals(
        self, rays: Array, depth: Array, tangent: float, centre: NDArray[np.float64]
    ) -> Array:
        """Outward normals [3, N] where rays enter the ball; `depth` is u.C - tangent there."""
        u = rays + self.origin.astype(np.float32)[:, None]
        # (u.C)^2 - tangent^2, in the form that keeps its digits near the rim
        half_chord = np.sqrt(depth * (depth + np.float32(2 * tangent)))
        u *= depth - half_chord + np.float32(tangent)
        u -= centre.astype(np.float32)[:, None]
        u /= np.float32(self.ball_radius)
        return u
