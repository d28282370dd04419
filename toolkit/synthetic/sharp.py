"""The mean of many sharp images of a ball.

Every sub-pixel's ray is tested against the sphere at every instant. No closed form of a streak is
used here, so that the result can stand as independent truth.
"""

import math

import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.synthetic.exposure import Ball, BallLight, Exposure, Instant
from toolkit.synthetic.lens import Window, normalised_grid, unit_rays
from toolkit.synthetic.paths import BallPath
from toolkit.synthetic.shutter import Shutter

LIMB_POINTS = 64
COARSE = 513
"""Instants at least at which the path is looked at before it is rendered."""
NEVER_SEEN = "the ball is never inside the picture; move its path or turn the camera"


def expose_ball(
    camera: Camera,
    path: BallPath,
    ball: Ball,
    shutter: Shutter,
    *,
    step: float,
    supersampling: int,
    reach: int,
) -> BallLight:
    """Average the ball's sharp images over the exposure of each row.

    The instants are the mid-points of equal slices of time. A unit ray u meets the ball at C
    exactly when |C x u| <= R in front of the camera, that is when C.u >= sqrt(|C|^2 - R^2). Near
    the rim that difference tells how much of the sub-pixel around the ray the ball covers; summed
    over the rim the area so covered is exact.

    Args:
        camera: the camera.
        path: the ball's path.
        ball: its radius and looks.
        shutter: when each row is exposed.
        step: the rim moves by at most this many px from one instant to the next.
        supersampling: rays along one side of a pixel.
        reach: px over which the lens spreads light, kept free around the streak.

    Raises:
        ConfigError: when the ball touches the camera's plane or is never in the picture.
    """
    first, last = _seen(camera, path, ball.radius, shutter, reach)
    time, length = _slices(camera, path, ball.radius, first, last, step)
    centres = path.position(time)
    boxes = _boxes(project_limb(camera, centres, ball.radius))
    window = _common_window(boxes, camera).grown(reach)
    rays = unit_rays(normalised_grid(camera, window, supersampling))
    exposure = Exposure(rays, window, ball, shutter, reach)
    sub_pixels = _pixel_angle(camera, centres) / supersampling
    for t, centre, box, sub_pixel in zip(
        time.tolist(), centres.numpy(), boxes.tolist(), sub_pixels.tolist(), strict=True
    ):
        exposure.add(
            Instant(time=t, length=length, centre=centre, box=tuple(box), sub_pixel=sub_pixel)
        )
    return exposure.light()


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


def _seen(
    camera: Camera, path: BallPath, ball_radius: float, shutter: Shutter, reach: int
) -> tuple[float, float]:
    """First and last time, s, at which rows that the ball's light reaches are exposed.

    Raises:
        ConfigError: when there is none, or the ball then touches the camera's plane.
    """
    if not shutter.is_rolling:
        return 0.0, shutter.exposure
    count = max(COARSE, math.ceil(8 * shutter.end / shutter.exposure))
    time = torch.linspace(0, shutter.end, count, dtype=torch.float64)
    centres = path.position(time)
    is_before = centres[:, 2] > ball_radius
    # a ball behind the camera is not seen; while it passes the lens, nothing tells which rows see
    boxes = torch.zeros(count, 4, dtype=torch.long)
    boxes[is_before] = _boxes(project_limb(camera, centres[is_before], ball_radius))
    is_seen = shutter.exposes(time, boxes[:, 1] - reach, boxes[:, 3] - 1 + reach) & is_before
    seen = is_seen.nonzero()[:, 0]
    if len(seen) == 0:
        raise ConfigError(NEVER_SEEN)
    first, last = max(0, int(seen[0]) - 1), min(count - 1, int(seen[-1]) + 1)
    return float(time[first]), float(time[last])


def _slices(
    camera: Camera, path: BallPath, ball_radius: float, first: float, last: float, step: float
) -> tuple[Tensor, float]:
    """Cut a span of time into as many equal slices as keep the rim's movement below `step` px.

    Returns:
        Their mid-points [T] s, and their length, s.
    """
    coarse = torch.linspace(first, last, COARSE, dtype=torch.float64)
    limb = project_limb(camera, path.position(coarse), ball_radius)
    fastest = float(torch.linalg.vector_norm(limb.diff(dim=0), dim=-1).max()) * (COARSE - 1)
    count = max(1, math.ceil(1.05 * fastest / step))
    length = (last - first) / count
    return first + (torch.arange(count, dtype=torch.float64) + 0.5) * length, length


def _pixel_angle(camera: Camera, centres: Tensor) -> Tensor:
    """Side of a square of a pixel's solid angle where each centre [T, 3] m is seen, [T] rad."""
    J = camera.J_project(centres)  # px a metre; nothing along the ray
    density: Tensor = torch.linalg.det(J @ J.mT) ** 0.25
    angle: Tensor = 1 / (density * torch.linalg.vector_norm(centres, dim=-1))
    return angle


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
        raise ConfigError(NEVER_SEEN)
    return Window(left=left, top=top, width=right - left, height=bottom - top)
