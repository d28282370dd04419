"""The light of a sharp ball as a smooth function of its surface's normal, seen through the lens.

Each pixel of the picture holds the ball's light, blurred by lens and pixel, and near the rim some
of the background. A shade that explains them all is free of that blur, and of most of the noise. It
is that of a matt ball in a room with one lamp, which ends somewhere on the ball, and a spline for
all else, held back by its curvature as strongly as there is evidence for. Disc and blur are fitted
with it: where a dark side fades into the background, they cannot be told without the shade. What
is left open is told as independent errors. [derived]
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.disc import BallView
from toolkit.shade_basis import dense_basis, facing_places, lamp_light, turned
from toolkit.smooth_pixels import PATCH_MISFIT, SmoothPixels, is_clear
from toolkit.smooth_shade import NEAR, SINE, Guess, Joint, Shade, brightest

SEARCHES, STEPS = (0, 2), 12
"""Rounds in which a lamp is sought at first, and rounds at most after these."""
MOST_DAMPING = 1e3
"""At which no step helps."""
MISFIT = 1.3
"""Squared residual over that of noise beyond which the light is not smooth."""
STEP = 1e-3
"""Of how near the ball is, for a derivative."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothLight:
    """What fits the light of a disc, and by what it may be off."""

    disc: Disc  # px of the window
    near: Tensor  # [3] how near the ball was, and how far aside, see `facing_places`
    coefficients: Tensor  # [1 + E, K, 3], the most likely first, then errors, one std each
    lamps: Tensor  # [1 + E, 3], each with one error
    near_errors: Tensor  # [E, 3]

    def at(self, place: Tensor) -> Tensor:
        """Give the likeliest light at places of the unit disc [..., 2], [..., 3]."""
        return self._shown(place, self.near).reshape(*place.shape[:-1], 3)

    def errors(self, place: Tensor) -> Tensor:
        """Give independent errors of one standard deviation at the same places, [E, ..., 3]."""
        flat = place.reshape(-1, 2)
        unit = facing_places(flat, self.near)
        error = dense_basis(unit) @ self.coefficients[1:, :-1]
        lit = lamp_light(unit, self.lamps).mT[..., None]
        error += lit[0] * self.coefficients[1:, -1:]
        error += (lit[1:] - lit[0]) * self.coefficients[0, -1]
        here = self._shown(flat, self.near)
        for number, step in enumerate(STEP * torch.eye(3, dtype=torch.float64)):
            slope = (self._shown(flat, self.near + step) - here) / STEP
            error += self.near_errors[:, number, None, None] * slope
        return error.reshape(len(error), *place.shape[:-1], 3)

    def _shown(self, place: Tensor, near: Tensor) -> Tensor:
        unit, best = facing_places(place.reshape(-1, 2), near), self.coefficients[0]
        return dense_basis(unit) @ best[:-1] + lamp_light(unit, self.lamps[:1]) * best[-1]


def fit_smooth_light(view: BallView) -> SmoothLight | None:
    """Fit a smooth shade to all pixels of a disc.

    None where no such shade explains them, or where the background beside the ball is not what it
    is without it, as in a shadow: outline and shade could not be told apart there.
    """
    if not is_clear(view):
        return None
    pixels = SmoothPixels.of(view)
    found = _begun(pixels)
    if found is None:
        return None
    guess, pixels = found
    settled = _settled(pixels, guess)
    if settled is None:
        return None
    guess, equations = settled
    # with all else in its place another lamp may explain more
    other = replace(guess, lamp=brightest(pixels, guess))
    if not torch.equal(other.lamp, guess.lamp):
        again = _settled(pixels, other)
        if again is not None and again[1].shade.doubt < equations.shade.doubt:
            guess, equations = again
    shade = equations.shade
    missed = shade.residual * shade.weight.sqrt()
    if shade.misfit() > MISFIT or pixels.worst_patch(missed) > PATCH_MISFIT:
        return None
    return _described(pixels, guess, equations)


def _begun(pixels: SmoothPixels) -> tuple[Guess, SmoothPixels] | None:
    """Look for a lamp, and again when disc and blur are about right; noise and pixels then stay."""
    guess = Guess(
        disc=pixels.disc,
        spread=pixels.spread,
        near=torch.tensor(NEAR).double(),
        lamp=torch.zeros(1, 3, dtype=torch.float64),
    )
    for number in range(SEARCHES[-1]):
        if number in SEARCHES:
            guess = replace(guess, lamp=brightest(pixels, guess))
        shade = Shade.of(pixels, guess)
        pixels = pixels.with_noise_of(pixels.light - shade.residual)
        # how near the ball is would be misled by a wrong lamp
        moved = guess.moved(Joint.of(pixels, guess, shade).step_of_first(SINE))
        if moved is None:
            return None
        guess = moved
    guess = replace(guess, lamp=brightest(pixels, guess))
    return guess, pixels.held(shade.coverage)


def _settled(pixels: SmoothPixels, guess: Guess) -> tuple[Guess, Joint] | None:
    """Search by damped steps for the guess with most evidence; None where it runs away."""
    shade = Shade.of(pixels, guess)
    equations, damping = Joint.of(pixels, guess, shade), 1e-4
    for _ in range(STEPS):
        if equations.is_settled() or damping > MOST_DAMPING:
            break
        trial = guess.moved(equations.step(damping))
        if trial is None:
            return None
        shade = Shade.of(pixels, trial)
        if shade.doubt < equations.shade.doubt:
            guess, damping = trial, damping * 0.1
            equations = Joint.of(pixels, guess, shade)
        else:
            damping = max(damping * 10, 0.1)
    return guess, equations


def _described(pixels: SmoothPixels, guess: Guess, equations: Joint) -> SmoothLight:
    widening = math.sqrt(max(1.0, equations.shade.misfit()))
    disc = replace(pixels.full(guess.disc), std=widening * pixels.block * equations.outline_std())
    coefficients, moved = equations.errors(guess)
    turns = [widening * turn for turn in moved[:, 6:8]]
    return SmoothLight(
        disc=disc,
        near=guess.near,
        coefficients=torch.cat([equations.shade.coefficients.mT[None], widening * coefficients]),
        lamps=torch.cat([guess.lamp, *(turned(guess.lamp, turn) for turn in turns)]),
        near_errors=widening * moved[:, 8:],
    )
