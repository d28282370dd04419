"""Where the streak begins and ends: the ball's place when the exposure started and when it stopped.

No lateral contour can tell the place along the path; the ends can. They blend into the background,
but their shape is known: a ray is covered from the moment the ball's leading rim reaches it, or
from the start of the exposure where it was covered already.
Source: MATHS, "The exact streak of a moving ball", the clipped interval. [derived] The paper leaves
the ends out.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.axis_curve import AxisCurve, nearest_parameter
from toolkit.camera import Camera
from toolkit.errors import StreakError
from toolkit.types import ProfileFit

CAP_REACH = 1.6
"""Half widths about an end within which pixels tell where it lies."""
MAX_PIXELS = 12_000
"""About an end; where there are more, every second or third serves well enough."""
STEPS = 25
SETTLED = 1e-3
"""px."""

LOST_END = (
    "the streak's ends cannot be located, so that the ball's place along its path stays open; "
    "check background and ball colour, or name a region that holds the whole streak"
)

Clock = Callable[[Tensor], Tensor]
"""Parameter along the streak to share of the exposure, rising."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OpacityMap:
    """The opacity of single pixels on a window of the picture."""

    alpha: Tensor  # [H, W]
    variance: Tensor  # [H, W]
    corner: tuple[int, int]  # of the window in the picture, (x, y) px


@dataclass(frozen=True, slots=True, kw_only=True)
class Ends:
    """Parameters of the axis at which the ball stood when the exposure began and ended."""

    s: Tensor  # [2] px
    std: Tensor  # [2] px
    chi2_per_dof: float


def rough_ends(fit: ProfileFit, picture: int = 0) -> tuple[float, float]:
    """Give the positions along the axis of the ball's first and last centre, to a few px.

    There the opacity has risen to half of what it is one half width further in. [derived]

    Returns:
        Positions in px, of the same axis as the profiles'.
    """
    position, opacity = fit.position[picture], _median_filtered(fit.opacity[picture])
    half_width = float(fit.half_width[picture][opacity > opacity.max() / 2].median())
    first = _half_rise(position, opacity, half_width)
    last = -_half_rise(-position.flip(0), opacity.flip(0), half_width)
    return first, last


def locate_ends(
    rough: tuple[float, float],
    curve: AxisCurve,
    clock: Clock,
    clock_rate: Clock,
    opacity: OpacityMap,
    camera: Camera,
    ball_radius: float,
) -> Ends:
    """Find both ends by least squares on the opacity of the pixels about them.

    Args:
        rough: first guess of the two parameters, px along the axis.
        curve: the ball's path.
        clock: share of the exposure passed when the ball is at s.
        clock_rate: its derivative in s.
        opacity: pixels and their noise.
        camera: with distortion.
        ball_radius: m.

    Returns:
        Ends; the standard deviation takes the path and the clock as known.
    """
    located = [
        _locate_end(s, sign, curve, clock, clock_rate, opacity, camera, ball_radius)
        for s, sign in zip(rough, (1.0, -1.0), strict=True)
    ]
    return Ends(
        s=torch.stack([end[0] for end in located]),
        std=torch.stack([end[1] for end in located]),
        chi2_per_dof=max(end[2] for end in located),
    )


def _locate_end(
    rough: float,
    sign: float,
    curve: AxisCurve,
    clock: Clock,
    clock_rate: Clock,
    opacity: OpacityMap,
    camera: Camera,
    ball_radius: float,
) -> tuple[Tensor, Tensor, float]:
    """Find one end; sign is 1 at the start, -1 at the stop, where time runs backwards."""
    end = torch.tensor(rough, dtype=torch.float64)
    pixels, alpha, variance = _cap_pixels(end, curve, opacity, camera, ball_radius)
    rays = camera.unproject(pixels)
    enter, leave, is_covered = covering_interval(curve, end, rays, ball_radius)
    leading, trailing = (leave, enter) if sign > 0 else (enter, leave)
    low, high = float(enter.min()), float(leave.max())
    weight = torch.where(is_covered, 1 / variance, 0)
    for _ in range(STEPS):
        inside = ((end - trailing) * sign > 0) & ((leading - end) * sign > 0) & is_covered
        begins = torch.where((end - trailing) * sign > 0, end.expand_as(trailing), trailing)
        model = (sign * (clock(leading) - clock(begins))).clamp_min(0)
        J = torch.where(inside, -sign * clock_rate(end), 0)
        residual = torch.where(is_covered, model - alpha, 0)
        information = (weight * J * J).sum().clamp_min(1e-12)
        step = -(weight * J * residual).sum() / information
        end = (end + step).clamp(low, high)
        if abs(float(step)) < SETTLED:
            break
    count = max(int(is_covered.sum()) - 1, 1)
    chi2 = float((weight * residual * residual).sum()) / count
    return end, (max(chi2, 1.0) / information).sqrt(), chi2


def covering_interval(
    curve: AxisCurve, s: Tensor, rays: Tensor, ball_radius: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Give the stretch of the axis from which the ball covers each ray, near s.

    Two Newton steps on |A(s) x u| = R refine the closed form for a straight stretch.

    Returns:
        Where the ball reaches the ray and where it leaves it [N] px, and whether it covers it at
        all [N] bool.
    """
    nearest = nearest_parameter(curve, s.expand(rays.shape[:-1]), rays)
    gap, slope = _moment(curve, nearest, rays)
    chord = ball_radius**2 - (gap * gap).sum(-1)
    half = chord.clamp_min(0).sqrt() / torch.linalg.vector_norm(slope, dim=-1)
    bounds = []
    for side in (-1.0, 1.0):
        at = nearest + side * half
        for _ in range(2):
            moment, change = _moment(curve, at, rays)
            excess = (moment * moment).sum(-1) - ball_radius**2
            growth = 2 * (moment * change).sum(-1)
            is_steep = growth * side > 0
            at = at - torch.where(is_steep, excess / torch.where(is_steep, growth, 1), 0).clamp(
                -1, 1
            )
        bounds.append(at)
    return bounds[0], bounds[1], chord > 0


def _moment(curve: AxisCurve, s: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
    return torch.linalg.cross(curve(s), rays), torch.linalg.cross(curve.tangent(s), rays)


def _cap_pixels(
    end: Tensor, curve: AxisCurve, opacity: OpacityMap, camera: Camera, ball_radius: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Pixels [N, 2] about an end with their opacity and variance [N]."""
    point = curve(end)
    middle = camera.project(point)
    reach = CAP_REACH * ball_radius / float(point[2]) * max(camera.fx, camera.fy)
    height, width = opacity.alpha.shape
    corner = torch.tensor(opacity.corner, dtype=torch.float64)
    low = (middle - reach - corner).floor().long().clamp_min(0)
    high = (middle + reach - corner).ceil().long() + 1
    left, right = int(low[0]), min(int(high[0]), width)
    top, bottom = int(low[1]), min(int(high[1]), height)
    if right - left < 3 or bottom - top < 3:
        raise StreakError(LOST_END)
    step = max(1, int(((right - left) * (bottom - top) / MAX_PIXELS) ** 0.5))
    rows, columns = torch.meshgrid(
        torch.arange(top, bottom, step), torch.arange(left, right, step), indexing="ij"
    )
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2).to(torch.float64) + corner
    window = (slice(top, bottom, step), slice(left, right, step))
    alpha, variance = opacity.alpha[window].flatten(), opacity.variance[window].flatten()
    usable = ((pixels - middle).norm(dim=-1) <= reach) & torch.isfinite(variance)
    return pixels[usable], alpha[usable].double(), variance[usable].double()


def _median_filtered(values: Tensor) -> Tensor:
    padded = torch.cat([values[:1].repeat(3), values, values[-1:].repeat(3)])
    return padded.unfold(0, 7, 1).median(-1).values


def _half_rise(position: Tensor, opacity: Tensor, half_width: float) -> float:
    """Position at which the opacity first reaches half of its plateau beyond."""
    plateau = float(opacity.quantile(0.7))
    found = float(position[0])
    for _ in range(3):
        above = opacity >= plateau / 2
        # a stray profile ahead of the streak does not count: the next few must follow
        steady = above[:-4] & above[1:-3] & above[2:-2] & above[3:-1] & above[4:]
        index = int(steady.to(torch.int8).argmax()) if bool(steady.any()) else 0
        found = float(position[index])
        beyond = (position >= found + half_width) & (position <= found + 2.5 * half_width)
        if not bool(beyond.any()):
            break
        plateau = float(opacity[beyond].median())
    return found
