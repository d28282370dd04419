"""Whether light was decoded rightly: what the response is known by, and what the streak says of it.

Light that was decoded with a wrong exponent no longer mixes: before a streak, ball and background
do not add up. Part of that looks like another motion; the rest is left over once all else is
fitted, and tells the exponent. [derived]
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.demosaicing import tile
from toolkit.response import CurveDoubt
from toolkit.sweep.fit import SweepFit
from toolkit.sweep.pixels import Frame
from toolkit.sweep.squares import Squares
from toolkit.types import LinearImage
from toolkit.view import StreakView

ASSUMED_STD = 0.05
"""Standard deviation of the exponent of a response that was assumed from the kind of file."""
NAMED_STD = 0.02
"""The same of one that somebody named: real cameras follow no curve exactly."""
CERTAIN = 3.5
"""Standard deviations by which noise does not move the exponent found."""
COLOURS = 3
"""Channels from which a signal is light, whose exponent can be wrong."""
DARKEST = 1e-3
"""Of white: what is below counts for as much, since its logarithm is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearity:
    """By how much the exponent of the light may be off."""

    known: float  # standard deviation that is granted whatever the streak says; 0 for linear light
    found: float = 0.0  # by which the streak would have light's exponent larger than 1
    found_std: float = math.inf

    @property
    def is_doubted(self) -> bool:
        """Whether the streak asks for more than is granted and noise can do."""
        return abs(self.found) > CERTAIN * math.hypot(self.known, self.found_std)

    @property
    def std(self) -> float:
        """Standard deviation to reckon with."""
        return max(self.known, abs(self.found)) if self.is_doubted else self.known


def judge_linearity(view: StreakView, fit: SweepFit, factor: float) -> Linearity:
    """Find the exponent that the streak asks for beside all that was fitted.

    Args:
        view: the streak's surroundings.
        fit: the most likely motion.
        factor: by which its misfit exceeds noise.
    """
    known = _known_std(view.shot)
    if fit.model.channels < COLOURS:
        return Linearity(known=known)
    change = _bend(view, fit)
    seen = fit.seen
    shared = seen.answer(change)
    own = float((change * change).sum())
    for J, at, row in zip(seen.J, seen.columns, change, strict=True):
        own -= float(shared[at] @ (J @ row))
    if not own > 0:
        return Linearity(known=known)
    # what is left of the gradient is that of the search's last step
    pull = float((change * seen.residual).sum() + shared @ seen.gradient)
    return Linearity(known=known, found=pull / own, found_std=math.sqrt(factor / own))


def _bend(view: StreakView, fit: SweepFit) -> Tensor:
    """Give the change of the whitened residual [Q, N] for one more in the light's exponent.

    The background is taken from around each pixel: noise shared with the residual would tell of an
    exponent wherever the noise itself is known a little wrong.
    """
    pixels, alpha = fit.pixels, fit.seen.coverage.alpha
    ground = torch.cat([_around(squares, view) for squares in pixels.squares], dim=-1).double()
    ball = fit.model.colours(fit.parameters, pixels, fit.seen.coverage).colour
    both = alpha * ball + (1 - alpha) * ground
    change = _power_slope(both) - alpha * _power_slope(ball) - (1 - alpha) * _power_slope(ground)
    rest = 1 - alpha
    return change / (pixels.shot_variance + rest**2 * pixels.ground_variance).sqrt()


def _around(squares: Squares, view: StreakView) -> Tensor:
    """Give the background's light around each square [Q, M], without its own."""
    if squares.side == 1:
        return squares.pick(view.smooth_ground[0])[0][:, 0]
    return squares.ring(view.observation.ground[0])


def _power_slope(light: Tensor) -> Tensor:
    """Give the derivative of a power of light in its exponent, at 1."""
    light = light.clamp_min(0)
    return light * light.clamp_min(DARKEST).log()


def response_changes(
    view: StreakView, estimator: AlphaEstimator, frame: Frame, fit: SweepFit, linearity: Linearity
) -> Tensor:
    """Give how the pixels change [M, Q, N] for each independent error of the response.

    A measured curve errs in the ways it was measured with; where the streak asks for more than
    these allow, and wherever a curve was only named, the exponent errs.
    """
    doubt = view.shot.curve_doubt
    pictures = []
    if doubt is not None:
        for mode in range(len(doubt.changes)):
            pictures.append([_with_mode(p, doubt, mode) for p in (view.shot, view.background)])
    if linearity.std > 0 and (doubt is None or linearity.is_doubted):
        exponent = 1 + linearity.std
        pictures.append([_with_exponent(p, exponent) for p in (view.shot, view.background)])
    rest = 1 - fit.seen.coverage.alpha
    changes = torch.zeros(len(pictures), *fit.pixels.signal.shape, dtype=torch.float64)
    for change, (shot, empty) in zip(changes, pictures, strict=True):
        other = estimator.observe(shot, empty, view.noise)
        signal, ground = other.signal[0] - frame.signal, other.ground[0] - frame.ground
        change += fit.pixels.mean_of(signal) - rest * fit.pixels.mean_of(ground)
    return changes


def _known_std(shot: LinearImage) -> float:
    if shot.response_is_assumed:
        return ASSUMED_STD
    if shot.curve_doubt is not None:
        return shot.curve_doubt.exponent_std()
    return 0.0 if shot.response == "linear" else NAMED_STD


def _with_mode(picture: LinearImage, doubt: CurveDoubt, mode: int) -> LinearImage:
    light = picture.recorded.numpy()
    changed = np.stack([doubt.change(light[:, c % light.shape[1]], mode, c) for c in range(3)], 1)
    if picture.mosaic is not None and picture.pattern is not None:
        site = tile(np.array(picture.pattern), light.shape[-2:])
        changed = np.choose(site, changed[0])[None, None]
    return picture.remade(picture.recorded + torch.from_numpy(changed).to(picture.recorded))


def _with_exponent(picture: LinearImage, exponent: float) -> LinearImage:
    light = picture.recorded
    return picture.remade(light.clamp_min(0) ** exponent)
