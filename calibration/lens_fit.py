"""The least-squares fit of one lens, and the board's bend, to the corners of many views.

Gauss-Newton steps on all views at once; the poses are removed from each step (Schur complement),
so that a step costs a millisecond and many lenses can be tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.board import Board
from calibration.lens_models import LensModel

Array = NDArray[np.float64]

STEPS = 40
"""Steps at most; 5 to 10 do from a neighbouring lens."""
SETTLED = 1e-6
"""Relative fall of the squares below which a fit has settled: of 1,000 corners, a thirtieth of a
standard deviation."""
BENDS = 3
"""Numbers of a bent board: z = a u^2 + b u v + c v^2, u v from its middle in half long sides."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corners:
    """The corners of V views, filled up to N; what is filled up, or set aside, weighs 0."""

    points: Array  # [V, N, 3] squares, z = 0
    middle: Array  # [2] of the board, squares
    half_side: float  # half its long side, squares
    seen: Array  # [V, N, 2] px
    weight: Array  # [V, N], 0 or 1
    picture_size: tuple[int, int]

    @property
    def views(self) -> int:
        """How many views there are."""
        return len(self.seen)

    @property
    def bends(self) -> Array:
        """Height that each number of the bend gives to a point, [V, N, BENDS]."""
        u, v = self.board_axes(self.points)
        return np.stack([u * u, u * v, v * v], axis=-1)

    def board_axes(self, points: Array) -> tuple[Array, Array]:
        """Give places on the board from its middle, in half long sides, u and v [...]."""
        u, v = np.moveaxis((points[..., :2] - self.middle) / self.half_side, -1, 0)
        return u, v

    def only(self, kept: NDArray[np.bool_]) -> "Corners":
        """Give some of the views [V]."""
        return replace(
            self,
            points=self.points[kept],
            seen=self.seen[kept],
            weight=self.weight[kept],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensFit:
    """A lens, the board's bend and its pose in each view; V views."""

    model: LensModel
    lens: Array  # [4 + K]: fx fy cx cy, distortion
    is_bent: bool  # whether the bend was fitted
    bend: Array  # [BENDS] squares
    rotation: Array  # [V, 3, 3], board to camera
    translation: Array  # [V, 3] squares

    @property
    def shared(self) -> int:
        """How many numbers all views share."""
        return len(self.model.columns) + (BENDS if self.is_bent else 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """Residuals and their derivatives at a fit; C = 2 N coordinates, weighted."""

    residual: Array  # [V, C] px
    J_shared: Array  # [V, C, S]
    J_pose: Array  # [V, C, 6]: turn in the camera frame, shift


def board_points(board: tuple[int, int]) -> Array:
    """Give the corners of a flat board of unit squares, z = 0 [R * C, 3], row by row."""
    return Board(columns=board[0], rows=board[1]).points()


def gather(
    points: Sequence[Array], seen: Sequence[Array], picture_size: tuple[int, int]
) -> Corners:
    """Put views of different numbers of corners into one table.

    Args:
        points: places on the board of each view's corners [n, 3], squares.
        seen: their pixels [n, 2].
        picture_size: width, height px.
    """
    most = max(map(len, seen))
    table, pixels = np.zeros((len(seen), most, 3)), np.zeros((len(seen), most, 2))
    weight = np.zeros((len(seen), most))
    for view, (places, corners) in enumerate(zip(points, seen, strict=True)):
        count = len(corners)
        table[view, :count], pixels[view, :count], weight[view, :count] = places, corners, 1
        table[view, count:], pixels[view, count:] = places[0], corners[0]
    every = np.concatenate(list(points))[:, :2]
    low, high = every.min(axis=0), every.max(axis=0)
    return Corners(
        points=table,
        middle=(low + high) / 2,
        half_side=0.5 * float((high - low).max()),
        seen=pixels,
        weight=weight,
        picture_size=picture_size,
    )


def residuals(corners: Corners, fit: LensFit) -> Array:
    """Give predicted less seen corners [V, N, 2] px; far off for points behind the camera."""
    numbers = _numbers(fit)
    _, placed = _placed(corners, fit)
    x, y, _ = _normalised(placed)
    shown = fit.model.shown(x, y, numbers[4:])
    pixels = np.stack([numbers[i] * shown[i] + numbers[2 + i] for i in (0, 1)], axis=-1)
    return np.asarray(np.nan_to_num(pixels, nan=1e6, posinf=1e6, neginf=-1e6) - corners.seen)


def _numbers(fit: LensFit) -> Array:
    """The lens [4 + K], or [4 + K, V, 1] where each view has its own."""
    return fit.lens if fit.lens.ndim == 1 else fit.lens.T[..., None]


def _placed(corners: Corners, fit: LensFit) -> tuple[Array, Array]:
    """Points turned into the camera's axes, and moved into its frame, [V, N, 3]."""
    points = corners.points
    if fit.bend.any():
        height = np.einsum(
            "vnb,...b->vn" if fit.bend.ndim == 1 else "vnb,vb->vn", corners.bends, fit.bend
        )
        points = np.concatenate([points[..., :2], height[..., None]], axis=-1)
    turned = points @ fit.rotation.swapaxes(-1, -2)
    return turned, turned + fit.translation[:, None]


def _normalised(placed: Array) -> tuple[Array, Array, Array]:
    """x/z, y/z and z [V, N]; what lies behind the camera is sent far off."""
    depth = np.where(placed[..., 2] > 1e-6, placed[..., 2], 1e-6)
    return placed[..., 0] / depth, placed[..., 1] / depth, depth


def linearise(corners: Corners, fit: LensFit, *, with_shared: bool = True) -> Linear:
    """Give residuals and derivatives in [fitted lens, bend] and in the poses."""
    fx, fy, cx, cy, *_ = numbers = _numbers(fit)
    turned, placed = _placed(corners, fit)
    x, y, depth = _normalised(placed)
    shown_x, shown_y = fit.model.shown(x, y, numbers[4:])
    a, b, d = fit.model.J_shown(x, y, numbers[4:])
    zero = np.zeros_like(x)
    # rows: derivative of the pixel's x, y in the point's place
    J = np.empty((*x.shape, 2, 3))
    for row, (f, in_x, in_y) in enumerate(((fx, a, b), (fy, b, d))):
        J[..., row, 0], J[..., row, 1] = f * in_x / depth, f * in_y / depth
        J[..., row, 2] = -(J[..., row, 0] * x + J[..., row, 1] * y)
    pose = np.empty((*x.shape, 2, 6))
    X, Y, Z = (turned[..., None, i] for i in range(3))
    pose[..., 0] = Y * J[..., 2] - Z * J[..., 1]
    pose[..., 1] = Z * J[..., 0] - X * J[..., 2]
    pose[..., 2] = X * J[..., 1] - Y * J[..., 0]
    pose[..., 3:] = J
    weight = corners.weight[..., None]
    seen = np.stack([fx * shown_x + cx, fy * shown_y + cy], axis=-1)
    residual = (seen - corners.seen) * weight
    views, count = x.shape
    shared = np.zeros((views, count, 2, 0))
    if with_shared:
        changes = fit.model.J_fitted(x, y, numbers[4:])
        columns = [(shown_x, zero), (zero, shown_y), (zero + 1, zero), (zero, zero + 1)]
        columns += [(fx * change_x, fy * change_y) for change_x, change_y in changes]
        shared = np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)
    if with_shared and fit.is_bent:
        outward = np.einsum("vnij,vj->vni", J, fit.rotation[..., 2])
        bends = outward[..., None] * corners.bends[..., None, :]
        shared = np.concatenate([shared, bends], axis=-1)
    return Linear(
        residual=residual.reshape(views, -1),
        J_shared=(shared * weight[..., None]).reshape(views, 2 * count, -1),
        J_pose=(pose * weight[..., None]).reshape(views, 2 * count, 6),
    )


def fit_lens(
    corners: Corners, start: LensFit, steps: int = STEPS, settled: float = SETTLED
) -> LensFit:
    """Fit lens, bend where `start` asks for it, and poses, from a start.

    Args:
        corners: the views.
        start: where to begin.
        steps: at most.
        settled: relative fall of the squares at which to stop.

    Raises:
        CalibrationError: when the views do not determine a lens.
    """
    fit, damping = start, 1e-4
    squares = _squares(corners, fit)
    for _ in range(steps):
        linear = linearise(corners, fit)
        for _ in range(12):
            moved = _step(linear, fit, damping)
            now = _squares(corners, moved) if moved is not None else np.inf
            if moved is not None and now <= squares:
                break
            damping *= 8
        else:
            return fit
        is_settled = squares - now <= settled * squares
        fit, squares, damping = moved, now, max(damping / 20, 1e-14)
        if is_settled:
            break
    return fit


def fit_poses(corners: Corners, fit: LensFit, steps: int = 2) -> LensFit:
    """Fit the poses alone, by plain steps from poses that are close."""
    for _ in range(steps):
        linear = linearise(corners, fit, with_shared=False)
        J = linear.J_pose
        H = J.swapaxes(-1, -2) @ J
        H = H + 1e-12 * np.trace(H, axis1=-2, axis2=-1)[:, None, None] * np.eye(6)
        g = np.einsum("vcp,vc->vp", J, linear.residual)
        fit = _moved(fit, np.zeros(fit.shared), -np.linalg.solve(H, g[..., None])[..., 0])
    return fit


def _squares(corners: Corners, fit: LensFit) -> float:
    error = residuals(corners, fit) * corners.weight[..., None]
    return float((error**2).sum())


def _step(linear: Linear, fit: LensFit, damping: float) -> LensFit | None:
    """One damped Gauss-Newton step; None where it cannot be solved."""
    J, P, r = linear.J_shared, linear.J_pose, linear.residual
    H_pp = P.swapaxes(-1, -2) @ P
    H_sp = J.swapaxes(-1, -2) @ P
    H_ss = (J.swapaxes(-1, -2) @ J).sum(axis=0)
    g_p = np.einsum("vcp,vc->vp", P, r)
    g_s = np.einsum("vcs,vc->s", J, r)
    H_pp = H_pp + damping * _diagonal(H_pp)
    H_ss = H_ss + damping * _diagonal(H_ss)
    try:
        solved = np.linalg.solve(
            H_pp, np.concatenate([H_sp.swapaxes(-1, -2), g_p[..., None]], axis=-1)
        )
        reduced = H_ss - (H_sp @ solved[..., :-1]).sum(axis=0)
        right = g_s - (H_sp @ solved[..., -1:]).sum(axis=0)[:, 0]
        scale = 1 / np.sqrt(np.maximum(np.diagonal(H_ss), 1e-300))
        shared = -scale * np.linalg.solve(scale[:, None] * reduced * scale, scale * right)
    except np.linalg.LinAlgError:
        return None
    pose = -solved[..., -1] - solved[..., :-1] @ shared
    if not (np.isfinite(shared).all() and np.isfinite(pose).all()):
        return None
    moved = _moved(fit, shared, pose)
    return moved if (moved.lens[:2] > 0).all() else None


def _diagonal(H: Array) -> Array:
    """The diagonal of [..., S, S] as matrices, kept off zero."""
    diagonal = np.diagonal(H, axis1=-2, axis2=-1)
    floor = 1e-12 * diagonal.max(axis=-1, keepdims=True) + 1e-300
    return np.asarray(np.maximum(diagonal, floor)[..., None] * np.eye(H.shape[-1]))


def _moved(fit: LensFit, shared: Array, pose: Array) -> LensFit:
    columns = len(fit.model.columns)
    lens = fit.lens.copy()
    lens[..., list(fit.model.columns)] += shared[:columns]
    return replace(
        fit,
        lens=lens,
        bend=fit.bend + shared[columns:] if fit.is_bent else fit.bend,
        rotation=_turns(pose[:, :3]) @ fit.rotation,
        translation=fit.translation + pose[:, 3:],
    )


def _turns(vectors: Array) -> Array:
    """Rotation matrices [V, 3, 3] about vectors [V, 3] by their length, rad."""
    angle = np.linalg.norm(vectors, axis=-1)[:, None, None]
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    # sin(a)/a and (1 - cos a)/a^2, sinc being sin(pi t)/(pi t)
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / 2 / np.pi) ** 2
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def view_rms(corners: Corners, error: Array) -> Array:
    """Give each view's root mean square distance, px [V], of its weighted corners [V, N, 2]."""
    squares = (error**2).sum(axis=-1) * corners.weight
    return np.asarray(np.sqrt(squares.sum(axis=-1) / np.maximum(corners.weight.sum(axis=-1), 1)))


def total_rms(corners: Corners, error: Array) -> float:
    """Give the root mean square distance of all weighted corners, px."""
    squares = (error**2).sum(axis=-1) * corners.weight
    return float(np.sqrt(squares.sum() / corners.weight.sum()))
