"""Whether shot and background show the same scene, from the same place, in similar light."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from toolkit.errors import MismatchError
from toolkit.ranks import HALF_OF_NORMAL, ranked_value
from toolkit.types import LinearImage

GREEN = 1
MAX_SIDE = 512
"""px; larger pictures are reduced to about this."""
SMOOTHING = 2.0
"""px of the reduced picture."""
MAX_LIGHT = 8.0
"""Ratio of the light in shot and background beyond which they cannot be compared."""
TEXTURE = 0.1
"""Share of the picture, its steepest, by which the scene is recognised."""
SPARSE = 5
"""One pixel in so many tells what is usual in the picture."""
SIGNIFICANCE = 6.0
"""Steepness over that of noise from which it counts."""
MIN_STEEP = 400
"""Steep places without which nothing can be told."""
SEEN = 0.3
"""Share of a background's step from which the shot shows it: 1 in the same scene."""
MIN_AGREEMENT = 0.35
"""Share of the steps that the shot must show beyond those it shows the other way round, which are
as many in another scene; a large ball hides most."""
MIN_SHIFT = 3.0
"""px of the stored picture; what is less is left to the fit."""
UNMOVED = 0.25
"""Share of what a shift by MIN_SHIFT changes where the picture is steep: below, there is none."""
REMAINDER = 0.6
"""Share of the difference that may remain where a shift is to be believed."""
PEAK = 0.1
"""Share of the correlation in its peak from which a shift is looked at."""

Map = NDArray[np.float32]
Places = NDArray[np.intp]


def check_light(light: Tensor) -> None:
    """Raise `MismatchError` when the shot's light over the background's, [3], is far from 1."""
    if not bool(((light > 1 / MAX_LIGHT) & (light < MAX_LIGHT)).all()):
        ratios = ", ".join(f"{value:.3g}" for value in light.tolist())
        raise MismatchError(
            "background and shot do not fit together: in red, green, blue the shot is "
            f"{ratios} times as bright; take both with the same exposure in the same light"
        )


def check_same_scene(image: LinearImage, background: LinearImage, reduced_by: int = 1) -> None:
    """Raise `MismatchError` when the camera moved, or the scene is another one.

    A scene is recognised by the steepest places of the background, which the shot must show too; a
    camera that moved by the peak of the phase correlation, when a shift by it leaves much less of
    the difference. A scene without texture tells nothing and passes. [derived]

    Args:
        image: the shot.
        background: the scene without the ball, in the light of the shot.
        reduced_by: px of the stored picture to one of these.
    """
    factor = _reduction(image)
    shot, ground = (_reduced(picture, factor) for picture in (image, background))
    factor *= reduced_by
    smooth_shot, smooth_ground = _smooth(shot), _smooth(ground)
    slope = _slope(smooth_ground)
    steepness = np.asarray(cv2.magnitude(*slope), np.float32).ravel()
    steep = _steepest(ground, steepness)
    if len(steep) < MIN_STEEP:
        return
    change = _change(smooth_shot, smooth_ground, steep)
    is_still = change < UNMOVED * float(ranked_value(steepness[steep])) * MIN_SHIFT / factor
    shift = None if is_still else _shift(shot, ground, steep, change)
    if shift is not None and factor * math.hypot(*shift) >= MIN_SHIFT:
        x, y = (round(factor * length) for length in shift)
        raise MismatchError(
            "background and shot do not fit together: the camera moved between them, the picture "
            f"by about ({x}, {y}) px; fix the camera, and take the background again"
        )
    if _agreement(_slope(smooth_shot), slope, steep) < MIN_AGREEMENT:
        raise MismatchError(
            "background and shot do not fit together: most of what stands out in the background is "
            "not in the shot; take the background of the same scene from the same place"
        )


def _reduction(image: LinearImage) -> int:
    """Choose by how much to reduce a picture; a mosaic by whole periods of its pattern."""
    period = 1 if image.mosaic is None or image.pattern is None else len(image.pattern)
    return math.ceil(max(image.width, image.height) / MAX_SIDE / period) * period


def _reduced(image: LinearImage, factor: int) -> Map:
    """Average blocks of factor x factor px of the mosaic, else of green."""
    plane = image.rgb[0, GREEN] if image.mosaic is None else image.mosaic[0, 0]
    width, height = max(1, image.width // factor), max(1, image.height // factor)
    whole = plane[: height * factor, : width * factor].numpy()
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _smooth(picture: Map) -> Map:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), SMOOTHING), np.float32)


def _slope(smooth: Map) -> tuple[Map, Map]:
    """Give the derivatives of a smoothed picture in x and y, per px."""
    x, y = (cv2.Sobel(smooth, cv2.CV_32F, *d, scale=1 / 8) for d in ((1, 0), (0, 1)))
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def _steepest(picture: Map, steepness: Map) -> Places:
    """Give the places where the picture is steepest, and steeper than its noise can be."""
    # second differences see noise and hardly any texture; their gain is 6 (Immerkaer 1996)
    kernel = np.array([1, -2, 1], np.float32)
    rough = cv2.sepFilter2D(picture, cv2.CV_32F, kernel, kernel).ravel()[::SPARSE]
    noise = float(ranked_value(np.abs(rough))) / HALF_OF_NORMAL / 6
    # the gain of a Gaussian's derivative is 1 / (sqrt(8 pi) sigma^2)
    noise_slope = noise / ((8 * math.pi) ** 0.5 * SMOOTHING**2)
    usual = float(ranked_value(steepness[::SPARSE], 1 - TEXTURE))
    return np.flatnonzero(steepness > max(usual, SIGNIFICANCE * noise_slope))


def _agreement(shot: tuple[Map, Map], ground: tuple[Map, Map], steep: Places) -> float:
    """Share of the background's steps that the shot shows, less those it shows reversed."""
    (shot_x, shot_y), (x, y) = ([part.ravel()[steep] for part in both] for both in (shot, ground))
    share = (shot_x * x + shot_y * y) / (x * x + y * y)
    return float((share > SEEN).mean() - (share < -SEEN).mean())


def _change(smooth_shot: Map, smooth_ground: Map, steep: Places) -> float:
    """Median difference between smoothed shot and background where it is steep."""
    return float(ranked_value(np.abs(smooth_shot.ravel()[steep] - smooth_ground.ravel()[steep])))


def _shift(shot: Map, ground: Map, steep: Places, change: float) -> tuple[float, float] | None:
    """Give the shift (x, y) px from background to shot if it explains most of their difference."""
    window = cv2.createHanningWindow(shot.shape[::-1], cv2.CV_32F)
    # copies: pictures whose size suits the Fourier transform would be multiplied by the window
    (x, y), peak = cv2.phaseCorrelate(ground.copy(), shot.copy(), window)
    if peak < PEAK:
        return None
    move = np.array([[1, 0, x], [0, 1, y]])
    moved = cv2.warpAffine(ground, move, ground.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    left = _change(_smooth(shot), _smooth(np.asarray(moved, np.float32)), steep)
    return (x, y) if left < REMAINDER * change else None
