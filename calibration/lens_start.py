"""A first lens and the poses that go with it, from nothing but the corners."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.lens_fit import (
    BENDS,
    Corners,
    LensFit,
    fit_lens,
    residuals,
    view_rms,
)
from calibration.lens_models import LensModel
from toolkit.errors import CalibrationError

Array = NDArray[np.float64]

FOCAL_SHARES = (0.32, 0.5, 0.8, 1.3, 2.5)
"""Focal lengths over the picture's long side that are tried besides the one the views tell."""
TRIED = 2
"""Starts that are followed, those the corners fit best."""
TRIAL_STEPS = 8
GOOD_START = 0.001
"""RMS over the picture's diagonal at which no other focal length is tried."""
ODD_VIEW = 3.0
"""RMS over the median from which a view is held down while the first lens is fitted."""


def first_fit(corners: Corners, model: LensModel, focals: Sequence[float] = ()) -> LensFit:
    """Fit a lens and the poses of a flat board without any guess.

    Views that fit much worse than most are held down, so that a misread board does not spoil it.

    Args:
        corners: the views.
        model: the lens to fit.
        focals: focal lengths, px, that are likely.

    Raises:
        CalibrationError: when the views do not determine a lens.
    """
    guess = focal_guess(corners)
    likely = [*focals, *([guess] if guess else [])][:1]
    long_side = max(corners.picture_size)
    tried = _try(corners, model, likely)
    if not tried or _typical(corners, tried[0]) > GOOD_START * np.hypot(*corners.picture_size):
        tried += _try(corners, model, [share * long_side for share in FOCAL_SHARES])
    return _hold_down(
        corners, fit_lens(corners, min(tried, key=lambda fit: _typical(corners, fit)))
    )


def _try(corners: Corners, model: LensModel, focals: Sequence[float]) -> list[LensFit]:
    """Follow a few steps from those focal lengths that the corners fit best."""
    starts = [start_lens(corners, model, focal) for focal in focals]
    starts.sort(key=lambda fit: _typical(corners, fit))
    return [fit_lens(corners, start, TRIAL_STEPS) for start in starts[:TRIED]]


def _typical(corners: Corners, fit: LensFit) -> float:
    """Median over the views of their RMS, px."""
    return float(np.median(view_rms(corners, residuals(corners, fit))))


def _hold_down(corners: Corners, fit: LensFit) -> LensFit:
    for _ in range(4):
        rms = view_rms(corners, residuals(corners, fit))
        limit = ODD_VIEW * float(np.median(rms))
        if not (rms > limit).any():
            break
        share = np.minimum(1, limit / np.maximum(rms, 1e-12))[:, None]
        fit = fit_lens(corners.weighing(corners.weight * share**2), fit)
    return fit


def start_lens(corners: Corners, model: LensModel, focal: float) -> LensFit:
    """Give an undistorted lens of one focal length, px, and the poses it sees the board in.

    Raises:
        CalibrationError: when a view's corners lie on a line.
    """
    width, height = corners.picture_size
    lens = np.zeros(4 + model.size)
    lens[:4] = focal, focal, (width - 1) / 2, (height - 1) / 2
    rotation, translation = poses_of(corners, (corners.seen - lens[2:4]) / focal, model.family)
    return LensFit(
        model=model,
        lens=lens,
        is_bent=False,
        bend=np.zeros(BENDS),
        rotation=rotation,
        translation=translation,
    )


def poses_of(corners: Corners, seen: Array, family: str) -> tuple[Array, Array]:
    """Give the poses of flat boards from where corners are seen, in focal lengths [V, N, 2]."""
    if family == "fisheye":
        theta = np.minimum(np.linalg.norm(seen, axis=-1, keepdims=True), 1.4)
        seen = seen * np.where(theta > 1e-9, np.tan(theta) / np.maximum(theta, 1e-9), 1)
    H = homographies(corners, seen)
    scale = np.linalg.norm(H[:, :, :2], axis=1).mean(axis=-1)
    middle = (corners.points[..., :2] * corners.weight[..., None]).sum(1) / corners.weight.sum(1)[
        :, None
    ]
    depth = np.einsum("vi,vi->v", H[:, 2, :2], middle) + H[:, 2, 2]
    H = H / (scale * np.where(depth < 0, -1, 1))[:, None, None]
    third = np.cross(H[..., 0], H[..., 1])
    U, _, W = np.linalg.svd(np.stack([H[..., 0], H[..., 1], third], axis=-1))
    rotation = U @ W
    rotation = rotation * np.sign(np.linalg.det(rotation))[:, None, None]
    return rotation, H[..., 2]


def homographies(corners: Corners, seen: Array) -> Array:
    """Give the plane-to-picture maps of each view [V, 3, 3], by the direct linear transform.

    Raises:
        CalibrationError: when a view's corners lie on a line.
    """
    weight = corners.weight[..., None]
    before, T_board = _centred(corners.points[..., :2], weight)
    after, T_seen = _centred(seen, weight)
    ones = np.ones_like(before[..., :1])
    p = np.concatenate([before, ones], axis=-1)
    zero = np.zeros_like(p)
    rows_x = np.concatenate([p, zero, -after[..., :1] * p], axis=-1) * weight
    rows_y = np.concatenate([zero, p, -after[..., 1:] * p], axis=-1) * weight
    A = np.concatenate([rows_x, rows_y], axis=1)
    try:
        values, vectors = np.linalg.eigh(A.swapaxes(-1, -2) @ A)
        if not (values[:, 1] > 1e-9 * values[:, -1]).all():
            raise np.linalg.LinAlgError
        H = vectors[..., 0].reshape(-1, 3, 3)
        return np.asarray(np.linalg.inv(T_seen) @ H @ T_board)
    except np.linalg.LinAlgError:
        raise CalibrationError(
            "the corners of a view lie on a line: the board is seen edge on; leave that photo out"
        ) from None


def _centred(points: Array, weight: Array) -> tuple[Array, Array]:
    """Points moved to mean 0 and size 1, and the map that does so [V, 3, 3]."""
    total = weight.sum(axis=1)
    mean = (points * weight).sum(axis=1) / total
    size = np.sqrt((((points - mean[:, None]) ** 2) * weight).sum(axis=(1, 2)) / total[:, 0])
    size = np.maximum(size, 1e-12)
    T = np.zeros((len(points), 3, 3))
    T[:, 0, 0] = T[:, 1, 1] = 1 / size
    T[:, :2, 2], T[:, 2, 2] = -mean / size[:, None], 1
    return (points - mean[:, None]) / size[:, None, None], T


def focal_guess(corners: Corners) -> float | None:
    """Give the focal length that makes each board's sides square, px, or None.

    Source: Zhang 2000, section 3.1, with the principal point in the picture's middle.
    """
    width, height = corners.picture_size
    H = homographies(corners, corners.seen - np.array([(width - 1) / 2, (height - 1) / 2]))
    h1, h2 = H[..., 0], H[..., 1]
    # h1' w h2 = 0 and h1' w h1 = h2' w h2 with w = diag(1/f^2, 1/f^2, 1)
    flat = [(h1 * h2)[:, :2].sum(-1), (h1**2 - h2**2)[:, :2].sum(-1)]
    deep = [(h1 * h2)[:, 2], (h1**2 - h2**2)[:, 2]]
    norm = np.linalg.norm(H[..., :2], axis=(1, 2)) ** 2
    A, B = np.concatenate(flat) / np.tile(norm, 2), np.concatenate(deep) / np.tile(norm, 2)
    inverse = -float(A @ B) / float(A @ A)
    return 1 / np.sqrt(inverse) if inverse > 0 else None
