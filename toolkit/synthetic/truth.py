"""The true contours and axis of a streak, in closed form."""

import torch
from torch import Tensor

from toolkit.axis_curve import AxisCurve
from toolkit.camera import Camera
from toolkit.splines import SplineBasis
from toolkit.synthetic.paths import BallPath


def true_contours(
    path: BallPath,
    camera: Camera,
    ball_radius: float,
    exposure: float,
    count: int = 200,
    *,
    start: float = 0.0,
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
        exposure: when the contours end, s.
        count: points along each contour, at equal steps of time.
        start: when they start, s.

    Returns:
        [2, count, 2] px, first the contour on the left when walking along the motion in the image,
        then the right one; NaN where the ball moves so directly towards or away from the camera
        that the tube hides within the ball.
    """
    time = torch.linspace(start, exposure, count, dtype=torch.float64)
    points, _, is_seen = grazing_points(path, ball_radius, time)
    return torch.where(is_seen, camera.project(points), torch.nan)


def grazing_points(
    path: BallPath, ball_radius: float, time: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Give where viewing rays graze the tube on either side of the ball's centre.

    Args:
        path: the ball's path.
        ball_radius: metre.
        time: second [N].

    Returns:
        Points in metre and unit normals of the tube there, camera frame, [2, N, 3] each, in the
        order of `true_contours`; and where there are such points at all [N, 1] bool.
    """
    centre, velocity = path.position(time), path.velocity(time)
    along = torch.nn.functional.normalize(velocity, dim=-1)
    across = centre - (centre * along).sum(-1, keepdim=True) * along
    distance = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    e1 = across / distance
    e2 = torch.linalg.cross(along, e1)
    cosine = -ball_radius / distance
    sine = (1 - cosine**2).clamp_min(0).sqrt()
    normals = torch.stack([cosine * e1 + sine * e2, cosine * e1 - sine * e2])
    return centre + ball_radius * normals, normals, distance > ball_radius


def true_axis(path: BallPath, exposure: float, length: float) -> AxisCurve:
    """Give the axis of a path along a line; its parameter goes to `length` in the exposure."""
    ends = path.position(torch.tensor([0.0, exposure], dtype=torch.float64))
    direction = (ends[1] / ends[1, 2] - ends[0] / ends[0, 2])[:2]
    across = torch.stack([-direction[1], direction[0]]) / torch.linalg.vector_norm(direction)
    basis = SplineBasis(start=0.0, stop=length, size=2)
    return AxisCurve(
        image_basis=basis,
        depth_basis=basis,
        image=ends[:, :2] / ends[:, 2:],
        inverse_depth=1 / ends[:, 2],
        across=across.expand(2, 2),
    )
