"""The motion that some profiles tell at once: where the search among all pixels starts.

Each profile's edges are seen in a cone that touches the ball, so that its half angle gives the
distance. Tilt and bend change that by little. [derived]
"""

import numpy as np
import torch
from torch import Tensor

from toolkit.axis_curve import AxisCurve, start_curve
from toolkit.camera import Camera
from toolkit.contours import length_in_widths, smooth_parameters
from toolkit.ends import rough_ends
from toolkit.errors import StreakError
from toolkit.motion import RATE_SIZES, Motion, OpacityData, describe_motion, fit_pace
from toolkit.reconstruction import edge_points, ideal_length, middle_points
from toolkit.splines import SIZES, up_to
from toolkit.types import ProfileFit


def sketch_motion(fit: ProfileFit, camera: Camera, ball_radius: float) -> Motion:
    """Give the motion roughly; its ends, where the opacity rises, are a few px off.

    The path is as smooth as the streak's middle, and its inverse depth changes evenly: a straight
    streak gives a straight line in space.

    Args:
        fit: of one picture.
        camera: with distortion.
        ball_radius: m.

    Raises:
        StreakError: when the profiles are those of no ball in front of the camera.
    """
    # all at once: a lens is inverted in many small steps
    places = [fit.origin[0], middle_points(fit), *edge_points(fit).unbind(1)]
    rays = camera.unproject(torch.stack(places))
    normalised = rays[..., :2] / rays[..., 2:]
    opacity = OpacityData(
        s=ideal_length(normalised[0], camera),
        rays=rays[1],
        opacity=fit.opacity[0],
        covariance=fit.covariance[0],
        weight=fit.good[0].to(torch.float64),
    )
    curve = _sketch_curve(fit, opacity, normalised[1], rays[2:], camera, ball_radius)
    pace_sizes = up_to(1 + length_in_widths(fit) / 1.5, RATE_SIZES)
    pace = fit_pace(curve, opacity, ball_radius, pace_sizes)
    at, position = opacity.s.numpy(), fit.position[0].numpy()
    ends = [float(np.interp(end, position, at)) for end in rough_ends(fit)]
    motion = describe_motion(curve, pace, torch.tensor(ends, dtype=torch.float64))
    if not bool((torch.isfinite(motion.path) & (motion.path[:, 2:] > 0)).all()):
        raise StreakError(
            "the streak's profiles belong to no ball in front of the camera; "
            "check camera file and ball radius"
        )
    return motion


def smooth_edges(fit: ProfileFit) -> Tensor:
    """Give the left and right edges of the good profiles on their smooth course [P, 2, 2] px."""
    good, smooth = fit.good[0], smooth_parameters(fit)
    centre, half_width = smooth[good, :2].unbind(-1)
    offset = torch.stack([centre - half_width, centre + half_width], dim=-1)
    return fit.origin[0, good, None] + offset[..., None] * fit.normal[0, good, None]


def _sketch_curve(
    fit: ProfileFit,
    seen: OpacityData,
    middle: Tensor,
    sides: Tensor,
    camera: Camera,
    ball_radius: float,
) -> AxisCurve:
    """Draw the path with an inverse depth that is linear along the streak.

    Args:
        fit: of one picture.
        seen: where the profiles lie along the streak, and how much each counts.
        middle: their middles in normalised coordinates [P, 2].
        sides: rays of their left and right edges [2, P, 3].
        camera: of the shot.
        ball_radius: m.
    """
    left, right = sides
    both = left + right
    half_angle = torch.atan2(_length(right - left), _length(both))
    depth = ball_radius / half_angle.sin() * both[:, 2] / _length(both)
    good = fit.good[0]
    depth = torch.where(good, depth, depth[good].median())
    variance = fit.covariance[0]
    focal = (camera.fx + camera.fy) / 2
    return start_curve(
        middle,
        seen.s,
        seen.weight * focal**2 / variance[:, 0, 0],
        depth,
        # of the inverse depth, which goes with the half width
        seen.weight * (depth * fit.half_width[0]) ** 2 / variance[:, 1, 1],
        up_to(3 + length_in_widths(fit), SIZES),
    )


def _length(vectors: Tensor) -> Tensor:
    length: Tensor = torch.linalg.vector_norm(vectors, dim=-1)
    return length
