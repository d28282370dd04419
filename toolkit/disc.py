"""Finding the disc of a sharp ball over a known background, to a small part of a pixel."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.background import brightness_drift, check_pair, estimate_noise, scale_background
from toolkit.ball import Disc
from toolkit.disc_fit import MIN_DIRECTIONS, follow_rim
from toolkit.errors import CalibrationError, MismatchError
from toolkit.rim import Rim, find_rim, search_rim
from toolkit.rough_disc import Circle, find_rough_disc
from toolkit.scene_match import check_light, check_same_scene
from toolkit.types import LinearImage, NoiseModel

DRIFT = 0.003
"""Relative change of the light since the background beyond which the background follows it."""
MARGIN = 1.5
"""Radii about the centre that the window holds, and 12 px more."""
SEARCHES = (0.2, 0.1)
"""Shares of the radius, besides 2 px, within which the rim is first sought, by round."""
FIRST_BLUR, LEAST_BLUR, MOST_BLUR = 1.2, 0.3, 0.12
"""Standard deviation of the transition from ball to background: in px at first and at least, and as
a share of the radius at most."""
ROUNDS = 6
SETTLED = 0.01
"""px of movement of the outline below which it has settled."""
MIN_RADIUS = 12.0
"""px; in smaller discs the rim takes too large a part."""
MAX_ASPECT = 1.35
"""Longer over shorter axis: a ball 40 degrees off the axis."""
MAX_CLIPPED = 0.03
"""Share of the disc that may have met white: a highlight."""
MIN_SEEN = 0.5
"""Share of the outline that must be seen, undisturbed and where the ellipse says."""
NEAR, NEAR_SHARE = 0.5, 0.02
"""px, and share of the radius, from the ellipse within which it is said to be where that says."""
MAX_GAP = 0.4
"""Share of the outline that may be missing in one piece."""
MAX_MOVE, MAX_MOVE_SHARE = 3.0, 0.08
"""px, and share of the radius, by which a ball may move during the exposure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallView:
    """A sharp ball, its window of both pictures in the same light, and their noise."""

    image: LinearImage  # the window
    background: LinearImage  # the same window without the ball, in the light of the image
    corner: tuple[int, int]  # of the window in the picture, (x, y) px
    disc: Disc  # px of the window
    noise: NoiseModel  # of one picture
    clipped: float  # share of the disc that met white

    @property
    def picture_disc(self) -> Disc:
        """The disc in px of the whole picture."""
        return _moved(self.disc, *self.corner)


def find_disc(image: LinearImage, background: LinearImage) -> Disc:
    """Find the disc of a resting ball, sharp in the picture.

    Args:
        image: the ball, B = 1.
        background: the same view without the ball.

    Returns:
        The ellipse and the standard deviation of its outline, px.

    Raises:
        CalibrationError: when there is no ball, or it moved, is cut off, too small, too bright or
            not alone; the text says which.
        MismatchError: when the two pictures do not show the same scene in similar light.
    """
    return view_ball(image, background).picture_disc


def view_ball(image: LinearImage, background: LinearImage) -> BallView:
    """Find the disc as `find_disc` does, and keep what was needed for it."""
    check_pair(image, background)
    light = brightness_drift(image, background)
    check_light(light)
    lit = scale_background(background, light) if _is_other(light) else background
    check_same_scene(image, lit)
    circle = find_rough_disc(image, lit, estimate_noise(image, lit))
    _check_inside(_as_disc(circle), image, slack=0.1 * circle.radius)
    ignore = _covered(_as_disc(circle), image)
    light = brightness_drift(image, background, ignore)
    lit = scale_background(background, light) if _is_other(light) else background
    noise = estimate_noise(image, lit, ignore)
    return refine_view(image, lit, noise, _as_disc(circle))


def refine_view(
    image: LinearImage, background: LinearImage, noise: NoiseModel, rough: Disc
) -> BallView:
    """Fit the ellipse to the rim near a rough disc.

    Raises:
        CalibrationError: when it is no disc, moved, is cut off, too small or too bright.
    """
    left, top, width, height = _window(rough, image)
    seen, empty = (picture.window(left, top, width, height) for picture in (image, background))
    disc, rim, counted = _fit(seen, empty, noise, _moved(rough, -left, -top))
    whole = _moved(disc, left, top)
    _check_size(whole)
    _check_inside(whole, image, slack=-1.0)
    clipped = _clipped_share(seen, disc)
    _check_clipped(clipped)
    _check_seen(counted, whole)
    _check_rest(rim, counted, whole)
    return BallView(
        image=seen,
        background=empty,
        corner=(left, top),
        disc=disc,
        noise=noise,
        clipped=clipped,
    )


def view_disc(image: LinearImage, background: LinearImage, disc: Disc) -> BallView:
    """Give the view of a ball whose disc was found before.

    Raises:
        MismatchError: when the pictures differ in size, or the disc does not lie in them.
    """
    check_pair(image, background)
    try:
        _check_inside(disc, image, slack=0.0)
    except CalibrationError:
        raise MismatchError(
            f"the ball's disc about ({disc.centre[0]:.0f}, {disc.centre[1]:.0f}) px is not inside "
            f"its picture of {image.width}x{image.height} px; look at the ball again"
        ) from None
    ignore = _covered(disc, image)
    light = brightness_drift(image, background, ignore)
    lit = scale_background(background, light) if _is_other(light) else background
    left, top, width, height = _window(disc, image)
    seen = image.window(left, top, width, height)
    inner = _moved(disc, -left, -top)
    return BallView(
        image=seen,
        background=lit.window(left, top, width, height),
        corner=(left, top),
        disc=inner,
        noise=estimate_noise(image, lit, ignore),
        clipped=_clipped_share(seen, inner),
    )


def _fit(
    image: LinearImage, background: LinearImage, noise: NoiseModel, disc: Disc
) -> tuple[Disc, Rim, Tensor]:
    """Move the disc until the rims found agree with it; the zone they are sought in narrows."""
    for share in SEARCHES:
        rim = search_rim(image, background, noise, disc, 2 + share * disc.semi_axes[1])
        disc, _, weight = follow_rim(disc, rim)
    blur = FIRST_BLUR
    for _ in range(ROUNDS):
        rim = find_rim(image, background, noise, disc, blur)
        disc, movement, weight = follow_rim(disc, rim)
        spread = rim.spread[(weight > 0) & torch.isfinite(rim.spread)]
        if len(spread):
            usual = math.sqrt(max(float(spread.median()), 0.0))
            blur = min(max(usual, LEAST_BLUR), MOST_BLUR * disc.semi_axes[1])
        if movement < SETTLED:
            break
    near = rim.shift.abs() < NEAR + NEAR_SHARE * disc.semi_axes[1]
    return disc, rim, (weight > 0) & near


def _check_size(disc: Disc) -> None:
    radius = disc.semi_axes[1]
    if radius < MIN_RADIUS:
        raise CalibrationError(
            f"the ball is too small: its radius is {radius:.1f} px and {MIN_RADIUS:g} px are "
            "needed; go nearer, or use a longer lens"
        )


def _check_inside(disc: Disc, image: LinearImage, slack: float) -> None:
    """Raise `CalibrationError` where the disc crosses the border by more than `slack` px."""
    angle = torch.arange(64, dtype=torch.float64) * (math.tau / 64)
    rim = disc.from_unit(torch.stack([angle.cos(), angle.sin()], dim=-1))
    size = torch.tensor([image.width - 1, image.height - 1], dtype=rim.dtype)
    room = torch.minimum(rim, size - rim).amin(-1)
    if float(room.min()) < -slack:
        x, y = rim[int(room.argmin())].tolist()
        raise CalibrationError(
            f"the ball is cut by the picture's border near ({x:.0f}, {y:.0f}) px; "
            "show the whole ball"
        )


def _check_clipped(share: float) -> None:
    if share > MAX_CLIPPED:
        raise CalibrationError(
            f"{share:.1%} of the ball met white and only {MAX_CLIPPED:.0%} may; "
            "expose less, or soften the light"
        )


def _check_seen(counted: Tensor, disc: Disc) -> None:
    """Raise `CalibrationError` unless most of the outline follows the ellipse."""
    share = float(counted.double().mean())
    seen = counted.nonzero()[:, 0]
    ring = torch.cat([seen, seen[:1] + len(counted)])
    gap = float(ring.diff().max()) / len(counted) if len(seen) else 1.0
    if share < MIN_SEEN or gap > MAX_GAP or disc.semi_axes[0] > MAX_ASPECT * disc.semi_axes[1]:
        raise CalibrationError(
            f"no disc found: only {share:.0%} of the outline is seen to follow an ellipse; show "
            "the whole ball, resting, before a background of another brightness or colour"
        )


def _check_rest(rim: Rim, counted: Tensor, disc: Disc) -> None:
    """Raise `CalibrationError` where the rim is smeared along one direction.

    A ball that moves by m px has a rim whose transition has the variance m^2 / 12 along the motion
    and none across. [derived]
    """
    counted = counted & torch.isfinite(rim.spread)
    angle, spread = rim.angle[counted], rim.spread[counted]
    if len(angle) < MIN_DIRECTIONS:
        return
    design = torch.stack([torch.ones_like(angle), (2 * angle).cos(), (2 * angle).sin()], dim=-1)
    usual = spread.median()
    near = (spread - usual).abs() <= 6 * (spread - usual).abs().median()
    fit = torch.linalg.lstsq(design[near], spread[near, None]).solution[:, 0]
    moved = math.sqrt(24 * float(torch.linalg.vector_norm(fit[1:])))
    if moved > max(MAX_MOVE, MAX_MOVE_SHARE * disc.semi_axes[1]):
        raise CalibrationError(
            f"the ball moved by about {moved:.0f} px while the shutter was open; let it rest, or "
            "expose for a shorter time"
        )


def _is_other(light: Tensor) -> bool:
    return bool(((light - 1).abs() > DRIFT).any())


def _as_disc(circle: Circle) -> Disc:
    return Disc(
        centre=(circle.x, circle.y), semi_axes=(circle.radius, circle.radius), angle=0.0, std=0.0
    )


def _moved(disc: Disc, x: float, y: float) -> Disc:
    return replace(disc, centre=(disc.centre[0] + x, disc.centre[1] + y))


def _covered(disc: Disc, image: LinearImage) -> Tensor:
    """Mark the ball and what may touch it, [1, 1, H, W] bool."""
    x = torch.arange(image.width) - disc.centre[0]
    y = torch.arange(image.height) - disc.centre[1]
    return ((x**2 + y[:, None] ** 2) < (MARGIN * disc.semi_axes[0]) ** 2)[None, None]


def _window(disc: Disc, image: LinearImage) -> tuple[int, int, int, int]:
    reach = MARGIN * disc.semi_axes[0] + 12
    left, top = (max(0, math.floor(c - reach)) for c in disc.centre)
    right, bottom = (math.ceil(c + reach) + 1 for c in disc.centre)
    return left, top, min(right, image.width) - left, min(bottom, image.height) - top


def _clipped_share(image: LinearImage, disc: Disc) -> float:
    """Share of the disc that met white."""
    y, x = torch.meshgrid(torch.arange(image.height), torch.arange(image.width), indexing="ij")
    place = disc.to_unit(torch.stack([x, y], dim=-1).double())
    inside = torch.linalg.vector_norm(place, dim=-1) < 1
    return float(image.clipped[0, 0][inside].double().mean()) if bool(inside.any()) else 0.0
