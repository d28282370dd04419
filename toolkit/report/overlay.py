"""What was found, drawn on the shot."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from toolkit.ball import Disc
from toolkit.files import write_whole
from toolkit.measurement import ContourPoints, Measurement, ProfileTable
from toolkit.types import LinearImage

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

# R, G, B; told apart by people with any colour vision (Okabe and Ito)
CONTOUR: Colour = (240, 228, 66)
AXIS: Colour = (86, 180, 233)
GOOD_PROFILE: Colour = (0, 158, 115)
LEFT_OUT_PROFILE: Colour = (213, 94, 0)
BRIGHTEST = 0.6  # light to which a dark shot is raised: against white the lines would drown

REFERENCE_SIZE = 1400  # px of the longer side for which lines are one pixel wide
PROFILE_SPACING = 8  # px at least between the profiles drawn, for lines of one pixel
SUBPIXEL_BITS = 4  # OpenCV draws in units of 1/16 px


def draw_overlay(image: LinearImage, measurement: Measurement) -> Picture:
    """Draw profiles, contours and axis on the whole shot.

    Args:
        image: the shot, one picture.
        measurement: what was found on it; parts that are None are not drawn.

    Returns:
        sRGB picture [H, W, 3] of 8 bits, R first; the shot's brightness is stretched to be seen.
    """
    picture = visible(image)
    pen = max(1, round(max(image.width, image.height) / REFERENCE_SIZE))
    contours = measurement.contours
    if contours is not None:
        if measurement.profiles is not None:
            _draw_profiles(picture, measurement.profiles, contours, pen)
        if measurement.speed_upper_m_s is None:  # else it may have stood still, without any axis
            is_open = measurement.sign is None or measurement.sign.ambiguous
            _draw_axis(picture, contours, pen, arrow=not is_open)
        draw_line(picture, np.array(contours.left), CONTOUR, pen)
        draw_line(picture, np.array(contours.right), CONTOUR, pen)
    return picture


def write_overlay(path: Path, image: LinearImage, measurement: Measurement) -> None:
    """Write `draw_overlay` as a PNG, whole or not at all.

    Raises:
        EnvironmentFault: when the place cannot be written.
    """
    write_picture(path, draw_overlay(image, measurement))


def draw_disc(image: LinearImage, disc: Disc) -> Picture:
    """Draw the outline of a sharp ball's disc and its centre.

    Args:
        image: the picture of the ball.
        disc: where it was found.

    Returns:
        sRGB picture [H, W, 3] of 8 bits, R first; its brightness is stretched to be seen.
    """
    picture = visible(image)
    pen = max(1, round(max(image.width, image.height) / REFERENCE_SIZE))
    angle = np.linspace(0, 2 * np.pi, 361)
    outline = torch.from_numpy(np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    draw_line(picture, disc.from_unit(outline).numpy(), CONTOUR, pen)
    arms = np.array([[[-4, 0], [4, 0]], [[0, -4], [0, 4]]], dtype=float) * pen
    for arm in arms:
        draw_line(picture, np.array(disc.centre) + arm, AXIS, pen)
    return picture


def write_disc_overlay(path: Path, image: LinearImage, disc: Disc) -> None:
    """Write `draw_disc` as a PNG, whole or not at all.

    Raises:
        EnvironmentFault: when the place cannot be written.
    """
    write_picture(path, draw_disc(image, disc))


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture as a PNG, whole or not at all."""
    _, encoded = cv2.imencode(".png", picture[..., ::-1])
    with write_whole(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


def visible(image: LinearImage) -> Picture:
    """Turn light into sRGB with the 99.5th percentile bright, never darker than it was."""
    light = image.rgb[0].permute(1, 2, 0).cpu().numpy()
    gain = max(1.0, BRIGHTEST / max(float(np.percentile(light[::4, ::4], 99.5)), 1e-3))
    light = np.clip(light * gain, 0, 1)
    curved = np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-6) ** (1 / 2.4) - 0.055
    )
    return np.ascontiguousarray(np.rint(255 * curved).astype(np.uint8))


def _draw_profiles(
    picture: Picture, profiles: ProfileTable, contours: ContourPoints, pen: int
) -> None:
    """Draw profiles from edge to edge, across the axis; so few that the shot stays in sight."""
    centre = np.array(profiles.centre_px, dtype=float).reshape(-1, 2)
    reach = np.array(profiles.half_width_px, dtype=float)[:, None] * _normals(centre, contours)
    ends = np.stack([centre - reach, centre + reach], axis=1)
    width = float(np.nanmedian(profiles.half_width_px)) if np.isfinite(reach).any() else 0.0
    step = _stride(centre, max(PROFILE_SPACING * pen, width / 2))
    for flag, line in zip(profiles.flags[::step], ends[::step], strict=True):
        draw_line(picture, line, GOOD_PROFILE if flag == 0 else LEFT_OUT_PROFILE, pen)


def _stride(centre: NDArray[Any], spacing: float) -> int:
    """Say which n-th of the profiles [P, 2] px to draw for about `spacing` px between them."""
    steps = np.linalg.norm(np.diff(centre, axis=0), axis=-1)
    usual = float(np.median(steps[np.isfinite(steps)])) if np.isfinite(steps).any() else spacing
    return max(1, round(spacing / max(usual, 1e-3)))


def _normals(points: NDArray[Any], contours: ContourPoints) -> NDArray[Any]:
    """Give the unit vector across the axis where it passes nearest to each point, [P, 2]."""
    axis = _middle(contours)
    along = np.gradient(axis, axis=0)
    nearest = np.linalg.norm(points[:, None] - axis, axis=-1).argmin(1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)[nearest]
    unit: NDArray[Any] = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    return unit


def _middle(contours: ContourPoints) -> NDArray[Any]:
    middle: NDArray[Any] = np.mean(np.array([contours.left, contours.right], dtype=float), axis=0)
    return middle


def _draw_axis(picture: Picture, contours: ContourPoints, pen: int, *, arrow: bool) -> None:
    """Draw the axis, with an arrow head where the sign of the motion is settled."""
    axis = _middle(contours)
    draw_line(picture, axis, AXIS, pen)
    if arrow:
        step = axis[-1] - axis[-2]
        back = axis[-1] - step / max(float(np.linalg.norm(step)), 1e-9) * 14 * pen
        side = np.array([-step[1], step[0]]) / max(float(np.linalg.norm(step)), 1e-9) * 7 * pen
        draw_line(picture, np.array([back - side, axis[-1], back + side]), AXIS, pen)


def draw_line(
    picture: Picture, points: NDArray[Any] | Sequence[Any], colour: Colour, pen: int
) -> None:
    """Draw a line through points [N, 2] px, unless they are not finite or too far away."""
    points = np.asarray(points, dtype=float)
    # far outside the picture OpenCV's fixed-point coordinates would wrap round
    if len(points) < 2 or not np.isfinite(points).all() or np.abs(points).max() > 1e6:
        return
    fixed = np.rint(points * (1 << SUBPIXEL_BITS)).astype(np.int32)
    cv2.polylines(picture, [fixed], False, colour, pen, cv2.LINE_AA, SUBPIXEL_BITS)
