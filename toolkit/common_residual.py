"""What all profiles miss alike: the sign that the ball does not look as its estimator says.

Noise differs from profile to profile and averages out over them; a wrong shape across the streak,
as shading of a ball taken for one colour causes it, does not. A single profile may be fitted well
within its noise, and its width be wrong. [derived]
"""

import torch

from toolkit.alpha import AlphaEstimator
from toolkit.contours import smooth_parameters
from toolkit.profile_model import OWN, ProfileModel, Skew, WhitePixels
from toolkit.types import ProfileFit

MISSHAPEN = 3.0
"""What noise alone never leaves."""
HIDDEN = 2.0
"""How much further the width is moved than what is missed shows."""
BINS = 24
REACH = 1.2
"""Half widths to either side that are looked at."""


def misfit_variance(fit: ProfileFit) -> float:
    """Give how many times as large the variance is of all that the profiles tell together.

    What all of them miss alike moves the width further than it shows, since the fit hides most of
    it; HIDDEN times as far is allowed for. Strong shade moves the depth up to four times further
    still, so that this is no substitute for the right estimator (`benchmarks/ball_kinds.py`).
    """
    if fit.common_misfit <= MISSHAPEN:
        return 1.0
    return 1 + HIDDEN**2 * (fit.common_misfit - 1)


def common_misfit(
    pixels: WhitePixels, fit: ProfileFit, estimator: AlphaEstimator, skew: Skew
) -> float:
    """Give the mean over places across the streak of the squared mean residual of all profiles.

    It is in variances of that mean: 1 where only noise is left over.

    Args:
        pixels: of one picture, what was fitted.
        fit: the final fit; flagged profiles are left out.
        estimator: settled.
        skew: what was known of each profile's skew.
    """
    model = ProfileModel.of(pixels, estimator, skew)
    rows = fit.good.flatten().nonzero()[:, 0]
    x = smooth_parameters(fit)[rows]
    residual, weight = model.residuals(x[:, :OWN], rows, fit.blur)
    share = (pixels.offset[rows] - x[:, :1]) / x[:, 1:2]
    place = ((share / REACH + 1) / 2 * BINS).floor().long()
    inside = (place >= 0) & (place < BINS)
    weight = weight * inside[:, None]
    # a row of bins for every channel
    channels = residual.shape[1]
    slot = place.clamp(0, BINS - 1)[:, None] + BINS * torch.arange(channels)[:, None]
    count = torch.bincount(slot.flatten(), weight.flatten(), BINS * channels)
    total = torch.bincount(slot.flatten(), (weight * residual).flatten(), BINS * channels)
    seen = count > 0
    return float((total[seen] ** 2 / count[seen]).mean())
