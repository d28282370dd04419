"""Gather what a report shows from a calibration."""

from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from calibration.intrinsics import Calibration
from calibration.report.content import (
    Content,
    LeftOut,
    ModelRow,
    UsedRow,
    Verdict,
    name_of,
)
from calibration.report.page import render_page
from calibration.report.thumbnails import thumbnail
from calibration.trust import Gate
from calibration.view import View
from toolkit.camera import Camera
from toolkit.files import write_text
from toolkit.response import Response, SampledCurve

Array = NDArray[np.float64]

CURVE_SAMPLES = 129
SETTLING_STEPS = 3
MISREAD = 6.0
"""Times the median error from which a corner is not listened to."""


def write_report(
    path: Path,
    calibration: Calibration,
    *,
    square: float | None = None,
    response: Response | None = None,
) -> None:
    """Write a calibration report, whole or not at all.

    Args:
        path: of the HTML file.
        calibration: what it is about; photos left out are read again for their thumbnails.
        square: side of a square, metre, as the calibration was told.
        response: drawn too, where it has curves.

    Raises:
        EnvironmentFault: when the place cannot be written.
    """
    write_text(path, render_page(collect(calibration, square=square, response=response)))


def collect(
    calibration: Calibration, *, square: float | None = None, response: Response | None = None
) -> Content:
    """Gather the content of a report; see `write_report`."""
    camera, used = calibration.camera, calibration.used
    left_out = [view for view in calibration.views if not view.is_used]
    found = [view.corners for view in used if view.corners is not None]
    gates = {gate.code for gate in calibration.gates}
    places, errors = corner_errors(calibration, square=square)
    return Content(
        picture_size=(camera.width, camera.height),
        summary=_summary(calibration, square),
        verdicts=[Verdict(is_passed=g.is_passed, text=g.text) for g in _shown(calibration)],
        advice=[advice.text for advice in calibration.advice],
        cautions=[c.message for c in calibration.warnings if c.code not in gates],
        corners=found,
        counts=calibration.grid,
        places=places,
        errors=errors,
        uncertainty=calibration.projection_std(),
        models=_models(calibration),
        left_out=[_left_out(view) for view in left_out],
        used=[_used(view) for view in used],
        curves=[] if response is None else _curves(response),
    )


def corner_errors(calibration: Calibration, *, square: float | None = None) -> tuple[Array, Array]:
    """Give all corners used, and by how much each was found off its predicted place.

    Args:
        calibration: with the poses of its views.
        square: side of a square, metre, as the calibration was told.

    Returns:
        Places and errors, found less predicted, px [N, 2] each, view after view.
    """
    used = [view for view in calibration.used if view.corners is not None]
    places = [view.corners for view in used if view.corners is not None]
    errors = [_errors(calibration, view, square or 1.0) for view in used]
    return np.concatenate(places), np.concatenate(errors)


def _shown(calibration: Calibration) -> list[Gate]:
    """All gates but those that only refuse: where they fail there is no report."""
    return [gate for gate in calibration.gates if not (gate.is_refusal and gate.is_passed)]


def _summary(calibration: Calibration, square: float | None) -> list[tuple[str, str]]:
    camera, board = calibration.camera, calibration.board
    side = "" if square is None else f", squares of {1000 * square:g} mm"
    rows = [
        ("pictures", f"{camera.width} x {camera.height} px"),
        ("board", f"{board[0]} x {board[1]} inner corners{side}, {_shape(calibration)}"),
        ("photos", f"{len(calibration.used)} of {len(calibration.views)} used"),
        ("lens", camera.model),
        *_numbers(camera),
        ("error", _error(calibration)),
    ]
    if calibration.halves is not None:
        rows.append(
            (
                "two halves",
                f"lenses from every other view differ by {calibration.halves.rms_px:.2f} px RMS,"
                f" {calibration.halves.most_px:.2f} px at most",
            )
        )
    if calibration.bootstrap_ratio is not None:
        ratios = ", ".join(f"{ratio:.2f}" for ratio in calibration.bootstrap_ratio)
        rows.append(("bootstrap", f"{ratios} times the stated scatter of fx, fy, cx, cy"))
    return rows


def _error(calibration: Calibration) -> str:
    held_out = f"{calibration.held_out_px:.3f} px on views left out of the fit"
    return f"{calibration.rms_px:.3f} px RMS, {held_out}"


def _shape(calibration: Calibration) -> str:
    height = calibration.board_shape
    if height is None:
        return "flat"
    return f"bent by {float(height.max() - height.min()):.3f} of a square"


def _numbers(camera: Camera) -> list[tuple[str, str]]:
    """The lens's numbers with their standard deviations."""
    names = ["fx", "fy", "cx", "cy", *_coefficients(camera)]
    values = camera.parameters.tolist()
    std = [0.0] * len(values)
    if camera.covariance is not None:
        std = camera.covariance.diagonal().clamp_min(0).sqrt().tolist()
    rows = []
    for index, (name, value, doubt) in enumerate(zip(names, values, std, strict=True)):
        is_length = index < 4
        text = f"{value:.2f} +/- {doubt:.2f} px" if is_length else f"{value:.5f} +/- {doubt:.5f}"
        rows.append((name, text))
    return rows


def _coefficients(camera: Camera) -> list[str]:
    if camera.model == "fisheye":
        return ["k1", "k2", "k3", "k4"]
    return ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"][: len(camera.distortion)]


def _errors(calibration: Calibration, view: View, unit: float) -> Array:
    """Where a view's corners were found less where the camera predicts them, [N, 2] px."""
    assert view.corners is not None  # a used view has both, for the type checker
    assert view.T_cam_board is not None
    points, pose = view.points.copy(), view.T_cam_board
    if calibration.board_shape is not None:
        height = calibration.board_shape.reshape(-1)
        points[:, 2] = height if view.ids is None else height[view.ids]
    placed = points @ pose[:3, :3].T + pose[:3, 3] / unit
    # a bend is told less the plane through it, which the pose made up for: settle the pose again
    for _ in range(SETTLING_STEPS):
        placed = _settled(calibration.camera, placed, view.corners)
    return view.corners - _seen(calibration.camera, placed)


def _seen(camera: Camera, placed: Array) -> Array:
    return np.asarray(camera.project(torch.from_numpy(placed)).numpy(), dtype=np.float64)


def _settled(camera: Camera, placed: Array, corners: Array) -> Array:
    """Turn and shift points [N, 3] in front of the camera nearer to where they were seen."""
    J = camera.J_project(torch.from_numpy(placed)).numpy()
    J_pose = np.concatenate([np.cross(placed[:, None], J), J], axis=-1).reshape(-1, 6)
    left = corners - _seen(camera, placed)
    length = np.linalg.norm(left, axis=-1)
    is_read = (length <= MISREAD * np.median(length)).repeat(2)
    step = np.linalg.lstsq(J_pose[is_read], left.reshape(-1)[is_read], rcond=None)[0]
    turn = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64)
    return np.asarray(placed @ turn.T + step[3:])


def _models(calibration: Calibration) -> list[ModelRow]:
    return [
        ModelRow(
            name=score.model,
            board="bent" if score.is_bent else "flat",
            terms=score.terms,
            held_out_px=score.held_out_px,
            is_taken=score.is_taken,
        )
        for score in calibration.model_scores
    ]


def _left_out(view: View) -> LeftOut:
    name = name_of(view.path)
    reason = view.reason.removeprefix(str(view.path)).lstrip(": ")
    return LeftOut(name=name, reason=reason, thumbnail=thumbnail(view.path, view.corners))


def _used(view: View) -> UsedRow:
    rms = view.rms_px or 0.0
    return UsedRow(name=name_of(view.path), corners=view.corner_count, rms_px=rms)


def _curves(response: Response) -> list[tuple[str, Array, Array, Array]]:
    """Sample the curve of each channel; a linear response has none."""
    if response.curves is None:
        return []
    brightness = np.linspace(0, 1, CURVE_SAMPLES)
    rows = []
    for name, curve in zip("rgb", response.curves, strict=True):
        std = np.zeros_like(brightness)
        if isinstance(curve, SampledCurve):
            std = np.interp(brightness, curve.brightness, curve.std)
        rows.append((name, brightness, np.asarray(curve(brightness), dtype=np.float64), std))
    return rows
