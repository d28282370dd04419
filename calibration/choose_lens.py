"""Choose the lens model, and whether the board is bent, by views left out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from calibration.held_out import HeldOut, held_out
from calibration.lens_fit import Corners, LensFit, fit_lens, residuals, total_rms
from calibration.lens_models import FISHEYE, K1_K2, LensModel, models_of
from calibration.lens_start import first_fit
from calibration.projection_doubt import sample_pixels
from toolkit.camera import Camera
from toolkit.errors import CalibrationError

Array = NDArray[np.float64]

LEAST_GAIN = 0.04
"""Mean fall of the log squared held-out error for which more terms are taken."""
OTHER_KIND_GAIN = 0.1
"""The same for another kind of lens: few views of a narrow lens cannot tell the kinds apart."""
WIDEST_GAIN = 1.5
"""A single view's gain counts at most this much, so that one odd view decides nothing."""


EXACT = 1e-12
"""Promised relative fall of the squares at which the lens that was taken has settled."""
WARM_STEPS = 8
"""Steps from a neighbouring lens; terms that trade with each other would take many more."""
HOPELESS = 1.6
"""A lens is not tried with a bent board when its RMS exceeds the best one's by this factor."""
INVERTIBLE = 0.98
"""Share of the picture whose rays a lens should tell, where another one predicts as well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tried:
    """One lens that was tried, with a flat or a bent board."""

    fit: LensFit
    held_out: HeldOut
    rms_px: float

    @property
    def name(self) -> str:
        """Model and board in words."""
        return f"{self.fit.model.name}, {'bent' if self.fit.is_bent else 'flat'} board"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """The lens taken, and all that were tried."""

    taken: Tried
    tried: tuple[Tried, ...]

    def other(self, model: LensModel, *, is_bent: bool) -> Tried | None:
        """Give what was tried with another model or board, or None."""
        for one in self.tried:
            if one.fit.model == model and one.fit.is_bent == is_bent:
                return one
        return None


def choose_lens(corners: Corners, family: str = "auto") -> Choice:
    """Fit every model of a family to a flat and a bent board and take the fewest terms needed.

    Args:
        corners: the views.
        family: one of `lens_models.FAMILIES`.

    Raises:
        CalibrationError: when the views do not determine a lens.
    """
    return _choose([*_try_flat(corners, family)], corners)


def choose_again(corners: Corners, before: Choice, still: NDArray[np.bool_]) -> Choice:
    """Choose again, from lenses and poses that were found with other weights or more views.

    Args:
        corners: the views now.
        before: what was tried.
        still: which of the views of `before` they are [V].
    """
    flat = [one.fit for one in before.tried if not one.fit.is_bent]
    starts = [
        replace(f, rotation=f.rotation[still], translation=f.translation[still]) for f in flat
    ]
    return _choose([fit_lens(corners, start) for start in starts], corners)


def polished(corners: Corners, choice: Choice) -> Choice:
    """Settle the lens that was taken to the last digits."""
    fit = fit_lens(corners, choice.taken.fit, settled=EXACT)
    rms = total_rms(corners, residuals(corners, fit))
    better = replace(choice.taken, fit=fit, rms_px=rms)
    tried = tuple(better if one is choice.taken else one for one in choice.tried)
    return Choice(taken=better, tried=tried)


def _choose(flat: Sequence[LensFit], corners: Corners) -> Choice:
    tried = [_tried(corners, fit) for fit in flat]
    limit = HOPELESS * min(one.rms_px for one in tried)
    promising = [one.fit for one in tried if one.rms_px <= limit]
    bent = [fit_lens(corners, replace(fit, is_bent=True), WARM_STEPS) for fit in promising]
    tried += [_tried(corners, fit) for fit in bent]
    tried = [one for one in tried if np.isfinite(one.held_out.rms_px)]
    if len(tried) < 2:
        raise CalibrationError(
            "the views do not determine a lens; tilt the board more, in several directions"
        )
    taken = _take(tried)
    if not _is_invertible(taken.fit, corners):
        sound = [one for one in tried if _is_invertible(one.fit, corners)]
        instead = _take(sound) if sound else taken
        taken = taken if is_better(taken.held_out, instead.held_out) else instead
    return Choice(taken=taken, tried=tuple(tried))


def _take(tried: Sequence[Tried]) -> Tried:
    """Take the fewest terms, the board's bend being the last of them.

    The lens is first chosen with a bent board: a flat one would be bought more lens terms.
    """
    bent = [one for one in tried if one.fit.is_bent]
    flat = [one for one in tried if not one.fit.is_bent]
    if not (bent and flat):
        return fewest_terms(tried)
    best = fewest_terms(bent)
    same = [one for one in flat if one.fit.model == best.fit.model]
    if same and not is_better(best.held_out, same[0].held_out):
        return fewest_terms(flat)
    return best


def _is_invertible(fit: LensFit, corners: Corners) -> bool:
    """Whether the lens has one ray for nearly every pixel; terms that fit noise fold early."""
    width, height = corners.picture_size
    fx, fy, cx, cy, *distortion = fit.lens.tolist()
    camera = Camera(
        width=width,
        height=height,
        model=fit.model.family,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=tuple(distortion),
    )
    rays = camera.undistort(sample_pixels(camera))
    return float(torch.isfinite(rays).all(dim=-1).double().mean()) >= INVERTIBLE


def _tried(corners: Corners, fit: LensFit) -> Tried:
    return Tried(
        fit=fit,
        held_out=held_out(corners, fit),
        rms_px=total_rms(corners, residuals(corners, fit)),
    )


def fewest_terms(tried: Sequence[Tried]) -> Tried:
    """Take the first, and each later one that predicts left-out views better than what is taken."""
    taken = tried[0]
    for one in tried[1:]:
        is_alike = one.fit.model.family == taken.fit.model.family
        if is_better(one.held_out, taken.held_out, LEAST_GAIN if is_alike else OTHER_KIND_GAIN):
            taken = one
    return taken


def is_better(richer: HeldOut, simpler: HeldOut, least: float = LEAST_GAIN) -> bool:
    """Whether richer terms lower the held-out errors by more than one standard error of that.

    View by view, in logarithms and bounded: neither a few large errors nor one view decide.
    """
    gain = np.log((simpler.squares + 1e-12) / (richer.squares + 1e-12))
    gain = np.clip(gain, -WIDEST_GAIN, WIDEST_GAIN)
    error = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return bool(gain.mean() > max(least, error))


def _try_flat(corners: Corners, family: str) -> list[LensFit]:
    """Fit each model to a flat board, each polynomial one from the one before."""
    fits: list[LensFit] = []
    before: LensFit | None = None
    for model in models_of(family):
        if model.family == "fisheye":
            focals = [float(before.lens[:2].mean())] if before else []
            fits.append(first_fit(corners, FISHEYE, focals))
            continue
        before = before or first_fit(corners, K1_K2)
        lens = np.zeros(4 + model.size)
        lens[: len(before.lens)] = before.lens
        before = fit_lens(corners, replace(before, model=model, lens=lens), WARM_STEPS)
        fits.append(before)
    return fits
