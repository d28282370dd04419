"""Where a sharp ball roughly is: the circle in what differs from the background."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.demosaicing import superpixels
from toolkit.errors import CalibrationError
from toolkit.types import LinearImage, NoiseModel

MAX_SIDE = 1200
"""px; larger pictures are reduced to this for the search."""
SMOOTHING = 1.0
"""px of the reduced picture."""
MIN_SIGNIFICANCE = 6.0
"""Smoothed difference over its standard deviation."""
MIN_SHARE = 0.12
"""Share of the strong differences that a pixel must reach: the light drifts a little everywhere."""
MIN_AREA = 60
"""px of the reduced picture."""
MOST = 0.7
"""Share of the picture beyond which it is not a ball that differs."""
DRAWS = 800
"""Circles through three points of the outline that are tried."""
TOLERANCE = 0.08
"""Share of the radius by which the outline may leave the circle: the image is an ellipse."""
MIN_COVERAGE = 0.6
"""Share of the circle along which the outline must follow it."""
SECTORS = 72
MAX_REST = 0.5
"""Share of the disc that other things may cover; shadows do not count."""
STREAK_RATIO, TRAIL_REST = 1.2, 0.1
"""Length over width of a filled region from which it is the trail of a moving ball, and the share
of a disc that it must cover beside it."""

Mask = NDArray[np.uint8]
Map = NDArray[np.float32]
Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle in the picture."""

    x: float  # px
    y: float  # px
    radius: float  # px


def find_rough_disc(image: LinearImage, background: LinearImage, noise: NoiseModel) -> Circle:
    """Find the circle that most of the outline of what differs from the background follows.

    Shadows, stands and hands may touch the ball as long as most of its outline stays free.

    Args:
        image: the ball, sharp, B = 1.
        background: the same view without it.
        noise: of one picture.

    Raises:
        CalibrationError: when there is no ball, nothing round, or more than a ball.
    """
    factor = _reduction(image)
    seen, empty = (_reduced(picture, factor) for picture in (image, background))
    differs = _differing(seen, empty, noise, factor, 1 + 1 / background.frames)
    regions = _regions(differs)
    circle, coverage = _best_circle(_outline(regions))
    is_shadow = (seen < empty).all(0)
    rest = _share_outside((regions > 0) & ~is_shadow, circle)
    _check_regions(regions, coverage, rest)
    return Circle(
        x=(circle.x + 0.5) * factor - 0.5,
        y=(circle.y + 0.5) * factor - 0.5,
        radius=circle.radius * factor,
    )


def _check_regions(regions: Mask, coverage: float, rest: float) -> None:
    """Raise `CalibrationError` unless a circle is most of what differs from the background.

    Args:
        regions: what differs.
        coverage: share of the best circle that their outline follows.
        rest: what lies outside of it and is no shadow, as a share of its area.
    """
    is_cut = _is_cut(regions)
    if is_cut and coverage < MIN_COVERAGE:
        raise CalibrationError(
            "no whole disc found: what differs from the background is cut by the picture's border; "
            "show the whole ball, and nothing else"
        )
    if not is_cut and (rest > TRAIL_REST or coverage < MIN_COVERAGE):
        _check_no_trail(regions)
    if coverage < MIN_COVERAGE:
        raise CalibrationError(
            "no disc found: what differs from the background is not round; show the whole ball, "
            "resting, and take away hands and other things"
        )
    if rest > MAX_REST:
        raise CalibrationError(
            "more than a ball differs from the background: besides its disc something covers "
            f"{rest:.1f} times its area; take away hands and other things, and show one ball"
        )


def _reduction(image: LinearImage) -> int:
    """Choose by how much to reduce a picture; a mosaic by whole periods of its pattern."""
    period = 1 if image.mosaic is None or image.pattern is None else len(image.pattern)
    return math.ceil(max(image.width, image.height) / MAX_SIDE / period) * period


def _reduced(image: LinearImage, factor: int) -> Map:
    """Average blocks of factor x factor px, [3, h, w]; an incomplete last block is cut off."""
    if image.mosaic is not None and image.pattern is not None:
        return np.asarray(superpixels(image.mosaic[0, 0].numpy(), image.pattern, factor))
    height, width = image.height // factor, image.width // factor
    planes = image.rgb[0, :, : height * factor, : width * factor].numpy()
    return np.stack([cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in planes])


def _differing(seen: Map, empty: Map, noise: NoiseModel, factor: int, share: float) -> Mask:
    """Mark the pixels that differ from the background, clearly and not only a little, [H, W]."""
    read, gain, density = (
        v.double().numpy().reshape(3, 1, 1)
        for v in (noise.read_variance, noise.gain, noise.density)
    )
    variance = (read + gain * empty.clip(0)) * share / (density * factor**2)
    smooth = np.stack([cv2.GaussianBlur(p, (0, 0), SMOOTHING) for p in seen - empty])
    significance = np.sqrt((smooth**2 / variance).sum(0) * (4 * math.pi * SMOOTHING**2))
    size = np.sqrt((smooth**2).sum(0))
    found = significance > MIN_SIGNIFICANCE
    if np.count_nonzero(found) < MIN_AREA:
        raise CalibrationError(
            f"no ball found: only {np.count_nonzero(found)} places in the picture differ from the "
            "background; check that one shows the ball and the other does not"
        )
    strong = float(np.quantile(size[found], 0.9))
    return np.asarray(found & (size > MIN_SHARE * strong), dtype=np.uint8)


def _regions(differs: Mask) -> Mask:
    """Keep the regions that are large enough to be part of the ball, filled."""
    closed = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    outlines, _ = cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    areas = [cv2.contourArea(line) for line in outlines]
    largest = max(areas, default=0.0)
    if largest < MIN_AREA:
        raise CalibrationError(
            "no ball found: what differs from the background is only specks; check both pictures"
        )
    if largest > MOST * differs.size:
        raise CalibrationError(
            f"no ball found: {largest / differs.size:.0%} of the picture differs from the "
            "background; take both from the same place in the same light, the ball not too near"
        )
    kept = [line for line, area in zip(outlines, areas, strict=True) if area > 0.03 * largest]
    regions = np.zeros_like(differs)
    cv2.drawContours(regions, kept, -1, 1, cv2.FILLED)
    return regions


def _outline(regions: Mask) -> Points:
    """Give the outline of the regions [N, 2] px, without what lies along the picture's border."""
    lines, _ = cv2.findContours(regions, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = np.concatenate([line[:, 0] for line in lines]).astype(np.float64)
    limit = np.array(regions.shape[::-1]) - 2
    inside = ((points > 1) & (points < limit)).all(-1)
    return np.asarray(points[inside][:: max(1, np.count_nonzero(inside) // 600)])


def _best_circle(points: Points) -> tuple[Circle, float]:
    """Give the circle along most of which points lie [N, 2], and the share of it that they cover.

    Circles through three points drawn at random (with a fixed seed) are compared.
    """
    if len(points) < 12:
        return Circle(x=0, y=0, radius=1), 0.0
    drawn = np.random.default_rng(0).integers(len(points), size=(DRAWS, 3))
    centre, radius = _through(points[drawn])
    reach = np.ptp(points, axis=0).max()
    usable = np.isfinite(radius) & (radius > 3) & (radius < reach)
    centre, radius = centre[usable], radius[usable]
    if not len(radius):
        return Circle(x=0, y=0, radius=1), 0.0
    away = points - centre[:, None]
    near = np.abs(np.hypot(away[..., 0], away[..., 1]) - radius[:, None])
    # more than the tolerance is no support, less counts the more the nearer it is
    limit = np.maximum(1.5, TOLERANCE * radius)[:, None]
    sector = ((np.arctan2(away[..., 1], away[..., 0]) / math.tau % 1) * SECTORS).astype(
        int
    ) % SECTORS
    support = np.zeros((len(radius), SECTORS))
    rows = np.broadcast_to(np.arange(len(radius))[:, None], sector.shape)
    np.maximum.at(support, (rows, sector), np.clip(1 - (near / limit) ** 2, 0, None))
    best = int(support.sum(-1).argmax())
    x, y = centre[best].tolist()
    return Circle(x=x, y=y, radius=float(radius[best])), float((support[best] > 0).mean())


def _through(corners: NDArray[np.float64]) -> tuple[Points, Points]:
    """Give centre [N, 2] and radius [N] of the circles through three points each [N, 3, 2]."""
    first = corners[:, 0]
    (bx, by), (cx, cy) = (corners[:, 1] - first).T, (corners[:, 2] - first).T
    with np.errstate(divide="ignore", invalid="ignore"):
        twice = 2 * (bx * cy - by * cx)
        b2, c2 = bx**2 + by**2, cx**2 + cy**2
        offset = np.stack([(cy * b2 - by * c2) / twice, (bx * c2 - cx * b2) / twice], axis=-1)
    return first + offset, np.hypot(offset[:, 0], offset[:, 1])


def _share_outside(others: NDArray[np.bool_], circle: Circle) -> float:
    """Give the area outside a circle, as a share of its own."""
    y, x = np.nonzero(others)
    outside = np.hypot(x - circle.x, y - circle.y) > 1.15 * circle.radius + 2
    return float(np.count_nonzero(outside)) / (math.pi * circle.radius**2)


def _largest(regions: Mask) -> NDArray[np.int32]:
    """Give the outline of the largest region, as OpenCV draws it."""
    lines, _ = cv2.findContours(regions, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(max(lines, key=cv2.contourArea), np.int32)


def _is_cut(regions: Mask) -> bool:
    """Tell whether the largest region lies along the picture's border for a while."""
    largest = np.zeros_like(regions)
    cv2.drawContours(largest, [_largest(regions)], -1, 1, cv2.FILLED)
    border = (largest[1], largest[-2], largest[:, 1], largest[:, -2])
    return bool(max(np.count_nonzero(line) for line in border) > MIN_AREA**0.5)


def _check_no_trail(regions: Mask) -> None:
    """Raise `CalibrationError` where the largest region is the trail of a moving ball."""
    largest = _largest(regions)
    _, sides, _ = cv2.minAreaRect(largest)
    length, width = max(sides) + 1, min(sides) + 1
    # a round trail of constant width fills its hull; what a stick or a hand adds does not
    is_filled = cv2.contourArea(cv2.convexHull(largest)) < 1.1 * cv2.contourArea(largest)
    if length > STREAK_RATIO * width and is_filled:
        raise CalibrationError(
            f"the ball moved: what differs from the background is {length / width:.1f} times as "
            "long as wide; let it rest, or expose for a shorter time"
        )
