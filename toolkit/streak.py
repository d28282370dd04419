"""Finding the ball's trail without help.

It is where the opacity is significant, has the ball's colour and the shape of a streak.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Observation
from toolkit.demosaicing import superpixels
from toolkit.errors import ConfigError, StreakError
from toolkit.splines import SplineBasis, fit_smooth, fit_spline
from toolkit.types import LinearImage, NoiseModel, Streak

Mask = NDArray[np.uint8]
Map = NDArray[np.float32]

MAX_SIDE = 800
"""px; larger pictures are reduced to this: the search for a whole streak needs no more."""
SMOOTHING = 1.5
"""px of the reduced picture."""
MIN_SIGNIFICANCE = 5.0
"""Smoothed opacity over its standard deviation: one false pixel in a million."""
MIN_OPACITY = 0.04
MIN_LIKENESS = 0.2
"""Share of a pixel's change that the ball's colour must explain: little, since the light varies."""
MIN_AREA = 60
"""px of the reduced picture."""
CANDIDATES = 6
AXIS_POINTS = 64
MIN_ELONGATION = 1.5
"""Length of a candidate over its width; rounder ones are not streaks."""
ROI = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A connected region that may be the streak, px of the reduced picture."""

    mask: Mask  # [H, W] 0 or 1
    axis: NDArray[np.float64]  # [N, 2]
    half_width: float
    score: float


def find_streak(
    image: LinearImage,
    background: LinearImage,
    noise: NoiseModel,
    estimator: AlphaEstimator,
    roi: ROI | None = None,
) -> Streak:
    """Find the streak and its rough axis in one picture.

    Args:
        image: the shot, B = 1.
        background: the scene without the ball.
        noise: of the shot.
        estimator: gives the opacity of every pixel.
        roi: left, top, width, height in px to search in; the whole picture when None.

    Returns:
        Streak; the axis runs from tip to tip, to the right in the picture, or down where it is
        upright.

    Raises:
        StreakError: when nothing in the picture looks like the streak of such a ball.
        ConfigError: when the region lies outside the picture.
    """
    factor = _reduction(image)
    observation = estimator.observe(
        _reduced(image, factor), _reduced(background, factor), _averaged(noise, factor)
    )
    opacity, significance, likeness = _evidence(observation, estimator)
    found = (
        (significance > MIN_SIGNIFICANCE) & (opacity > MIN_OPACITY) & (likeness > MIN_LIKENESS)
    ).astype(np.uint8)
    if roi is not None:
        region = _roi_mask(roi, image, factor, found.shape)
        found &= region
        significance = significance * region
    candidates = sorted(_candidates(found, opacity, likeness), key=lambda c: c.score, reverse=True)
    if not candidates:
        raise StreakError(_why_nothing(found, significance))
    best = candidates[0]
    axis = _forward((best.axis + 0.5) * factor - 0.5)
    mask = cv2.resize(best.mask, (image.width, image.height), interpolation=cv2.INTER_NEAREST)
    return Streak(
        mask=torch.from_numpy(mask.view(np.bool_))[None, None],
        axis=torch.from_numpy(axis)[None],
        half_width=torch.tensor([best.half_width * factor], dtype=torch.float64),
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


def _reduction(image: LinearImage) -> int:
    """Choose by how much to reduce a picture; a mosaic by whole periods of its pattern."""
    factor = max(1, math.ceil(max(image.width, image.height) / MAX_SIDE))
    period = 1 if image.pattern is None or factor == 1 else len(image.pattern)
    return math.ceil(factor / period) * period


def _reduced(image: LinearImage, factor: int) -> LinearImage:
    """Average blocks of factor x factor px; an incomplete last block is cut off."""
    if factor == 1:
        return image
    width, height = image.width // factor, image.height // factor
    area = (..., slice(height * factor), slice(width * factor))
    if image.mosaic is not None and image.pattern and factor % len(image.pattern) == 0:
        rgb = superpixels(image.mosaic[0, 0].numpy(), image.pattern, factor)
    else:
        planes = [
            cv2.resize(plane, (width, height), interpolation=cv2.INTER_AREA)
            for plane in image.rgb[area][0].numpy()
        ]
        rgb = np.stack(planes)
    # the largest of the block that starts at a pixel
    block = np.ones((factor, factor), np.uint8)
    met_white = cv2.dilate(image.clipped[area][0, 0].numpy().view(np.uint8), block, anchor=(0, 0))
    return replace(
        image,
        rgb=torch.from_numpy(rgb)[None],
        clipped=torch.from_numpy(met_white[::factor, ::factor] > 0)[None, None],
        mosaic=None,
        pattern=None,
    )


def _averaged(noise: NoiseModel, factor: int) -> NoiseModel:
    return replace(noise, density=noise.density * factor**2)


def _evidence(observation: Observation, estimator: AlphaEstimator) -> tuple[Map, Map, Map]:
    """Give opacity, its significance, and the share of the change the colour explains, [H, W]."""
    if estimator.unknowns():
        return _plain_evidence(observation)
    alpha, variance = estimator.alpha(observation)
    information = 1 / variance
    change = observation.signal - observation.ground
    energy = (change * change / observation.variance).sum(1, keepdim=True)
    smooth_information = _smooth(information)
    smooth = _smooth(alpha * information) / smooth_information.clip(1e-12)
    std = 1 / np.sqrt(smooth_information * (4 * math.pi * SMOOTHING**2))
    explained = smooth * smooth * smooth_information
    # the pixel's own noise is part of its energy, and not of what any colour could explain
    unexplained = _smooth(energy) - observation.signal.shape[1]
    likeness = explained / np.maximum(unexplained, explained).clip(1e-12)
    return smooth, smooth / std, likeness


def _plain_evidence(observation: Observation) -> tuple[Map, Map, Map]:
    """Do the same where the ball's colour is not known: any change that neighbours share counts.

    The largest change is taken for half covered.
    """
    change = observation.signal - observation.ground
    weights, expected = 1 / observation.variance, change.shape[1]
    seen, energy = (np.zeros(change.shape[-2:], np.float32) for _ in range(2))
    for weight, moved in zip(torch.split(weights, 1, 1), torch.split(change, 1, 1), strict=True):
        information = _smooth(weight)
        mean = _smooth(moved * weight) / information.clip(1e-12)
        seen += mean * mean * information
        energy += _smooth(moved * moved * weight)
    significance = np.sqrt(np.maximum(seen * (4 * math.pi * SMOOTHING**2) - expected, 0))
    likeness = seen / np.maximum(energy - expected, seen).clip(1e-12)
    return significance / (2 * max(float(significance.max()), 1e-12)), significance, likeness


def _smooth(values: Tensor) -> Map:
    picture = values[0, 0].to(torch.float32).numpy()
    return cv2.GaussianBlur(picture, (0, 0), SMOOTHING).astype(np.float32)


def _roi_mask(roi: ROI, image: LinearImage, factor: int, shape: tuple[int, ...]) -> Mask:
    left, top, width, height = roi
    fits = 0 <= left and 0 <= top and left + width <= image.width and top + height <= image.height
    if not fits or width <= 0 or height <= 0:
        raise ConfigError(
            f"region {left},{top},{width},{height} does not lie inside the picture "
            f"({image.width}x{image.height} px); give X,Y,W,H inside it"
        )
    mask = np.zeros(shape, np.uint8)
    mask[
        top // factor : -(-(top + height) // factor), left // factor : -(-(left + width) // factor)
    ] = 1
    return mask


def _candidates(found: Mask, opacity: Map, likeness: Map) -> Iterator[Candidate]:
    """Yield the largest regions that are elongated enough, with their axes."""
    closed = cv2.morphologyEx(found, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    by_area = sorted(range(1, count), key=lambda i: stats[i, cv2.CC_STAT_AREA], reverse=True)
    for label in by_area[:CANDIDATES]:
        if stats[label, cv2.CC_STAT_AREA] < MIN_AREA:
            return
        mask = _fill_holes((labels == label).astype(np.uint8))
        axis, half_width = trace_axis(mask)
        length = float(np.linalg.norm(np.diff(axis, axis=0), axis=1).sum())
        if length >= MIN_ELONGATION * 2 * half_width:
            evenness = _evenness(mask, axis, half_width)
            score = float((opacity * likeness)[mask > 0].sum()) * evenness
            yield Candidate(mask=mask, axis=axis, half_width=half_width, score=score)


def _fill_holes(mask: Mask) -> Mask:
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(mask)
    cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
    return filled


def _evenness(mask: Mask, axis: NDArray[np.float64], half_width: float) -> float:
    """Intersection over union of the region and a band of constant width about its axis."""
    band = np.zeros_like(mask)
    inner = axis[_between_caps(axis, half_width)]
    points = np.round(inner).astype(np.int32)[:, None]
    cv2.polylines(band, [points], isClosed=False, color=1, thickness=max(1, round(2 * half_width)))
    union = int(np.count_nonzero(band | mask))
    return int(np.count_nonzero(band & mask)) / max(union, 1)


def _between_caps(axis: NDArray[np.float64], half_width: float) -> NDArray[np.bool_]:
    length = np.concatenate([[0.0], np.linalg.norm(np.diff(axis, axis=0), axis=1).cumsum()])
    return np.asarray((length >= half_width) & (length <= length[-1] - half_width))


def trace_axis(mask: Mask) -> tuple[NDArray[np.float64], float]:
    """Trace the middle line of an elongated region, from tip to tip, and its half width.

    Pixels are ordered by their distance from one tip measured inside the region; the middles of
    equal distances make the line, which therefore follows any bend that does not cross itself.
    [derived]

    Args:
        mask: [H, W], 1 inside the region.

    Returns:
        Points [N, 2] px and the half width, px.
    """
    columns, rows = np.nonzero(mask.any(0))[0], np.nonzero(mask.any(1))[0]
    left, top = int(columns[0]) - 1, int(rows[0]) - 1
    window = np.pad(mask, 1)[rows[0] : rows[-1] + 3, columns[0] : columns[-1] + 3]
    ys, xs = np.nonzero(window)
    tip = _farthest(window, (int(ys[0]), int(xs[0])))
    distance = _walk(window, _farthest(window, tip))
    far = distance[ys, xs]
    half_width = float(cv2.distanceTransform(window, cv2.DIST_L2, 5).max())
    half_width = min(half_width, mask.sum() / max(2 * float(far.max()), 1.0) * 1.2)
    points = np.stack([xs + left, ys + top], axis=-1).astype(np.float64)
    edge = min(half_width, far.max() / 4)
    inside = (far >= edge) & (far <= far.max() - edge)
    basis = SplineBasis(
        start=float(edge),
        stop=float(far.max() - edge),
        size=int(np.clip(2 + far.max() / (5 * half_width), 2, 8)),
    )
    order = torch.from_numpy(far[inside].astype(np.float64))
    coefficients, _ = fit_spline(
        basis, order, torch.from_numpy(points[inside]), torch.ones_like(order)
    )
    along = torch.linspace(0, float(far.max()), AXIS_POINTS, dtype=torch.float64)
    inner = along.clamp(basis.start, basis.stop)
    line = basis(inner) @ coefficients + (along - inner)[:, None] * (basis(inner, 1) @ coefficients)
    return line.numpy(), half_width


def _farthest(window: Mask, seed: tuple[int, int]) -> tuple[int, int]:
    distance = _walk(window, seed)
    row, column = np.unravel_index(int(distance.argmax()), distance.shape)
    return int(row), int(column)


def _walk(window: Mask, seed: tuple[int, int]) -> NDArray[np.float32]:
    """Count the steps from the seed to every pixel of the region, about 1 px each; -1 elsewhere."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    square = np.ones((3, 3), np.uint8)
    reached = np.zeros_like(window)
    reached[seed] = 1
    distance = np.where(reached > 0, 0, -1).astype(np.float32)
    step = 0
    while True:
        step += 1
        # a cross after every two squares advances nearly equally far in every direction
        grown = np.zeros_like(window)
        cv2.dilate(reached, cross if step % 3 == 0 else square, dst=grown)
        grown &= window
        new = grown != reached
        if not new.any():
            if step % 3:
                return distance
            continue  # a cross may stop where only a corner leads on
        distance[new] = step
        reached = grown


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
        "no streak found: what differs from the background is too small or too round; the "
        "method needs a streak about 2.6 times as long as wide, so expose longer, or point at it "
        "with a region"
    )
