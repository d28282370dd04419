"""How well a lens predicts views it was not fitted to; their poses alone are fitted to them.

Leaving views out of a least-squares fit moves its numbers by what one Gauss-Newton step without
them says, so that no fit is repeated; the views left out are then predicted exactly.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.lens_fit import Corners, LensFit, fit_poses, linearise, residuals

Array = NDArray[np.float64]

MOST_FOLDS = 10
"""Rounds; each leaves out every so-manieth view."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reduced:
    """What each view says about lens and bend once its pose is removed; S shared numbers."""

    J: Array  # [V, C, S], orthogonal to what the poses can do
    residual: Array  # [V, C] px, the same
    information: Array  # [V, S, S] J'J
    slope: Array  # [V, S] J'residual


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """Each view as the others predict it."""

    error: Array  # [V, N, 2] px, predicted less seen
    squares: Array  # [V] mean squared distance of its corners, px^2
    rms_px: float


def reduce_poses(corners: Corners, fit: LensFit) -> Reduced:
    """Remove from residuals and derivatives what a change of each view's pose can imitate."""
    linear = linearise(corners, fit)
    basis, _ = np.linalg.qr(linear.J_pose)
    turned = basis.swapaxes(-1, -2)
    J = linear.J_shared - basis @ (turned @ linear.J_shared)
    residual = linear.residual - (basis @ (turned @ linear.residual[..., None]))[..., 0]
    return Reduced(
        J=J,
        residual=residual,
        information=J.swapaxes(-1, -2) @ J,
        slope=np.einsum("vcs,vc->vs", J, residual),
    )


def folds_of(views: int) -> NDArray[np.int64]:
    """Give the round in which each view is left out, [V]."""
    return np.arange(views, dtype=np.int64) % min(views, MOST_FOLDS)


def held_out(corners: Corners, fit: LensFit, folds: NDArray[np.int64] | None = None) -> HeldOut:
    """Predict every view from a fit to the views of the other rounds.

    Args:
        corners: the views.
        fit: a settled fit to all of them.
        folds: the round in which each view is left out [V]; `folds_of` when None.
    """
    reduced = reduce_poses(corners, fit)
    rounds = folds_of(corners.views) if folds is None else folds
    moved = _without(reduced, rounds)[rounds]
    columns = len(fit.model.columns)
    lens = np.tile(fit.lens, (corners.views, 1))
    lens[:, list(fit.model.columns)] += moved[:, :columns]
    bend = np.tile(fit.bend, (corners.views, 1))
    if fit.is_bent:
        bend += moved[:, columns:]
    error = residuals(corners, fit_poses(corners, replace(fit, lens=lens, bend=bend)))
    squares = ((error * corners.weight[..., None]) ** 2).sum(axis=(1, 2))
    count = np.maximum(corners.weight.sum(axis=1), 1)
    return HeldOut(
        error=error,
        squares=squares / count,
        rms_px=float(np.sqrt(squares.sum() / count.sum())),
    )


def _without(reduced: Reduced, rounds: NDArray[np.int64]) -> Array:
    """By how much lens and bend move when the views of each round are left out, [F, S]."""
    is_kept = (rounds != np.arange(rounds.max() + 1)[:, None]).astype(np.float64)
    information = np.einsum("fv,vst->fst", is_kept, reduced.information)
    slope = is_kept @ reduced.slope
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-300))
    scaled = scale[:, :, None] * information * scale[:, None]
    scaled += 1e-12 * np.eye(scaled.shape[-1])
    return np.asarray(-scale * np.linalg.solve(scaled, (scale * slope)[..., None])[..., 0])
