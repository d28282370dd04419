"""Finding what an estimator leaves open of the ball's looks, along with the profiles."""

from dataclasses import replace

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.contours import smooth_parameters
from toolkit.least_squares import invert_information
from toolkit.profile_fit import bounded_blur_step, step_from
from toolkit.profile_model import OWN, ProfileModel, Skew, WhitePixels
from toolkit.types import Appearance, ProfileFit, Profiles

ROUNDS = 4
SETTLED = 0.02
"""Standard deviations; a smaller change of all unknowns ends the search."""


def find_appearance(
    profiles: Profiles,
    pixels: WhitePixels,
    estimator: AlphaEstimator,
    guess: Appearance,
    fit: ProfileFit,
    skew: Skew,
    most_rounds: int = ROUNDS,
) -> ProfileFit:
    """Find the unknowns of the ball's appearance, and fit the profiles with them.

    Args:
        profiles: of one picture, what was fitted.
        pixels: theirs.
        estimator: with unknowns, not settled.
        guess: from elsewhere, a weak prior.
        fit: the fit with that guess.
        skew: what is known of each profile's skew.
        most_rounds: after which the search ends even if it has not settled.
    """
    looks = guess
    for _ in range(most_rounds):
        looks, fit, change = _improve(profiles, pixels, estimator, guess, looks.values, fit, skew)
        if change < SETTLED:
            break
    return replace(fit, appearance=looks)


def _improve(
    profiles: Profiles,
    pixels: WhitePixels,
    estimator: AlphaEstimator,
    guess: Appearance,
    values: Tensor,
    fit: ProfileFit,
    skew: Skew,
) -> tuple[Appearance, ProfileFit, float]:
    """Take one Gauss-Newton step in the unknowns [A], the blur and all profiles at once.

    What tells a colour from the opacity, which every profile is free to choose, is how a varying
    background shines through. As in `refine_profiles` all stands about the smooth course of the
    profiles, and the Jacobian sees the smoothed background, without which its noise would count as
    variation. [derived]

    Returns:
        The appearance, the fit with it, and the largest change in standard deviations.
    """
    model = ProfileModel.of(pixels, estimator.settled(values), skew, is_smooth=True)
    x, rows = smooth_parameters(fit), torch.arange(len(pixels.offset))
    J_foreground = model.J_appearance(estimator, x, rows)
    cost, gradient, information = model.full_equations(x, rows, fit.blur, J_foreground)
    own, shared = slice(None, OWN), slice(OWN, None)
    covariance = invert_information(information[:, own, own])
    good = fit.good.flatten()
    gain = torch.where(good[:, None, None], covariance @ information[:, own, shared], 0)
    slope = gradient[good][:, shared].sum(0) - torch.einsum("eou,eo->u", gain, gradient[:, own])
    mixed = information[:, own, shared]
    curvature = information[good][:, shared, shared].sum(0) - torch.einsum(
        "eou,eov->uv", gain, mixed
    )
    slope[1:] += (values - guess.values) / guess.std**2
    curvature[1:, 1:] += torch.eye(len(values), dtype=curvature.dtype) / guess.std**2
    shared_covariance = torch.linalg.inv(curvature)
    step = -(shared_covariance @ slope)
    step[:1] = bounded_blur_step(step[:1], fit.blur)
    per_opacity = (gain[good][:, 2] / x[good, 2:3]).mean(0)
    looks = Appearance(
        values=values + step[1:],
        std=guess.std,
        opacity_std=float((per_opacity @ shared_covariance @ per_opacity).sqrt()),
    )
    fit = step_from(profiles, fit, x, cost, gradient, information, covariance, step[None])
    change = float((step[1:] / shared_covariance.diagonal()[1:].sqrt()).abs().max())
    return looks, fit, change
