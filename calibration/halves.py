"""Two lenses from every other view each, and how far they are apart."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from calibration.lens_fit import Corners, LensFit, fit_lens
from calibration.projection_doubt import projection_difference, projection_std
from calibration.trust import Halves
from toolkit.camera import Camera

FEWEST_VIEWS = 6
"""Three in each half."""


def compare_halves(corners: Corners, fit: LensFit, camera: Camera) -> Halves | None:
    """Fit each half of the views and compare where the two lenses show the scene.

    Args:
        corners: the views.
        fit: a settled fit to all of them.
        camera: its camera with covariance.

    Returns:
        None of fewer than six views.
    """
    if corners.views < FEWEST_VIEWS:
        return None
    odd = np.arange(corners.views) % 2 == 1
    first, second = (_half(corners, fit, camera, part) for part in (odd, ~odd))
    difference = projection_difference(first, second)
    seen = difference[np.isfinite(difference)]
    if not len(seen):
        return None
    # each half knows half as much: twice the variance, and two of them differ by their sum
    expected = 2 * projection_std(camera)
    return Halves(
        rms_px=float(np.sqrt((seen**2).mean())),
        most_px=float(seen.max()),
        expected_px=float(np.sqrt(np.nanmean(expected**2))),
    )


def _half(corners: Corners, fit: LensFit, camera: Camera, part: NDArray[np.bool_]) -> Camera:
    start = replace(fit, rotation=fit.rotation[part], translation=fit.translation[part])
    return camera.with_parameters(torch.from_numpy(fit_lens(corners.only(part), start).lens))
