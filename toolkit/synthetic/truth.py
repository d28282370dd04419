"""The true contours of a streak, in closed form."""

import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.synthetic.paths import BallPath


def true_contours(
    path: BallPath, camera: Camera, ball_radius: float, exposure: float, count: int = 200
) -> Tensor:
    """Give the two contours of the tube the ball sweeps, as seen by the camera.

    The tube touches the ball along the circle of normals n perpendicular to the motion; a viewing
    ray grazes it there where n.(C + R n) = 0, so n.C = -R, which has two solutions in the plane
    across the motion.
    Source: derived; the tube is the canal surface of Caglioti & Giusti 2007, section 4.

    Args:
        path: the ball's path.
        camera: the camera.
        ball_radius: metre.
        exposure: second.
        count: points along each contour, at equal steps of time.

    Returns:
        [2, count, 2] px, first the contour on the left when walking along the motion in the image,
        then the right one; NaN where the ball moves so directly towards or away from the camera
        that the tube hides within the ball.
    """
    time = torch.linspace(0, exposure, count, dtype=torch.float64)
    centre, velocity = path.position(time), path.velocity(time)
    along = torch.nn.functional.normalize(velocity, dim=-1)
    across = centre - (centre * along).sum(-1, keepdim=True) * along
    distance = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    e1 = across / distance
    e2 = torch.linalg.cross(along, e1)
    cosine = -ball_radius / distance
    sine = (1 - cosine**2).clamp_min(0).sqrt()
    normals = torch.stack([cosine * e1 + sine * e2, cosine * e1 - sine * e2])
    pixels = camera.project(centre + ball_radius * normals)
    return torch.where(distance > ball_radius, pixels, torch.nan)
