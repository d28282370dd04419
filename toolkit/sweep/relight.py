"""The ball's light and its motion together, where a picture told the light with errors.

The streak's own pixels tell of the light too, more than one sharp picture where the streak is long.
An estimator that can say by which independent errors its light may be off is asked what each of
them changes in the streak. Motion and errors are then found together: to first order by one step
of the joint equations, in which each error is held about none as strongly as it is known, and by
fitting the motion again in the light so found. [derived]
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.least_squares import invert_information, solve_information
from toolkit.sweep.fit import SweepFit
from toolkit.sweep.likelihood import HUBER
from toolkit.sweep.model import Coverage

BLOCK = 20_000
"""Pixels looked at together, for the memory's sake."""
SETTLED = 0.25
"""Chi-square that a further step may promise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointLight:
    """Equations of all parameters of a fit and of the light's errors."""

    fit: SweepFit  # in the light that was changed
    amounts: Tensor  # [E] standard deviations by which the light was changed already
    step: Tensor  # [E] and by which it is to be changed more
    gain: float  # chi-square that this step promises
    information: Tensor  # [P + E, P + E]

    @property
    def is_settled(self) -> bool:
        """Say whether another step would change next to nothing."""
        return self.gain < SETTLED

    def path_covariance(self, size: int) -> Tensor:
        """Give the covariance of the path's K parameters, the light being uncertain."""
        return invert_information(self.information[None])[0][:size, :size]


def joint_light(fit: SweepFit, loose: AlphaEstimator, amounts: Tensor) -> JointLight:
    """Find by how much the streak asks for another light.

    Args:
        fit: the most likely motion in the light that was changed by `amounts`.
        loose: the estimator whose unknowns are the errors of its light.
        amounts: standard deviations [E].
    """
    seen, count = fit.seen, len(fit.parameters)
    information = torch.zeros(count + len(amounts), count + len(amounts), dtype=torch.float64)
    information[:count, :count] = seen.information
    information[count:, count:] = torch.eye(len(amounts), dtype=torch.float64)
    gradient = torch.cat([seen.gradient, amounts])
    rest = 1 - seen.coverage.alpha
    variance = fit.pixels.shot_variance + rest**2 * fit.pixels.ground_variance
    far = (HUBER / seen.residual.abs().clamp_min(HUBER)).sqrt()
    root = seen.coverage.alpha * far / variance.sqrt()
    covered = (seen.coverage.alpha > 0).nonzero()[:, 0]
    for first in range(0, len(covered), BLOCK):
        index = covered[first : first + BLOCK]
        design = _design(fit, loose, index)
        for q, (J, at) in enumerate(zip(seen.J, seen.columns, strict=True)):
            D = design[q] * root[q, index]
            information[at[:, None], torch.arange(count, len(gradient))] += J[:, index] @ D.mT
            information[count:, count:] += D @ D.mT
            gradient[count:] -= D @ (seen.residual[q, index] * far[q, index])
    information[count:, :count] = information[:count, count:].mT
    step = solve_information(information, -gradient)
    return JointLight(
        fit=fit,
        amounts=amounts,
        step=step[count:],
        gain=float(-step @ gradient),
        information=information,
    )


def _design(fit: SweepFit, loose: AlphaEstimator, index: Tensor) -> Tensor:
    """Give what each error adds to the ball's colour before some pixels, [Q, E, M]."""
    size, covered = fit.model.path.size, fit.seen.coverage
    model = replace(fit.model, estimator=loose)
    none = torch.zeros(loose.unknowns(), dtype=torch.float64)
    x = torch.cat([fit.parameters[: size + 1], none, fit.parameters[-2 * model.channels :]])
    passage = covered.passage
    some = Coverage(
        alpha=covered.alpha[index],
        J=covered.J[:, index],
        passage=replace(
            passage,
            index=torch.arange(len(index)),
            instant=passage.instant[index],
            room=passage.room[index],
            stiffness=passage.stiffness[index],
            side=passage.side[index],
        ),
        piece=covered.piece[index],
    )
    pixels = replace(fit.pixels, place=fit.pixels.place[index], rays=fit.pixels.rays[index])
    design = model.colours(x, pixels, some).design
    if design is None:
        return torch.zeros(model.channels, len(none), len(index), dtype=torch.float64)
    return design.expand(-1, -1, len(index))
