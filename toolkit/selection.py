"""Choosing among estimators by how well each predicts pixels that it was not shown.

One pixel in seven is kept from every fit. What the fit says of them in full colour, the ball's
light where it covers them and the background's where it does not, is held against what was seen
there. That measures any estimator alike. One that works on another signal must foretell that as
well, and as it knows no colours, these are learnt from the pixels around. [derived]
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
from toolkit.profiles import axis_bend, gather_profiles
from toolkit.semi_ellipse import semi_ellipse
from toolkit.streak import ROI
from toolkit.streak_fit import PROFILE_REACH, fit_streak, settled
from toolkit.types import LinearImage, ProfileFit, Profiles
from toolkit.view import StreakView, observe_streak

HELD_OUT = 7
"""One pixel in so many; odd, so that the lattice meets every place of a mosaic's pattern."""
LATTICE = (1, 3)
OUTLIER = 4.0
"""Standard deviations beyond which a pixel counts no more: dirt must not decide."""
SAME = 0.05
"""Relative difference of two scores that decides nothing; then the sharper fit is taken."""
FIELDS = 6
"""To a half width, in each of which a colour is learnt where an estimator knows none."""
LEAST_FIELD = 5.0
"""px."""
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
    """Score the estimator's own signal, and the colours where they are another."""
    own = view.observation
    marks = is_held_out.expand_as(own.signal).to(own.signal.dtype)
    hidden = _lay_out(replace(own, signal=marks), view, fit).signal[0, ..., 0] > 0
    seen = _lay_out(own, view, fit)
    alpha, share = _predict_opacity(seen, fit)
    is_near = (share.abs() < EDGE) & seen.valid[0] & fit.good[0][:, None]
    chord = Chord(
        offset=share.clamp(-1, 1),
        direction=seen.direction[0][:, None],
        place=seen.origin[0][:, None],
    )
    counted, colours = is_near & hidden, view.colours()
    score = _mean_error(seen, alpha, estimator.foreground(chord, None), counted)
    if torch.equal(own.signal, colours.signal):
        return score
    seen = _lay_out(colours, view, fit)
    half_width = _typical_half_width(fit)
    learnt = _learn_colour(seen, alpha, share, half_width, is_near & ~hidden)
    return max(score, _mean_error(seen, alpha, learnt, counted))


def _mean_error(profiles: Profiles, alpha: Tensor, ball: Tensor, counted: Tensor) -> float:
    """Mean squared error over noise of what is foretold of the pixels counted [P, S]."""
    ground, variance = profiles.ground[0], profiles.variance[0]
    error = alpha[..., None] * ball + (1 - alpha[..., None]) * ground - profiles.signal[0]
    squared = (error * error / variance).clamp(max=OUTLIER**2)
    return float(squared[counted[..., None] & torch.isfinite(variance)].mean())


def _lay_out(observation: Observation, view: StreakView, fit: ProfileFit) -> Profiles:
    """Lay the pixels along the same profiles as the fit's."""
    return gather_profiles(
        observation,
        view.clipped,
        fit.origin,
        PROFILE_REACH * _typical_half_width(fit) + 4,
        corner=view.corner,
        spacing=float(fit.position[0].diff().mean()),
    )


def _typical_half_width(fit: ProfileFit) -> float:
    return float(fit.half_width[0][fit.good[0]].median())


def _predict_opacity(profiles: Profiles, fit: ProfileFit) -> tuple[Tensor, Tensor]:
    """Give alpha and the offset in half widths of every pixel, [P, S], from the smooth course."""
    smooth = smooth_parameters(fit)
    centre, half_width, opacity, skew = (smooth[:, None, i] for i in range(4))
    offset = profiles.offset[0]
    bend = (axis_bend(profiles)[0] * smooth[:, 1] / 2)[:, None]
    alpha = semi_ellipse(offset, centre, half_width, opacity, skew, fit.blur[0], bend)
    return alpha, (offset - centre) / half_width


def _learn_colour(
    profiles: Profiles, alpha: Tensor, share: Tensor, half_width: float, is_shown: Tensor
) -> Tensor:
    """Find the ball's colour at every pixel from those shown near by, [P, S, 3].

    Near by is within a field of the streak, FIELDS to a half width, of 5 px at least: a pattern
    that turns with the ball changes along the streak.
    """
    field = max(half_width / FIELDS, LEAST_FIELD)
    row = (profiles.position[0] / field).long()
    column = ((share / EDGE + 1) * half_width / field).long().clamp_min(0)
    columns = int(column.max()) + 1
    index = (row[:, None] * columns + column).flatten()
    rest = profiles.signal[0] - (1 - alpha[..., None]) * profiles.ground[0]
    weight = is_shown[..., None] / profiles.variance[0]
    size = int(index.max()) + 1
    colours = []
    for rest_of, weight_of in zip(rest.unbind(-1), weight.unbind(-1), strict=True):
        total = torch.bincount(index, (weight_of * alpha * rest_of).flatten(), size)
        norm = torch.bincount(index, (weight_of * alpha * alpha).flatten(), size)
        colours.append((total / norm.clamp_min(1e-12))[index].reshape(alpha.shape))
    return torch.stack(colours, dim=-1)
