"""The outline of all that a moving ball covers, its first and last image included, in pixels."""

import torch
from torch import Tensor

from toolkit.camera import Camera

CAP_POINTS = 24
"""On each side of the ball's first and of its last image."""


def outline(
    path: Tensor, displacement: Tensor, camera: Camera, ball_radius: float
) -> tuple[Tensor, Tensor]:
    """Give the two sides of the outline, each from the streak's first tip to its last.

    The ball is seen by its limb: the points with normals n for which n.C = -R. Where the tube that
    it sweeps touches it, n is also square to the motion; before the first of these points the
    outline is the limb of the first image, after the last one that of the last. A ball that stands
    still is a tube without length. [derived]

    Args:
        path: centres of the ball, in the order of the motion [N, 3] m.
        displacement: along the motion there, of any length, 0 included [N, 3].
        camera: with distortion.
        ball_radius: m.

    Returns:
        Left and right side when walking along the motion, [M, 2] px each; the n-th points of both
        face each other.
    """
    first, last = path[:1].expand(CAP_POINTS, 3), path[-1:].expand(CAP_POINTS, 3)
    centre = torch.cat([first, path, last])
    along = torch.cat(
        [displacement[:1].expand_as(first), displacement, displacement[-1:].expand_as(last)]
    )
    distance = torch.linalg.vector_norm(centre, dim=-1, keepdim=True)
    toward = centre / distance
    ahead, aside = _image_axes(toward, along)
    cosine = ball_radius / distance
    sine = (1 - cosine**2).sqrt()
    turn = _touching_angle(toward, ahead, along, cosine, sine)
    share = torch.linspace(0, 1, CAP_POINTS + 1, dtype=path.dtype)[:-1, None]
    turn[:CAP_POINTS] = torch.pi + share * (turn[:CAP_POINTS] - torch.pi)
    turn[-CAP_POINTS:] = share.flip(0) * turn[-CAP_POINTS:]
    sides = (
        centre
        + ball_radius * (sine * (turn.cos() * ahead + side * turn.sin() * aside) - cosine * toward)
        for side in (-1, 1)
    )
    left, right = (camera.project(points) for points in sides)
    return left, right


def _image_axes(toward: Tensor, along: Tensor) -> tuple[Tensor, Tensor]:
    """Give unit vectors across the lines of sight, ahead along the motion and to its right."""
    across = along - (along * toward).sum(-1, keepdim=True) * toward
    length = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    # a ball that stands still, or comes straight on, has no direction in the picture: any will do
    spare = torch.tensor([1.0, 0.0, 0.0], dtype=along.dtype).expand_as(along)
    spare = spare - (spare * toward).sum(-1, keepdim=True) * toward
    is_none = length <= 1e-9 * torch.linalg.vector_norm(along, dim=-1, keepdim=True)
    ahead = torch.nn.functional.normalize(torch.where(is_none, spare, across), dim=-1)
    return ahead, torch.linalg.cross(toward, ahead)


def _touching_angle(
    toward: Tensor, ahead: Tensor, along: Tensor, cosine: Tensor, sine: Tensor
) -> Tensor:
    """Give the angle on the limb, from ahead, at which its normal is square to the motion [N, 1].

    0 or pi where there is none: the ball comes or goes so straight that one image hides the other.
    """
    depthwards = (along * toward).sum(-1, keepdim=True)
    sidewards = (along * ahead).sum(-1, keepdim=True)
    tiny = torch.finfo(along.dtype).tiny
    wanted = cosine * depthwards / (sine * sidewards).clamp_min(tiny)
    return torch.where(depthwards == 0, torch.pi / 2, wanted.clamp(-1, 1).acos())
