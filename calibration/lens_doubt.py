"""How well a lens is known: its covariance, poses and bend unknown, systematic errors included."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.choose_lens import Choice, Tried
from calibration.held_out import Reduced, folds_of, reduce_poses
from calibration.lens_fit import Corners
from calibration.lens_models import K1_K2, PINHOLE_4, PINHOLE_5, RATIONAL, LensModel
from toolkit.errors import CalibrationError

Array = NDArray[np.float64]

RICHER: dict[LensModel, LensModel] = {K1_K2: PINHOLE_4, PINHOLE_4: PINHOLE_5, PINHOLE_5: RATIONAL}
"""The lens that has each lens's terms and more."""
OPEN = 1e-14
"""Share of the strongest direction's strength below which a number counts as not determined."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Doubt:
    """The covariance of a lens, and what it is made of."""

    covariance: Array  # [4 + K, 4 + K] of [fx fy cx cy, distortion...]
    corner_px: float  # standard deviation of a corner's coordinate
    common: float  # variance of left-out views over that of independent corners, 1 at least
    model_px: float  # change of the mean focal length by the next richer model, px


def lens_doubt(corners: Corners, choice: Choice) -> Doubt:
    """Give the covariance of the lens that was chosen.

    Corner errors as they scatter give its scale. Where left-out views miss by more than that
    allows, in directions the lens could mend, errors are common to a view's corners and the
    covariance is widened by as much. Terms that the data did not ask for may be there all the same:
    what the next richer lens, and a bent board where a flat one was taken, would change beyond what
    its own noise explains counts as one standard deviation each. Source: derived.

    Raises:
        CalibrationError: when a number is not determined at all.
    """
    taken = choice.taken
    reduced = reduce_poses(corners, taken.fit)
    information = reduced.information.sum(axis=0)
    unit = _inverse(information)
    freedom = 2 * float((corners.weight > 0).sum()) - taken.fit.shared - 6 * corners.views
    variance = float((reduced.residual**2).sum()) / max(freedom, 1.0)
    common = _common_share(reduced, corners.views, variance)
    columns = list(taken.fit.model.columns)
    covariance = common * variance * unit
    focal = 0.0
    for other in _richer(choice):
        change = _compensated(information, other.fit.lens[:4] - taken.fit.lens[:4])
        told = reduce_poses(corners, other.fit).information.sum(axis=0)
        richer = common * variance * _inverse(told, floor=OPEN)
        change = change * _beyond_chance(change[:4], richer[:4, :4] - covariance[:4, :4])
        covariance = covariance + np.outer(change, change)
        focal = float(np.hypot(focal, change[:2].mean()))
    whole = np.zeros((len(taken.fit.lens),) * 2)
    whole[np.ix_(columns, columns)] = covariance[: len(columns), : len(columns)]
    return Doubt(
        covariance=whole,
        corner_px=variance**0.5,
        common=common,
        model_px=focal,
    )


def _richer(choice: Choice) -> list[Tried]:
    model, is_bent = choice.taken.fit.model, choice.taken.fit.is_bent
    others = []
    if not is_bent:
        others.append(choice.other(model, is_bent=True))
    if model in RICHER and RICHER[model] != RATIONAL:
        others.append(choice.other(RICHER[model], is_bent=is_bent))
    return [one for one in others if one is not None]


def _compensated(information: Array, change: Array) -> Array:
    """Let all other numbers follow a change of [fx fy cx cy] as the corners ask, [S].

    The richer lens's own change of the shared terms would not do: its further terms undo it.
    """
    follow = np.linalg.lstsq(information[4:, 4:], -information[4:, :4] @ change, rcond=None)[0]
    return np.concatenate([change, follow])


def _beyond_chance(change: Array, chance: Array) -> float:
    """Share of a change that its own noise, of covariance `chance`, does not explain."""
    values, vectors = np.linalg.eigh(chance)
    seen = vectors.T @ change
    floor = 1e-6 * max(float(values[-1]), 1e-12)
    strength = float((seen**2 / np.maximum(values, floor)).sum())
    return float(max(0.0, 1 - len(change) / max(strength, 1e-300)) ** 0.5)


def _inverse(information: Array, floor: float = 0.0) -> Array:
    """Invert, strengths below `floor` of the largest raised to it."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale)
    values = np.maximum(values, floor * values[-1])
    if not values[0] >= OPEN * values[-1]:
        raise CalibrationError(
            "the views leave a lens parameter open; tilt the board more, in several directions"
        )
    return np.asarray(scale[:, None] * (vectors / values) @ vectors.T * scale)


def _common_share(reduced: Reduced, views: int, variance: float) -> float:
    """Squares left-out views miss by where the lens could mend it, over those expected."""
    rounds, count = folds_of(views), reduced.J.shape[-1]
    seen = expected = 0.0
    for fold in range(int(rounds.max()) + 1):
        out = rounds == fold
        spread = _inverse(reduced.information[~out].sum(axis=0), floor=OPEN)
        shift = -spread @ reduced.slope[~out].sum(axis=0)
        for J, residual in zip(reduced.J[out], reduced.residual[out], strict=True):
            basis, _ = np.linalg.qr(J)
            seen += float(((basis.T @ (residual + J @ shift)) ** 2).sum())
            expected += variance * (count + float(np.trace(J @ spread @ J.T)))
    return max(1.0, seen / expected)
