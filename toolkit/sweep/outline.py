"""The streak's two outlines, as the path found draws them."""

import torch
from torch import Tensor

from toolkit.camera import Camera


def draw_outline(path: Tensor, velocity: Tensor, camera: Camera, ball_radius: float) -> Tensor:
    """Give the left and right contour of the tube that a ball sweeps [2, N, 2] px.

    A point C + R n of it is seen edge on where n stands square to the motion and to the ray.

    Args:
        path: of the centre [N, 3] m.
        velocity: along it, of any unit [N, 3].
        camera: of the shot.
        ball_radius: m.
    """
    ahead = torch.nn.functional.normalize(velocity, dim=-1)
    across = path - (path * ahead).sum(-1, keepdim=True) * ahead
    distance = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    towards = across / distance
    sine = (ball_radius / distance).clamp_max(1)
    # with x right, y down, z forward this points to the right of the motion
    aside = torch.linalg.cross(towards, ahead)
    sides = [-sine * towards + side * (1 - sine**2).sqrt() * aside for side in (-1.0, 1.0)]
    return torch.stack([camera.project(path + ball_radius * normal) for normal in sides])
