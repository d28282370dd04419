"""Finding the ball's trail without help.

It is where the opacity is significant, has the ball's colour and the shape of a streak.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Observation
from toolkit.errors import ConfigError, StreakError
from toolkit.middle_line import AXIS_POINTS, Map, Mask
from toolkit.overview import MAX_SIDE, Overview
from toolkit.splines import fit_smooth
from toolkit.streak_shape import Region, is_of_a_ball, regions
from toolkit.types import LinearImage, NoiseModel, Streak

SMOOTHING = 1.5
"""px of the reduced picture."""
LEAST_VARIANCE = 1e-14
"""Of what an estimator observes: what is below is taken for that much."""
MIN_SIGNIFICANCE = 5.0
"""Smoothed opacity over its standard deviation: one false pixel in a million."""
MIN_OPACITY = 0.04
FAINT = 0.008
"""Opacity down to which a streak is followed on from where it is clear."""
MIN_LIKENESS = 0.2
"""Share of a pixel's change that the ball's colour must explain: little, since the light varies."""
MIN_AREA = 60
"""px of the picture in which a streak is finally found."""
FIRST_AREA = 12
"""px of the reduced picture, from which a region is looked at more closely."""
FINE = 6.0
"""px of the reduced picture; thinner streaks are looked at in a less reduced window."""
ZOOM = 3.0
"""Half widths about a region that this window holds, and 8 px more."""
ROI = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scene:
    """Shot and background, or a window of both, reduced, and what is to be found in them."""

    pictures: Overview
    noise: NoiseModel
    estimator: AlphaEstimator
    roi: ROI | None  # px before they were reduced


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    """What was found in a scene, and why nothing, should no region be of a ball."""

    regions: list[Region]  # the likeliest first
    opacity: Map | None  # [H, W]; None where its scale is not known
    why_nothing: str


def find_streak(
    image: LinearImage,
    background: LinearImage,
    noise: NoiseModel,
    estimator: AlphaEstimator,
    roi: ROI | None = None,
    overview: Overview | None = None,
) -> Streak:
    """Find the streak and its rough axis in one picture: also that of a ball that stood still.

    Args:
        image: the shot, B = 1.
        background: the scene without the ball.
        noise: of the shot.
        estimator: gives the opacity of every pixel.
        roi: left, top, width, height in px to search in; the whole picture when None.
        overview: of shot and background, where it is at hand.

    Returns:
        Streak; the axis runs from tip to tip, to the right in the picture, or down where it is
        upright.

    Raises:
        StreakError: when nothing in the picture looks like the trail of such a ball.
        ConfigError: when the region lies outside the picture.
    """
    if roi is not None:
        _check_roi(roi, image)
    overview = Overview.of(image, background) if overview is None else overview
    factor = overview.factor
    scene = _Scene(pictures=overview, noise=noise, estimator=estimator, roi=roi)
    first = _search(scene, MIN_AREA if factor == 1 else FIRST_AREA)
    for region in first.regions:
        area, finer = _closer(region, factor, image)
        found, seen = first, [region]
        if finer != factor:
            window = Overview.of(image.window(*area), background.window(*area), finer)
            part = None if roi is None else _intersection(roi, area)
            found = _search(replace(scene, pictures=window, roi=part), MIN_AREA)
            seen = found.regions
        for near in seen:
            if near.mask.sum() >= MIN_AREA and is_of_a_ball(near, found.opacity):
                return _streak(near, (0, 0) if finer == factor else area[:2], finer, image)
    raise StreakError(first.why_nothing)


def _search(scene: _Scene, min_area: int) -> _Search:
    """Look for the streak in a scene; all is in px of the reduced pictures.

    Args:
        scene: where to search.
        min_area: px.
    """
    pictures = scene.pictures
    observation = scene.estimator.observe(
        pictures.image, pictures.background, _averaged(scene.noise, pictures.factor)
    )
    opacity, significance, likeness = _evidence(observation, scene.estimator)
    seen = ((significance > MIN_SIGNIFICANCE) & (likeness > MIN_LIKENESS)).astype(np.uint8)
    if scene.roi is not None:
        region = _roi_mask(scene.roi, pictures.factor, seen.shape)
        seen &= region
        significance = significance * region
    found = seen * (opacity > MIN_OPACITY)
    faint = seen * (opacity > FAINT)
    merit = opacity * likeness
    return _Search(
        regions=sorted(
            regions(found, faint, min_area),
            key=lambda region: float(merit[region.mask > 0].sum()) * region.evenness,
            reverse=True,
        ),
        opacity=None if scene.estimator.unknowns() else opacity,
        why_nothing=_why_nothing(found, significance),
    )


def _closer(region: Region, factor: int, image: LinearImage) -> tuple[ROI, int]:
    """Choose a window about a thin region and by how much less to reduce it."""
    wanted = max(1, int(factor * (region.half_width - SMOOTHING) / FINE))
    reach = ZOOM * region.half_width + 8
    low = ((region.axis.min(0) - reach) * factor).clip(0).astype(int)
    high = ((region.axis.max(0) + reach) * factor).clip(0, (image.width, image.height)).astype(int)
    period = 1 if image.pattern is None else len(image.pattern)
    left, top = (low // period * period).tolist()
    width, height = (high - (left, top)).tolist()
    # whole periods of a mosaic need not be filled in
    finer = math.ceil(max(wanted, max(width, height) / MAX_SIDE) / period) * period
    return (left, top, width, height), min(finer, factor)


def _streak(region: Region, corner: tuple[int, int], factor: int, image: LinearImage) -> Streak:
    """Give a region of a reduced window, whose corner lies at (x, y) px, in the whole picture."""
    axis = _forward((region.axis + 0.5) * factor - 0.5 + corner)
    x, y, width, height = cv2.boundingRect(region.mask)
    fine = region.mask[y : y + height, x : x + width].repeat(factor, 1).repeat(factor, 0)
    left, top = corner[0] + x * factor, corner[1] + y * factor
    mask = np.zeros((image.height, image.width), np.uint8)
    mask[top : top + height * factor, left : left + width * factor] = fine
    return Streak(
        mask=torch.from_numpy(mask.view(np.bool_))[None, None],
        axis=torch.from_numpy(axis)[None],
        half_width=torch.tensor([region.half_width * factor], dtype=torch.float64),
        travel=torch.tensor([region.travel * factor], dtype=torch.float64),
    )


def refine_axis(middle: Tensor, weight: Tensor, position: Tensor, sizes: tuple[int, ...]) -> Tensor:
    """Give a smoother axis through fitted profile centres, drawn on straight to the old tips.

    Args:
        middle: fitted centre points [P, 2] px.
        weight: 1 / variance of the centres, 0 for profiles to ignore [P].
        position: arc length of the origins [P] px.
        sizes: numbers of coefficients to choose from.

    Returns:
        Axis points [1, N, 2] px.
    """
    curve = fit_smooth(position, middle, weight, sizes)
    inner = position.clamp(curve.basis.start, curve.basis.stop)
    points = curve(inner) + (position - inner)[:, None] * curve(inner, 1)
    keep = torch.linspace(0, len(points) - 1, AXIS_POINTS).round().long()
    return points[keep][None]


def _averaged(noise: NoiseModel, factor: int) -> NoiseModel:
    return replace(noise, density=noise.density * factor**2)


def _evidence(observation: Observation, estimator: AlphaEstimator) -> tuple[Map, Map, Map]:
    """Give opacity, its significance, and the share of the change the colour explains, [H, W]."""
    if estimator.unknowns():
        return _plain_evidence(observation)
    colour = estimator.middle_colour(observation)[0].float()
    change, ground, variance = _changes(observation)
    sums = torch.zeros(3, *change.shape[1:])
    # channel by channel, which stays in the cache
    for foreground, empty, moved, spread in zip(colour, ground, change, variance, strict=True):
        precision = spread.clamp_min(LEAST_VARIANCE).reciprocal_()
        contrast = foreground - empty
        weight = contrast * precision
        sums[0].addcmul_(weight, moved)
        sums[1].addcmul_(weight, contrast)
        sums[2].addcmul_(precision.mul_(moved), moved)
    seen, information, energy = (_smooth(total) for total in sums.numpy())
    information = information.clip(1e-12)
    opacity = seen / information
    significance = seen * np.sqrt(4 * math.pi * SMOOTHING**2 / information)
    explained = opacity * seen
    # the pixel's own noise is part of its energy, and not of what any colour could explain
    likeness = explained / np.maximum(energy - len(colour), explained).clip(1e-12)
    return opacity, significance, likeness


def _changes(observation: Observation) -> tuple[Tensor, Tensor, Tensor]:
    """Give signal minus ground, ground and variance of the first picture, [Q, H, W] each."""
    change = observation.signal - observation.ground
    return change[0].float(), observation.ground[0].float(), observation.variance[0].float()


def _plain_evidence(observation: Observation) -> tuple[Map, Map, Map]:
    """Do the same where the ball's colour is not known: any change that neighbours share counts.

    The largest change is taken for half covered.
    """
    change, _, variance = (values.numpy() for values in _changes(observation))
    seen, energy = (np.zeros(change.shape[1:], np.float32) for _ in range(2))
    for moved, spread in zip(change, variance, strict=True):
        weight = 1 / np.maximum(spread, LEAST_VARIANCE)
        information = _smooth(weight)
        weight *= moved
        total = _smooth(weight)
        seen += total * total / np.maximum(information, 1e-12)
        energy += np.multiply(weight, moved, out=weight)
    energy, expected = _smooth(energy), len(change)
    significance = np.sqrt(np.maximum(seen * (4 * math.pi * SMOOTHING**2) - expected, 0))
    likeness = seen / np.maximum(energy - expected, seen).clip(1e-12)
    return significance / (2 * max(float(significance.max()), 1e-12)), significance, likeness


def _smooth(picture: Map) -> Map:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), SMOOTHING), np.float32)


def _check_roi(roi: ROI, image: LinearImage) -> None:
    left, top, width, height = roi
    fits = 0 <= left and 0 <= top and left + width <= image.width and top + height <= image.height
    if not fits or width <= 0 or height <= 0:
        raise ConfigError(
            f"region {left},{top},{width},{height} does not lie inside the picture "
            f"({image.width}x{image.height} px); give X,Y,W,H inside it"
        )


def _intersection(roi: ROI, area: ROI) -> ROI:
    """Give the part of a region within an area, from the area's corner."""
    low = [max(roi[axis] - area[axis], 0) for axis in (0, 1)]
    high = [min(roi[a] + roi[a + 2] - area[a], area[a + 2]) for a in (0, 1)]
    return low[0], low[1], max(high[0] - low[0], 0), max(high[1] - low[1], 0)


def _roi_mask(roi: ROI, factor: int, shape: tuple[int, ...]) -> Mask:
    left, top, width, height = roi
    mask = np.zeros(shape, np.uint8)
    mask[
        top // factor : -(-(top + height) // factor), left // factor : -(-(left + width) // factor)
    ] = 1
    return mask


def _forward(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Let the axis run to the right, or down where it is upright."""
    dx, dy = axis[-1] - axis[0]
    runs_forward = dx > 0 if abs(dx) >= 1 else dy > 0
    return np.ascontiguousarray(axis if runs_forward else axis[::-1])


def _why_nothing(found: Mask, significance: Map) -> str:
    if not found.any():
        seen = float(significance.max())
        return (
            "no ball found: nothing in the picture differs from the background towards the ball's "
            f"colour (best significance {seen:.1f}, {MIN_SIGNIFICANCE:g} needed); "
            "check shot, background and ball colour"
        )
    return (
        "no streak found: what differs from the background is too small, or has not the shape or "
        "the opacity of a ball's trail; check background and ball colour, or point at the ball "
        "with a region"
    )
