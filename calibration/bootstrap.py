"""The scatter of a lens when its views are drawn again and again."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.lens_fit import Corners, LensFit, fit_lens

Array = NDArray[np.float64]

FEWEST_DIFFERENT = 3
"""Views of which a draw must hold some; one of fewer determines no lens."""
STEPS = 15


def bootstrap_covariance(corners: Corners, fit: LensFit, count: int, seed: int = 0) -> Array:
    """Give the covariance of the lens over `count` draws of as many views, with replacement.

    Args:
        corners: the views.
        fit: a settled fit to all of them.
        count: draws, 2 or more; 100 give a standard deviation to 7 %.
        seed: equal seeds give equal draws.

    Returns:
        [4 + K, 4 + K]; the views' own scatter, whatever its cause. Few views scatter too little:
        the factor V / (V - 1) is the usual remedy for a mean.
    """
    generator = np.random.default_rng([seed, 17])
    views = corners.views
    lenses: list[Array] = []
    while len(lenses) < count:
        drawn = np.bincount(generator.integers(views, size=views), minlength=views)
        if (drawn > 0).sum() < min(FEWEST_DIFFERENT, views):
            continue
        weighted = corners.weighing(corners.weight * np.sqrt(drawn)[:, None])
        lenses.append(fit_lens(weighted.only(drawn > 0), _of(fit, drawn > 0), STEPS).lens)
    spread = np.cov(np.array(lenses), rowvar=False)
    return np.asarray(spread * views / (views - 1))


def _of(fit: LensFit, kept: NDArray[np.bool_]) -> LensFit:
    return replace(fit, rotation=fit.rotation[kept], translation=fit.translation[kept])
