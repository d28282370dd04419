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
SETTLED = 1e-5
"""Promised relative fall of the squares below which the next step is the last."""
DAMPING = 1e-5
"""Marquardt's factor on the diagonal at the start."""
BENDS = 3
"""Numbers of a bent board: z = a u^2 + b u v + c v^2, u v from its middle in half long sides."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corners:
    """The corners of V views, filled up to N; what is filled up, or set aside, weighs 0."""

    points: Array  # [V, N, 3] squares, z = 0
    middle: Array  # [2] of the board, squares
    half_side: float  # half its long side, squares
    bends: Array  # [V, N, BENDS] height that each number of the bend gives to a point
    is_whole: bool  # whether all weigh 1
    seen: Array  # [V, N, 2] px
    weight: Array  # [V, N], 0 or 1
    picture_size: tuple[int, int]

    @property
    def views(self) -> int:
        """How many views there are."""
        return len(self.seen)

    def board_axes(self, points: Array) -> tuple[Array, Array]:
        """Give places on the board from its middle, in half long sides, u and v [...]."""
        u, v = np.moveaxis((points[..., :2] - self.middle) / self.half_side, -1, 0)
        return u, v

    def only(self, kept: NDArray[np.bool_]) -> "Corners":
        """Give some of the views [V]."""
        return replace(
            self,
            points=self.points[kept],
            bends=self.bends[kept],
            seen=self.seen[kept],
            weight=self.weight[kept],
        )

    def weighing(self, weight: Array) -> "Corners":
        """Give the same corners with other weights [V, N]."""
        return replace(self, weight=weight, is_whole=bool((weight == 1).all()))


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
    """Residuals and their derivatives at a fit, weighted, side by side; C = 2 N coordinates."""

    table: Array  # [V, C, S + 6 + 1]: in lens and bend, in the pose, and the residuals
    shared: int  # S

    @property
    def J_shared(self) -> Array:
        """Derivatives in [fitted lens, bend], [V, C, S]."""
        return self.table[..., : self.shared]

    @property
    def J_pose(self) -> Array:
        """Derivatives in the turn in the camera frame and the shift, [V, C, 6]."""
        return self.table[..., self.shared : -1]

    @property
    def residual(self) -> Array:
        """Predicted less seen, px [V, C]."""
        return self.table[..., -1]

    @property
    def squares(self) -> float:
        """Sum of the squared residuals, px^2; infinite where a point is seen nowhere."""
        total = float((self.residual**2).sum())
        return total if np.isfinite(total) else np.inf


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
    middle, half_side = (low + high) / 2, 0.5 * float((high - low).max())
    u, v = np.moveaxis((table[..., :2] - middle) / half_side, -1, 0)
    return Corners(
        points=table,
        middle=middle,
        half_side=half_side,
        bends=np.stack([u * u, u * v, v * v], axis=-1),
        is_whole=bool(weight.all()),
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
    if fit.is_bent:
        points = points.copy()
        points[..., 2] = (corners.bends @ fit.bend[..., None])[..., 0]
    turned = points @ fit.rotation.swapaxes(-1, -2)
    return turned, turned + fit.translation[:, None]


def _normalised(placed: Array) -> tuple[Array, Array, Array]:
    """x/z, y/z and 1/z [V, N]; what lies behind the camera is sent far off."""
    inverse = 1 / np.maximum(placed[..., 2], 1e-6)
    return placed[..., 0] * inverse, placed[..., 1] * inverse, inverse


def linearise(corners: Corners, fit: LensFit, *, with_shared: bool = True) -> Linear:
    """Give residuals and derivatives in [fitted lens, bend] and in the poses."""
    fx, fy, cx, cy, *_ = numbers = _numbers(fit)
    turned, placed = _placed(corners, fit)
    x, y, inverse = _normalised(placed)
    shown = fit.model.shown(x, y, numbers[4:])
    a, b, d = fit.model.J_shown(x, y, numbers[4:])
    count = fit.shared if with_shared else 0
    table = np.zeros((*x.shape, 2, count + 7))
    # derivative of the pixel's x, y in the point's place is that in the shift
    place = table[..., count + 3 : count + 6]
    for row, (f, in_x, in_y) in enumerate(((fx, a, b), (fy, b, d))):
        scale = f * inverse
        place[..., row, 0], place[..., row, 1] = scale * in_x, scale * in_y
        place[..., row, 2] = -(place[..., row, 0] * x + place[..., row, 1] * y)
    X, Y, Z = (turned[..., None, i] for i in range(3))
    table[..., count] = Y * place[..., 2] - Z * place[..., 1]
    table[..., count + 1] = Z * place[..., 0] - X * place[..., 2]
    table[..., count + 2] = X * place[..., 1] - Y * place[..., 0]
    table[..., 0, -1] = fx * shown[0] + cx
    table[..., 1, -1] = fy * shown[1] + cy
    table[..., -1] -= corners.seen
    if with_shared:
        table[..., 0, 0], table[..., 1, 1] = shown
        table[..., 0, 2] = table[..., 1, 3] = 1
        for index, change in enumerate(fit.model.J_fitted(x, y, numbers[4:]), start=4):
            table[..., 0, index], table[..., 1, index] = fx * change[0], fy * change[1]
    if with_shared and fit.is_bent:
        outward = (place.reshape(len(x), -1, 3) @ fit.rotation[..., 2:]).reshape(*x.shape, 2, 1)
        table[..., count - BENDS : count] = outward * corners.bends[..., None, :]
    if not corners.is_whole:
        table *= corners.weight[..., None, None]
    return Linear(table=table.reshape(len(x), -1, count + 7), shared=count)


def fit_lens(
    corners: Corners, start: LensFit, steps: int = STEPS, settled: float = SETTLED
) -> LensFit:
    """Fit lens, bend where `start` asks for it, and poses, from a start.

    Args:
        corners: the views.
        start: where to begin.
        steps: at most.
        settled: promised relative fall of the squares below which the next step is the last.
    """
    fit, damping = start, DAMPING
    linear = linearise(corners, fit)
    squares = linear.squares
    for _ in range(steps):
        moved, promised = _step(linear, fit, damping)
        if moved is not None and promised <= settled * squares:
            return moved
        ahead = None if moved is None else linearise(corners, moved)
        if moved is None or ahead is None or not ahead.squares <= squares:
            damping *= 10
            continue
        fit, linear, squares, damping = moved, ahead, ahead.squares, max(damping / 30, 1e-14)
    return fit


def fit_poses(corners: Corners, fit: LensFit, steps: int = 2) -> LensFit:
    """Fit the poses alone, by plain steps from poses that are close."""
    none = np.zeros(fit.shared)
    for _ in range(steps):
        table = linearise(corners, fit, with_shared=False).table
        H = table.swapaxes(-1, -2) @ table
        inner, slope = H[:, :6, :6], H[:, :6, 6:]
        inner = inner + 1e-12 * np.trace(inner, axis1=-2, axis2=-1)[:, None, None] * np.eye(6)
        fit = _moved(fit, none, -np.linalg.solve(inner, slope)[..., 0])
    return fit


def _step(linear: Linear, fit: LensFit, damping: float) -> tuple[LensFit | None, float]:
    """One damped Gauss-Newton step and the fall of the squares it promises; None where singular."""
    S = linear.shared
    H = linear.table.swapaxes(-1, -2) @ linear.table
    total = H[:, :S].sum(axis=0)
    H_ss, g_s = total[:, :S], total[:, -1]
    H_pp, H_ps = H[:, S:-1, S:-1], H[:, S:-1, :S]
    g_p = H[:, S:-1, -1]
    H_pp = H_pp + damping * _diagonal(H_pp)
    H_ss = H_ss + damping * _diagonal(H_ss)
    scale = 1 / np.sqrt(np.maximum(np.diagonal(H_ss), 1e-300))
    try:
        solved = np.linalg.solve(H_pp, np.concatenate([H_ps, g_p[..., None]], axis=-1))
        taken = (H_ps.swapaxes(-1, -2) @ solved).sum(axis=0)
        reduced, right = H_ss - taken[:, :-1], g_s - taken[:, -1]
        shared = -scale * np.linalg.solve(scale[:, None] * reduced * scale, scale * right)
    except np.linalg.LinAlgError:
        return None, 0.0
    pose = -(solved[..., -1] + solved[..., :-1] @ shared)
    promised = -float(g_s @ shared + (g_p * pose).sum())
    if not np.isfinite(promised):
        return None, 0.0
    moved = _moved(fit, shared, pose)
    return (moved, promised) if (moved.lens[:2] > 0).all() else (None, 0.0)


def _diagonal(H: Array) -> Array:
    """The diagonal of [..., S, S] as matrices, kept off zero."""
    diagonal = np.diagonal(H, axis1=-2, axis2=-1)
    floor = 1e-12 * diagonal.max(axis=-1, keepdims=True) + 1e-300
    return np.asarray(np.maximum(diagonal, floor)[..., None] * np.eye(H.shape[-1]))


def _moved(fit: LensFit, shared: Array, pose: Array) -> LensFit:
    columns = len(fit.model.columns)
    lens = fit.lens.copy()
    lens[..., fit.model.columns] += shared[:columns]
    return replace(
        fit,
        lens=lens,
        bend=fit.bend + shared[columns:] if fit.is_bent else fit.bend,
        rotation=_turns(pose[:, :3]) @ fit.rotation,
        translation=fit.translation + pose[:, 3:],
    )


def _turns(vectors: Array) -> Array:
    """Rotation matrices [V, 3, 3] that to second order turn about vectors [V, 3] by their length.

    Cayley's map: always a rotation, and without trigonometry.
    """
    cross = np.zeros((len(vectors), 3, 3))
    for index, (row, column) in enumerate(((2, 1), (0, 2), (1, 0))):
        cross[:, row, column] = vectors[:, index]
        cross[:, column, row] = -vectors[:, index]
    share = 1 / (1 + (vectors**2).sum(axis=-1) / 4)[:, None, None]
    return np.asarray(np.eye(3) + share * (cross + 0.5 * cross @ cross))


def view_rms(corners: Corners, error: Array) -> Array:
    """Give each view's root mean square distance, px [V], of its weighted corners [V, N, 2]."""
    squares = (error**2).sum(axis=-1) * corners.weight
    return np.asarray(np.sqrt(squares.sum(axis=-1) / np.maximum(corners.weight.sum(axis=-1), 1)))


def total_rms(corners: Corners, error: Array) -> float:
    """Give the root mean square distance of all weighted corners, px."""
    squares = (error**2).sum(axis=-1) * corners.weight
    return float(np.sqrt(squares.sum() / corners.weight.sum()))
