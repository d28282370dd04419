"""From a sharp picture to the light of the ball's disc, on a grid that no longer knows the lens."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.ball import Disc, SharpBall
from toolkit.disc import BallView, view_ball, view_disc
from toolkit.rim import sample_light
from toolkit.rim_light import RIM, fit_rim_light
from toolkit.smooth_light import SmoothLight, fit_smooth_light
from toolkit.types import LinearImage

GRID = (65, 129)
"""Fewest and most nodes along a side of the grid; between them one a pixel of the disc."""


def look_at_ball(image: LinearImage, background: LinearImage) -> SharpBall:
    """Find a resting ball, sharp in the picture, and take the light of its disc.

    Args:
        image: the ball, B = 1.
        background: the same view without the ball.

    Raises:
        CalibrationError: when there is no disc that can be used; the text says why.
        MismatchError: when the two pictures do not show the same scene in similar light.
    """
    return lay_out(view_ball(image, background))


def look_at_disc(image: LinearImage, background: LinearImage, disc: Disc) -> SharpBall:
    """Take the light of a disc that was found before.

    Raises:
        MismatchError: when the disc does not lie in the picture.
    """
    return lay_out(view_disc(image, background, disc))


def lay_out(view: BallView) -> SharpBall:
    """Put the light of a disc on the grid of a `SharpBall`, freed from the background at the rim.

    Where a smooth shade explains the picture, it is taken, without the lens's blur, and with it the
    disc that fits best. Of other balls pixels are taken as they are; where there are more of them
    than the grid has nodes, those about a node are averaged.
    """
    smooth = fit_smooth_light(view)
    return _as_seen(view) if smooth is None else _smooth(view, smooth)


def _smooth(view: BallView, smooth: SmoothLight) -> SharpBall:
    place = _grid(GRID[1])
    place = place / torch.linalg.vector_norm(place, dim=-1, keepdim=True).clamp_min(1)
    light, errors = smooth.at(place).clamp_min(0), smooth.errors(place)
    # others whose mean square tells the variance
    others = light + math.sqrt(len(errors)) * errors
    light, others = (x.movedim(-1, -3).float().contiguous() for x in (light, others))
    disc = replace(view, disc=smooth.disc).picture_disc
    return SharpBall(disc=disc, rgb=light, clipped=view.clipped, others=others)


def _as_seen(view: BallView) -> SharpBall:
    radius = math.sqrt(view.disc.semi_axes[0] * view.disc.semi_axes[1])
    size = _odd(min(max(2 * radius, GRID[0]), GRID[1]))
    place = _grid(size)
    rho = torch.linalg.vector_norm(place, dim=-1)
    inside = 1 - RIM / radius
    light = _averaged(view.image, view.disc, place, 2 * radius / (size - 1))
    light = torch.where((rho > inside)[..., None], _extended(view, place, rho), light)
    return SharpBall(
        disc=view.picture_disc, rgb=light.movedim(-1, 0).float().contiguous(), clipped=view.clipped
    )


def _grid(size: int) -> Tensor:
    """Give the places of nodes on the unit disc, [N, N, 2]."""
    line = torch.linspace(-1, 1, size, dtype=torch.float64)
    return torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1)


def _averaged(image: LinearImage, disc: Disc, place: Tensor, spacing: float) -> Tensor:
    """Give the mean light about each node [N, N, 3]; `spacing` is that of the nodes in px."""
    count = max(1, round(spacing))
    offsets = ((torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5) * spacing
    centre = disc.from_unit(place)
    total = torch.zeros(*place.shape[:-1], 3, dtype=place.dtype)
    for down in offsets.tolist():
        for right in offsets.tolist():
            shift = torch.tensor([right, down], dtype=place.dtype)
            total = total + sample_light(image, centre + shift)[0]
    return total / count**2


def _extended(view: BallView, place: Tensor, rho: Tensor) -> Tensor:
    """Give the light that was fitted near the rim, there and beyond, [N, N, 3]."""
    angle, light = fit_rim_light(view)
    at = torch.atan2(place[..., 1], place[..., 0]) / math.tau % 1 * len(angle)
    low = at.floor().long() % len(angle)
    share = (at - at.floor())[..., None, None]
    near = light[low] * (1 - share) + light[(low + 1) % len(angle)] * share
    facing = (1 - rho**2).clamp_min(0).sqrt()
    powers = torch.stack([torch.ones_like(facing), facing, facing**2], dim=-1)
    # a noisy rise must not carry the light beyond what any ball sends
    return torch.einsum("yxi,yxic->yxc", powers, near).clamp_min(0)


def _odd(size: float) -> int:
    """Give the next odd number, so that a node lies at the centre."""
    return 2 * math.ceil((size - 1) / 2) + 1
