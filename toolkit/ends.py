"""Where the streak begins and ends: the ball's place when the exposure started and when it stopped.

No lateral contour can tell the place along the path; the ends can. They blend into the background,
but their shape is known: a ray is covered from the moment the ball's leading rim reaches it, or
from the start of the exposure where it was covered already.
Source: MATHS, "The exact streak of a moving ball", the clipped interval. [derived] The paper leaves
the ends out.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.axis_curve import Curve, nearest_parameter
from toolkit.camera import Camera
from toolkit.errors import StreakError
from toolkit.ranks import ranked_value
from toolkit.types import ProfileFit

CAP_REACH = 1.6
"""Half widths about an end within which pixels tell where it lies."""
MAX_PIXELS = 12_000
"""About an end; where there are more, every second or third serves well enough."""
COARSE = 8.0
"""px from one ray found through the lens to the next; those between are interpolated."""
STEPS = 25
SETTLED = 1e-5
"""Of the streak's length."""
LONGEST_STEP = 3e-3
"""Of the streak's length, in a Newton step that refines where the ball reaches a ray."""

LOST_END = (
    "the streak's ends cannot be located, so that the ball's place along its path stays open; "
    "check background and ball colour, or name a region that holds the whole streak"
)

Array = NDArray[np.float64]
Clock = Callable[[Tensor], Tensor]
"""Parameter along the streak to share of the exposure, rising."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """The pixels about the streak, and the estimator that knows the ball before them."""

    estimator: AlphaEstimator
    signal: Tensor  # [Q, H, W]
    ground: Tensor  # [Q, H, W], free of the noise that the signal holds
    variance: Tensor  # [Q, H, W]
    corner: tuple[int, int]  # of the window in the picture, (x, y) px


@dataclass(frozen=True, slots=True, kw_only=True)
class Ends:
    """Parameters of the axis at which the ball stood when the exposure began and ended."""

    s: Tensor  # [2] in the curve's own unit
    std: Tensor  # [2]
    chi2_per_dof: float


def rough_ends(fit: ProfileFit, picture: int = 0) -> tuple[float, float]:
    """Give the positions along the axis of the ball's first and last centre, to a few px.

    There the opacity has risen to half of what it is one half width further in. [derived]

    Returns:
        Positions in px, of the same axis as the profiles'.
    """
    position, opacity = fit.position[picture].numpy(), fit.opacity[picture].numpy()
    padded = np.pad(opacity, 3, mode="edge")
    opacity = ranked_value(np.lib.stride_tricks.sliding_window_view(padded, 7))
    half_width = _median(fit.half_width[picture].numpy()[opacity > opacity.max() / 2])
    first = _half_rise(position, opacity, half_width)
    last = -_half_rise(-position[::-1], opacity[::-1], half_width)
    return first, last


def locate_ends(
    rough: tuple[float, float],
    curve: Curve,
    clock: Clock,
    clock_rate: Clock,
    pixels: Surroundings,
    camera: Camera,
    ball_radius: float,
) -> Ends:
    """Find both ends by least squares on the opacity of the pixels about them.

    Args:
        rough: first guess of the two parameters.
        curve: the ball's path.
        clock: share of the exposure passed when the ball is at s.
        clock_rate: its derivative in s.
        pixels: about the streak.
        camera: with distortion.
        ball_radius: m.

    Returns:
        Ends; the standard deviation takes the path and the clock as known.
    """
    located = [
        _locate_end(s, sign, curve, clock, clock_rate, pixels, camera, ball_radius)
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
    curve: Curve,
    clock: Clock,
    clock_rate: Clock,
    pixels: Surroundings,
    camera: Camera,
    ball_radius: float,
) -> tuple[Tensor, Tensor, float]:
    """Find one end; sign is 1 at the start, -1 at the stop, where time runs backwards."""
    end = torch.tensor(rough, dtype=torch.float64)
    cap = _cap_pixels(end, curve, pixels, camera, ball_radius)
    rays, nearest = _rays_and_nearest(end, curve, cap, camera)
    enter, leave, is_covered = covering_interval(curve, nearest, rays, ball_radius)
    low, high = float(enter.min()), float(leave.max())
    if not bool(is_covered.any()):
        raise StreakError(LOST_END)
    cap = cap.taken(is_covered)
    enter, leave = enter[is_covered], leave[is_covered]
    offset = _chord_offset(curve, nearest[is_covered], rays[is_covered], ball_radius)
    direction = _direction(curve, end, camera)
    place = camera.project(curve(end))[None]
    leading, trailing = (leave, enter) if sign > 0 else (enter, leave)
    time_leading, time_trailing = clock(leading), clock(trailing)
    seen: _Opacity | None = None
    for _ in range(STEPS):
        chord = replace(_seen_chord(offset, direction, enter, leave, end, sign), place=place)
        seen = now = cap.opacity(chord, seen)
        has_come = (end - trailing) * sign > 0
        inside = has_come & ((leading - end) * sign > 0)
        begins = torch.where(has_come, clock(end), time_trailing)
        model = (sign * (time_leading - begins)).clamp_min(0)
        J = torch.where(inside, -sign * clock_rate(end), 0)
        residual = model - now.alpha
        information = (now.precision * J * J).sum().clamp_min(1e-12)
        step = -(now.precision * J * residual).sum() / information
        end = (end + step).clamp(low, high)
        if abs(float(step)) < SETTLED * curve.span:
            break
    count = max(len(residual) - 1, 1)
    chi2 = float((now.precision * residual * residual).sum()) / count
    return end, (max(chi2, 1.0) / information).sqrt(), chi2


def covering_interval(
    curve: Curve, nearest: Tensor, rays: Tensor, ball_radius: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Give the stretch of the axis from which the ball covers each ray, about its nearest point.

    Two Newton steps on |A(s) x u| = R refine the closed form for a straight stretch.

    Returns:
        Where the ball reaches the ray and where it leaves it [N], and whether it covers it at
        all [N] bool.
    """
    squared, growth, slope = _squared_moment(curve, nearest, rays)
    chord = ball_radius**2 - squared
    half = chord.clamp_min(0).sqrt() / slope.sqrt()
    # both bounds at once, the earlier one first
    side = torch.tensor([[-1.0], [1.0]], dtype=torch.float64)
    at, longest = nearest + side * half, LONGEST_STEP * curve.span
    for _ in range(2):
        squared, growth, _ = _squared_moment(curve, at, rays)
        is_steep = growth * side > 0
        excess = squared - ball_radius**2
        step = torch.where(is_steep, excess / torch.where(is_steep, 2 * growth, 1), 0)
        at = at - step.clamp(-longest, longest)
    return at[0], at[1], chord > 0


def _squared_moment(curve: Curve, s: Tensor, rays: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Give |A x u|^2, half its derivative in s and |A' x u|^2, at s [..., N] on rays [N, 3]."""
    (ux, uy, uz), points = rays.unbind(-1), curve.point_and_tangent(s)
    (x, y, z), (dx, dy, dz) = (vector.unbind(-1) for vector in points)
    along, along_slope = x * ux + y * uy + z * uz, dx * ux + dy * uy + dz * uz
    return (
        x * x + y * y + z * z - along * along,
        x * dx + y * dy + z * dz - along * along_slope,
        dx * dx + dy * dy + dz * dz - along_slope * along_slope,
    )


def _chord_offset(curve: Curve, nearest: Tensor, rays: Tensor, ball_radius: float) -> Tensor:
    """Distance of each ray from the path in ball radii [N], positive to the right of the motion."""
    point, tangent = curve.point_and_tangent(nearest)
    gap = torch.linalg.vector_norm(torch.linalg.cross(point, rays), dim=-1) / ball_radius
    side = (rays * torch.linalg.cross(point, tangent)).sum(-1).sign()
    offset: Tensor = side * gap
    return offset.clamp(-1, 1)


def _direction(curve: Curve, end: Tensor, camera: Camera) -> Tensor:
    """Angle of the motion in the picture at an end [1], radians."""
    point, tangent = curve.point_and_tangent(end)
    x, y = (camera.J_project(point) @ tangent[:, None])[:, 0]
    return torch.atan2(y, x)[None]


def _seen_chord(
    offset: Tensor, direction: Tensor, enter: Tensor, leave: Tensor, end: Tensor, sign: float
) -> Chord:
    """Give the part of its chord that each pixel saw: the exposure began or stopped on the way.

    The ball shows its leading rim first, so that the chord is passed from 1 to -1.
    """
    passed = (end - enter) / (leave - enter).clamp_min(1e-12)
    there = (1 - 2 * passed).clamp(-1, 1)
    if sign > 0:
        return Chord(offset=offset, direction=direction, stop=there)
    return Chord(offset=offset, direction=direction, start=there)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cap:
    """Pixels about an end, [H, W] of them, N usable ones."""

    x: Tensor  # [W] px
    y: Tensor  # [H] px
    is_usable: Tensor  # [H, W] bool
    estimator: AlphaEstimator
    signal: Tensor  # [N, Q]
    ground: Tensor  # [N, Q]
    variance: Tensor  # [N, Q]

    def taken(self, chosen: Tensor) -> "_Cap":
        """Give the cap with some of the usable pixels only, [N] bool."""
        return replace(
            self,
            signal=self.signal[chosen],
            ground=self.ground[chosen],
            variance=self.variance[chosen],
        )

    def opacity(self, chord: Chord, before: "_Opacity | None") -> "_Opacity":
        """Give the opacity of every pixel where the ball shows `chord`; before, it showed another.

        Most balls show the same whatever the chord.
        """
        foreground = self.estimator.foreground(chord, None)
        if before is not None and torch.equal(foreground, before.foreground):
            return before
        contrast = foreground - self.ground
        weight = contrast / self.variance
        precision = (weight * contrast).sum(-1)
        alpha = (weight * (self.signal - self.ground)).sum(-1) / precision.clamp_min(1e-12)
        return _Opacity(foreground=foreground, alpha=alpha, precision=precision)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Opacity:
    """What the pixels of a cap tell."""

    foreground: Tensor  # [N, Q]
    alpha: Tensor  # [N]
    precision: Tensor  # [N]


def _cap_pixels(
    end: Tensor, curve: Curve, pixels: Surroundings, camera: Camera, ball_radius: float
) -> _Cap:
    point = curve(end)
    middle = camera.project(point)
    reach = CAP_REACH * ball_radius / float(point[2]) * max(camera.fx, camera.fy)
    height, width = pixels.signal.shape[-2:]
    corner = torch.tensor(pixels.corner, dtype=torch.float64)
    low = (middle - reach - corner).floor().long().clamp_min(0)
    high = (middle + reach - corner).ceil().long() + 1
    left, right = int(low[0]), min(int(high[0]), width)
    top, bottom = int(low[1]), min(int(high[1]), height)
    if right - left < 3 or bottom - top < 3:
        raise StreakError(LOST_END)
    step = max(1, int(((right - left) * (bottom - top) / MAX_PIXELS) ** 0.5))
    window = (slice(None), slice(top, bottom, step), slice(left, right, step))
    x = torch.arange(left, right, step) + corner[0]
    y = torch.arange(top, bottom, step) + corner[1]
    is_near = (x - middle[0]) ** 2 + (y[:, None] - middle[1]) ** 2 <= reach**2
    is_usable = is_near & torch.isfinite(pixels.variance[window]).any(0)
    return _Cap(
        x=x,
        y=y,
        is_usable=is_usable,
        estimator=pixels.estimator,
        signal=pixels.signal[window][:, is_usable].mT.double(),
        ground=pixels.ground[window][:, is_usable].mT.double(),
        variance=pixels.variance[window][:, is_usable].mT.double(),
    )


def _rays_and_nearest(
    end: Tensor, curve: Curve, cap: _Cap, camera: Camera
) -> tuple[Tensor, Tensor]:
    """Give rays [N, 3] of a cap's pixels and where the curve is nearest to them [N].

    Both change so evenly that they are found on a coarse grid and interpolated, to 0.01 px.
    """
    rows, columns = (max(2, math.ceil(float(at[-1] - at[0]) / COARSE) + 1) for at in (cap.y, cap.x))
    x = torch.linspace(float(cap.x[0]), float(cap.x[-1]), columns, dtype=torch.float64)
    y = torch.linspace(float(cap.y[0]), float(cap.y[-1]), rows, dtype=torch.float64)
    pixels = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    rays = camera.unproject(pixels)
    nearest = nearest_parameter(curve, end.expand(rows, columns), rays)
    coarse = torch.cat([rays, nearest[..., None]], dim=-1).movedim(-1, 0)[None]
    size = (len(cap.y), len(cap.x))
    fine = torch.nn.functional.interpolate(coarse, size, mode="bilinear", align_corners=True)
    values = fine[0][:, cap.is_usable].mT
    return torch.nn.functional.normalize(values[:, :3], dim=-1), values[:, 3]


def _median(values: Array) -> float:
    """Give the middle value, the lower one of two."""
    middle = (len(values) - 1) // 2
    return float(np.partition(values, middle)[middle])


def _half_rise(position: Array, opacity: Array, half_width: float) -> float:
    """Position at which the opacity first reaches half of its plateau beyond."""
    plateau = float(ranked_value(opacity, 0.7))
    found = float(position[0])
    for _ in range(3):
        above = opacity >= plateau / 2
        # a stray profile ahead of the streak does not count: the next few must follow
        steady = above[:-4] & above[1:-3] & above[2:-2] & above[3:-1] & above[4:]
        found = float(position[steady.argmax() if steady.any() else 0])
        beyond = (position >= found + half_width) & (position <= found + 2.5 * half_width)
        if not beyond.any():
            break
        plateau = _median(opacity[beyond])
    return found
