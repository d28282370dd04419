"""Choosing among estimators by how well each predicts pixels that it was not shown.

One pixel in eight is kept from every fit. What the fit says of them in full colour, the ball's
light where it covers them and the background's where it does not, is held against what was seen
there. That measures any estimator alike, whatever signal it works on. [derived]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord, Observation
from toolkit.camera import Camera
from toolkit.common_residual import misfit_variance
from toolkit.contours import smooth_parameters
from toolkit.errors import BadOutputError, StreakError
from toolkit.guarded import guarded
from toolkit.measurement import Candidate
from toolkit.pipeline import PROFILE_REACH, fit_streak, settled
from toolkit.profiles import axis_bend, gather_profiles
from toolkit.semi_ellipse import semi_ellipse
from toolkit.streak import ROI
from toolkit.types import LinearImage, ProfileFit, Profiles
from toolkit.view import StreakView, observe_streak

HELD_OUT = 8
"""One pixel in so many, on a lattice that meets every place of a mosaic's pattern."""
LATTICE = (1, 3)
OUTLIER = 4.0
"""Standard deviations beyond which a pixel counts no more: dirt must not decide."""
SAME = 0.05
"""Relative difference of two scores that decides nothing; then the sharper fit is taken."""
COLOUR_TERMS = 5
"""Powers of the offset by which the ball's colour is learnt where an estimator knows none."""
EDGE = 1.15
"""Half widths from the axis up to which pixels are predicted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The estimator chosen, and how all did."""

    estimator: AlphaEstimator
    name: str
    candidates: tuple[Candidate, ...]  # by score, best first; those that failed last


def select_estimator(
    image: LinearImage,
    background: LinearImage,
    estimators: Sequence[tuple[str, AlphaEstimator]],
    camera: Camera,
    roi: ROI | None = None,
) -> Selection:
    """Choose the estimator that predicts held-out pixels of the streak best.

    Args:
        image: the shot, B = 1.
        background: the same view without the ball.
        estimators: to choose among, with their names.
        camera: of the shot.
        roi: left, top, width, height in px to search in.

    Raises:
        StreakError: when the shot suits none of them, with each one's reason.
    """
    tried = [
        _try(name, estimator, image, background, camera, roi) for name, estimator in estimators
    ]
    scored = sorted(
        (candidate for candidate in tried if candidate.score is not None),
        key=lambda candidate: candidate.score or 0.0,
    )
    failed = [candidate for candidate in tried if candidate.score is None]
    if not scored:
        reasons = "; ".join(f"{c.estimator}: {c.reason}" for c in failed)
        raise StreakError(f"none of the estimators can measure this shot: {reasons}")
    limit = (scored[0].score or 0.0) * (1 + SAME)
    level = [candidate for candidate in scored if (candidate.score or 0.0) <= limit]
    best = min(level, key=lambda candidate: candidate.edge_std_px or 0.0)
    return Selection(
        estimator=dict(estimators)[best.estimator],
        name=best.estimator,
        candidates=(best, *(c for c in scored if c is not best), *failed),
    )


def _try(
    name: str,
    estimator: AlphaEstimator,
    image: LinearImage,
    background: LinearImage,
    camera: Camera,
    roi: ROI | None,
) -> Candidate:
    try:
        score, edge_std = score_estimator(image, background, estimator, camera, roi)
    except (StreakError, BadOutputError) as error:
        return Candidate(estimator=name, reason=str(error))
    return Candidate(estimator=name, score=score, edge_std_px=edge_std)


def score_estimator(
    image: LinearImage,
    background: LinearImage,
    estimator: AlphaEstimator,
    camera: Camera,
    roi: ROI | None = None,
) -> tuple[float, float]:
    """Fit all but some pixels of the streak and predict these.

    Returns:
        Mean squared error of the prediction over its noise, about 1 for a perfect one, and the
        median standard deviation of a profile's edge in px.

    Raises:
        StreakError: when this estimator cannot measure the shot.
    """
    estimator = guarded(estimator).seen_through(camera)
    view = observe_streak(image, background, estimator, roi)
    height, width = view.clipped.shape[-2:]
    across, down = LATTICE
    places = torch.arange(width) * across + torch.arange(height)[:, None] * down
    is_held_out = (places % HELD_OUT == 0)[None, None]
    fit, _ = fit_streak(replace(view, clipped=view.clipped | is_held_out), estimator)
    score = _score(view, is_held_out, fit, settled(estimator, fit))
    variance = fit.covariance[0, :, 0, 0] + fit.covariance[0, :, 1, 1]
    return score, float((variance[fit.good[0]].median() * misfit_variance(fit)).sqrt())


def _score(
    view: StreakView, is_held_out: Tensor, fit: ProfileFit, estimator: AlphaEstimator
) -> float:
    colours = view.colours()
    seen = _colour_profiles(colours, view, fit)
    marks = is_held_out.expand_as(colours.signal).to(colours.signal.dtype)
    held_out = _colour_profiles(replace(colours, signal=marks), view, fit).signal[0, ..., 0]
    alpha, share = _predict_opacity(seen, fit)
    is_near = (share.abs() < EDGE) & seen.valid[0] & fit.good[0][:, None]
    chord = Chord(
        offset=share.clamp(-1, 1),
        direction=seen.direction[0][:, None],
        place=seen.origin[0][:, None],
    )
    ground, variance = seen.ground[0], seen.variance[0]
    if torch.equal(view.observation.signal, colours.signal):
        colour = estimator.foreground(chord, None)
    else:
        is_shown = is_near & (held_out == 0)
        colour = _learn_colour(seen, alpha, share.clamp(-1, 1), is_shown)
    error = alpha[..., None] * colour + (1 - alpha[..., None]) * ground - seen.signal[0]
    squared = (error * error / variance).clamp(max=OUTLIER**2)
    counted = (is_near & (held_out > 0))[..., None] & torch.isfinite(variance)
    return float(squared[counted].mean())


def _colour_profiles(observation: Observation, view: StreakView, fit: ProfileFit) -> Profiles:
    """Lay the pixels along the same profiles as the fit's."""
    half_width = float(fit.half_width[0][fit.good[0]].median())
    return gather_profiles(
        observation,
        view.clipped,
        fit.origin,
        PROFILE_REACH * half_width + 4,
        corner=view.corner,
        spacing=float(fit.position[0].diff().mean()),
    )


def _predict_opacity(profiles: Profiles, fit: ProfileFit) -> tuple[Tensor, Tensor]:
    """Give alpha and the offset in half widths of every pixel, [P, S], from the smooth course."""
    smooth = smooth_parameters(fit)
    centre, half_width, opacity, skew = (smooth[:, None, i] for i in range(4))
    offset = profiles.offset[0]
    bend = (axis_bend(profiles)[0] * smooth[:, 1] / 2)[:, None]
    alpha = semi_ellipse(offset, centre, half_width, opacity, skew, fit.blur[0], bend)
    return alpha, (offset - centre) / half_width


def _learn_colour(profiles: Profiles, alpha: Tensor, share: Tensor, is_shown: Tensor) -> Tensor:
    """Find the ball's mean colour across the streak from the pixels shown, [P, S, 3]."""
    powers = torch.stack([share**power for power in range(COLOUR_TERMS)], dim=-1)
    design = alpha[..., None] * powers
    rest = profiles.signal[0] - (1 - alpha[..., None]) * profiles.ground[0]
    weight = is_shown[..., None] / profiles.variance[0]
    normal = torch.einsum("psk,psc,psl->ckl", design, weight, design)
    right = torch.einsum("psk,psc,psc->ck", design, weight, rest)
    ridge = (
        1e-9
        * normal.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None]
        * torch.eye(COLOUR_TERMS, dtype=normal.dtype)
    )
    coefficients: Tensor = torch.linalg.solve(normal + ridge, right[..., None])[..., 0]
    return powers @ coefficients.mT
