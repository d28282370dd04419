"""What the residual map shows, in words: where and how the streak is not that of a plain ball."""

import torch
from torch import Tensor

from toolkit.sweep.colours import plain_colours
from toolkit.sweep.fit import SweepFit
from toolkit.sweep.marks import MarkedFit
from toolkit.sweep.misfit import beside_excess
from toolkit.sweep.model import SweepModel
from toolkit.sweep.shade import Shaded

TOLD = 0.03
"""Share of the ball's light from which a shade or another colour is spoken of."""
SURE = 3.0
"""Standard deviations from which another colour is."""
DISTURBED = 2.0
"""Mean square of patches beside the ball from which something is wrong there."""


def explain_misfit(fit: SweepFit, marked: MarkedFit | None) -> str:
    """Say what the misfit looks like, or what it may come from where it looks like nothing known.

    Args:
        fit: as reported.
        marked: the same, where marks on the ball were fitted.
    """
    reasons = []
    if marked is not None:
        reasons.append(_describe_marks(marked))
    if beside_excess(fit) > DISTURBED:
        reasons.append("something changed beside the ball too (a shadow, another background)")
    if not reasons:
        return "shading, a pattern, a changed background, a wrong colour or response, compression"
    return "; ".join(reasons)


def _describe_marks(marked: MarkedFit) -> str:
    """Say what the marks look like; what all of the streak misses alike are lanes."""
    marks, before = marked.marks, marked.before
    kind = "lanes along the path" if before.lanes > before.patches else "spots"
    return (
        f"dark and bright {kind}, {marks.width:.2g} ball radii wide, of {marks.strength:.0%} of "
        "its light: holes, ribs, print or dirt"
    )


def explain_shade(fit: SweepFit) -> str:
    """Say how the ball is shaded across the streak."""
    looks = _shade(fit)
    if looks is None:
        return ""
    base, rows = looks
    parts = []
    lean = _relative(2 * rows.get(1, torch.zeros_like(base)), base)
    if abs(lean) > TOLD:
        parts.append(
            f"one edge of the streak by {abs(lean):.0%} of its light brighter than the other"
        )
    rim = _relative(rows.get(2, torch.zeros_like(base)), base)
    if abs(rim) > TOLD:
        parts.append(
            f"both by {abs(rim):.0%} {'brighter' if rim > 0 else 'darker'} than the middle"
        )
    return " (" + ", ".join(parts) + ")" if parts else ""


def other_colour(fit: SweepFit, factor: float) -> float | None:
    """Give by which share the ball is brighter than the colour it is known by; None if it is not.

    Args:
        fit: as reported.
        factor: by which its covariance is widened.
    """
    looks = _shade(fit)
    if looks is None or 0 not in looks[1]:
        return None
    base, rows = looks
    first = fit.model.path.size + 1
    std = (fit.covariance.diagonal()[first : first + len(base)] * factor).sqrt()
    share = _relative(rows[0], _known_colour(fit.model))
    is_sure = bool((rows[0].abs() > SURE * std).any())
    return share if is_sure and float((rows[0].abs() / base.abs().max()).max()) > TOLD else None


def _known_colour(model: SweepModel) -> Tensor:
    """Give the colour that a ball was known by before it was given another one [Q]."""
    ball = model.estimator
    below = ball.innermost if isinstance(ball, Shaded) else ball
    return plain_colours(below, torch.zeros(0, dtype=torch.float64)).colour[:, 0]


def _shade(fit: SweepFit) -> tuple[Tensor, dict[int, Tensor]] | None:
    """Give the ball's plain colour [Q] and the shade's numbers, [Q] for each power."""
    ball = fit.model.estimator
    if not isinstance(ball, Shaded) or not fit.model.is_laned:
        return None
    appearance = fit.model.split(fit.parameters)[2]
    known = ball.estimator.unknowns()
    rows = appearance[known:].reshape(-1, ball.channels)
    colours = fit.model.colours(fit.parameters, fit.pixels, fit.seen.coverage)
    base = colours.colour.mean(1)
    return base, dict(zip(ball.powers, rows, strict=False))


def _relative(change: Tensor, base: Tensor) -> float:
    """Give a change of colour over the colour, brighter positive."""
    return float(change @ base / (base @ base).clamp_min(1e-12))
