"""Fitting an ellipse to a rim that was found in many directions."""

import math

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.errors import CalibrationError
from toolkit.ranks import HALF_OF_NORMAL
from toolkit.rim import Rim

MIN_DIRECTIONS = 16
OUTLIER = 3.0
"""Standard deviations from the ellipse beyond which a direction does not count."""
FLOOR = 0.1
"""px, within which the rim of a real ball follows an ellipse."""


def follow_rim(disc: Disc, rim: Rim) -> tuple[Disc, float, Tensor]:
    """Fit an ellipse to a rim.

    Near a circle five harmonics are all that an ellipse can do: grow, move and stretch. [derived]

    Args:
        disc: about which the rim was found.
        rim: where it is in D directions.

    Returns:
        The ellipse, by how many px it differs from `disc`, and each direction's weight [D].

    Raises:
        CalibrationError: when the rim is seen in too few directions.
    """
    change, weight = _fit_harmonics(rim)
    radius = disc.semi_axes[1]
    if int((weight > 0).sum()) < MIN_DIRECTIONS or float(change.abs().max()) > 0.5 * radius:
        raise CalibrationError(
            "no disc found: the outline is not seen against the background; show the whole ball, "
            "resting, before a background of another brightness or colour"
        )
    return (
        _changed(disc, change, _outline_std(rim, change, weight)),
        float(change.abs().max()),
        weight,
    )


def _fit_harmonics(rim: Rim) -> tuple[Tensor, Tensor]:
    """Fit an ellipse's small changes, robustly: px [5], and the weight of each direction [D]."""
    design = _harmonics(rim.angle)
    prior = torch.where(torch.isfinite(rim.variance), 1 / (rim.variance + FLOOR**2), 0)
    weight = prior
    residual = rim.shift
    for _ in range(12):
        system = design.mT @ (weight[:, None] * design)
        system = system + 1e-6 * float(system.diagonal().mean() + 1e-9) * torch.eye(5).to(system)
        change = torch.linalg.solve(system, design.mT @ (weight * rim.shift))
        residual = rim.shift - design @ change
        scale = _robust_scale(residual * prior.sqrt(), prior > 0)
        # Tukey's biweight: what lies far off, as where a shadow joins the ball, does not pull
        off = residual * prior.sqrt() / (OUTLIER * scale)
        weight = prior * (1 - off**2).clamp_min(0) ** 2
    return change, weight


def _harmonics(angle: Tensor) -> Tensor:
    """Give what moves, scales and stretches the unit circle, [D, 5]."""
    one = torch.ones_like(angle)
    return torch.stack(
        [one, angle.cos(), angle.sin(), (2 * angle).cos(), (2 * angle).sin()], dim=-1
    )


def _robust_scale(values: Tensor, usable: Tensor) -> float:
    if not bool(usable.any()):
        return 1.0
    return max(float(values[usable].abs().median()) / HALF_OF_NORMAL, 1.0)


def _outline_std(rim: Rim, change: Tensor, weight: Tensor) -> float:
    """Standard deviation of the outline, px, averaged over all directions.

    Where the rims scatter by more than their variances say, as on a patterned ball, it grows.
    """
    design = _harmonics(rim.angle)
    covariance = torch.linalg.pinv(design.mT @ (weight[:, None] * design))
    scatter = _robust_scale((rim.shift - design @ change) * weight.sqrt(), weight > 0)
    return scatter * math.sqrt(max(float((design @ covariance * design).sum(-1).mean()), 0.0))


def _changed(disc: Disc, change: Tensor, std: float) -> Disc:
    """Apply a change of the outline, px [5], to the disc."""
    a, b = disc.semi_axes
    size, x, y, stretch, skew = (change / math.sqrt(a * b)).tolist()
    shape = disc.from_unit(torch.eye(2, dtype=torch.float64)) - torch.tensor(disc.centre).double()
    shape = shape.mT  # columns: where the unit disc's axes go
    centre = torch.tensor(disc.centre).double() + shape @ torch.tensor([x, y]).double()
    growth = torch.tensor([[1 + size + stretch, skew], [skew, 1 + size - stretch]]).double()
    left, lengths, _ = torch.linalg.svd(shape @ growth)
    return Disc(
        centre=(float(centre[0]), float(centre[1])),
        semi_axes=(float(lengths[0]), float(lengths[1])),
        angle=_half_turn(math.atan2(float(left[1, 0]), float(left[0, 0]))),
        std=std,
    )


def _half_turn(angle: float) -> float:
    """Bring the angle of an axis between -pi/2 and pi/2."""
    return (angle + math.pi / 2) % math.pi - math.pi / 2
