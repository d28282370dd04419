"""From profiles and contours to the ball's path in space and its motion along it."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator
from toolkit.axis_curve import (
    DEPTH_SIZES,
    AxisCurve,
    AxisFit,
    Edges,
    fit_axis,
    start_curve,
    start_curve_on,
)
from toolkit.camera import Camera
from toolkit.canal import couple_points, interpretation_normals, place_cross_sections, straight_axis
from toolkit.contours import length_in_widths
from toolkit.ends import Ends, OpacityMap, locate_ends, rough_ends
from toolkit.errors import StreakError
from toolkit.motion import (
    RATE_SIZES,
    Motion,
    OpacityData,
    Pace,
    describe_motion,
    fit_pace,
    make_clock,
)
from toolkit.splines import SIZES, up_to
from toolkit.types import Contours, CrossSections, ProfileFit
from toolkit.view import StreakView

CLOCK_MARGIN = 4.0
"""Half widths beyond the rough ends up to which time along the path is followed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reconstruction:
    """What the streak says about the motion, in the order it was found."""

    fit: ProfileFit
    contours: Contours
    axis: AxisFit
    opacity: OpacityData
    pace: Pace
    ends: Ends
    motion: Motion


def place_ball(contours: Contours, camera: Camera, ball_radius: float) -> CrossSections:
    """Place the ball for every pair of coupled contour points.

    Source: Caglioti & Giusti 2007, section 5, "3D reconstruction". Deviation: the coupled point is
    taken to the nearest contour sample.
    """
    rays = camera.unproject(contours.points)
    tangents = (camera.J_unproject(contours.points) @ contours.tangents[..., None])[..., 0]
    normals = interpretation_normals(rays, tangents)
    partner, is_coupled = couple_points(rays, normals)
    right = partner[is_coupled].round().long()
    pairs = torch.stack([rays[0][is_coupled], rays[1][right]], dim=1)
    planes = torch.stack([normals[0][is_coupled], normals[1][right]], dim=1)
    return place_cross_sections(pairs, planes, contours.opacity[is_coupled], ball_radius)


def reconstruct_axis(
    fit: ProfileFit, contours: Contours, camera: Camera, ball_radius: float
) -> AxisFit:
    """Find the path of the ball's centre from the contours of the whole streak.

    Cross sections from coupled points, or a straight axis from two planes where too few points are
    coupled, give the depth to start from; one smooth curve then explains the edges of all profiles.

    Raises:
        StreakError: when the contours belong to no ball in front of the camera.
    """
    if not bool(torch.isfinite(camera.undistort(fit.edges[0][fit.good[0]])).all()):
        raise StreakError(
            "the camera's distortion cannot be inverted at the streak; check the camera file"
        )
    s = along_axis(fit, camera)
    good = fit.good[0].to(torch.float64)
    depth = _rough_depth(contours, camera, ball_radius)
    focal = (camera.fx + camera.fy) / 2
    centre_weight = good * focal**2 / fit.covariance[0, :, 0, 0]
    centres = camera.undistort(_middle(fit))
    widths = length_in_widths(fit)
    start = start_curve(
        centres, s, centre_weight, depth.expand_as(s), good, up_to(3 + widths, SIZES)
    )
    depth_sizes = up_to(2 + widths / 1.5, DEPTH_SIZES)
    axis = fit_axis(start, _edges(fit, s), camera, ball_radius, depth_sizes)
    _check_axis(axis, s[fit.good[0]], ball_radius)
    return axis


def refit_axis(
    found: Reconstruction, camera: Camera, ball_radius: float, extra: int = 0
) -> AxisCurve:
    """Fit the curve again, through a camera that differs little or with `extra` coefficients.

    Two steps suffice from so near.
    """
    fit, curve, s = found.fit, found.axis.curve, found.opacity.s
    weight = fit.good[0] / fit.covariance[0, :, 0, 0]
    centres = camera.undistort(_middle(fit))
    basis = replace(curve.image_basis, size=curve.image_basis.size + extra)
    start = start_curve_on(basis, centres, s, weight, curve.depth_basis, curve.inverse_depth)
    size = len(curve.inverse_depth) + extra
    return fit_axis(start, _edges(fit, s), camera, ball_radius, sizes=(size,), steps=2).curve


def follow_motion(
    view: StreakView,
    estimator: AlphaEstimator,
    camera: Camera,
    ball_radius: float,
    fit: ProfileFit,
    contours: Contours,
    axis: AxisFit,
) -> Reconstruction:
    """Find how fast the ball went along its path, and where the exposure began and ended."""
    opacity = opacity_data(fit, along_axis(fit, camera), camera)
    pace_sizes = up_to(1 + length_in_widths(fit) / 1.5, RATE_SIZES)
    pace = fit_pace(axis.curve, opacity, ball_radius, pace_sizes)
    half_width = float(fit.half_width[fit.good].median())
    s, position = opacity.s.numpy(), fit.position[0].numpy()
    first, last = (float(np.interp(end, position, s)) for end in rough_ends(fit))
    reach = CLOCK_MARGIN * half_width
    clock, rate = make_clock(axis.curve, pace, first - reach, last + reach)
    alpha, variance = estimator.alpha(view.observation)
    pixels = OpacityMap(alpha=alpha[0, 0], variance=variance[0, 0], corner=view.corner)
    ends = locate_ends((first, last), axis.curve, clock, rate, pixels, camera, ball_radius)
    return Reconstruction(
        fit=fit,
        contours=contours,
        axis=axis,
        opacity=opacity,
        pace=pace,
        ends=ends,
        motion=describe_motion(axis.curve, pace, ends.s),
    )


def along_axis(fit: ProfileFit, camera: Camera) -> Tensor:
    """Give the arc length of the profiles' origins as an ideal lens would show it [P] px."""
    ideal = camera.undistort(fit.origin[0]) * ((camera.fx + camera.fy) / 2)
    steps = torch.linalg.vector_norm(ideal.diff(dim=0), dim=-1)
    return torch.cat([steps.new_zeros(1), steps.cumsum(0)])


def opacity_data(fit: ProfileFit, s: Tensor, camera: Camera) -> OpacityData:
    """Gather what the pace is found from."""
    return OpacityData(
        s=s,
        rays=camera.unproject(_middle(fit)),
        opacity=fit.opacity[0],
        covariance=fit.covariance[0],
        weight=fit.good[0].to(torch.float64),
    )


def _middle(fit: ProfileFit) -> Tensor:
    """Centres of the good profiles, origins of the others [P, 2] px: a lens can invert both."""
    return torch.where(fit.good[0][:, None], fit.middle[0], fit.origin[0])


def _edges(fit: ProfileFit, s: Tensor) -> Edges:
    return Edges(
        s=s,
        pixels=torch.where(fit.good[0][:, None, None], fit.edges[0], fit.origin[0][:, None]),
        normal=fit.normal[0],
        covariance=fit.covariance[0, :, :2, :2],
        weight=fit.good[0].to(torch.float64),
    )


def _rough_depth(contours: Contours, camera: Camera, ball_radius: float) -> Tensor:
    """Give one depth, m: of coupled points where there are some, else of the two planes' axis."""
    depth = place_ball(contours, camera, ball_radius).centre[:, 2]
    if len(depth) < 3:
        rays = camera.unproject(contours.points)
        foot, _ = straight_axis(rays, 1 / contours.std**2, ball_radius)
        depth = foot[2:]
    middle = depth.median()
    if not bool(torch.isfinite(middle)) or float(middle) <= ball_radius:
        raise StreakError(
            "the streak's contours belong to no ball in front of the camera; "
            "check camera file and ball radius"
        )
    return middle


def _check_axis(axis: AxisFit, s: Tensor, ball_radius: float) -> None:
    depth = axis.curve(s)[:, 2]
    if not axis.converged or not bool((torch.isfinite(depth) & (depth > ball_radius)).all()):
        raise StreakError(
            "no smooth path explains the streak's contours; "
            "check camera file, background and ball radius"
        )
    if not bool(torch.isfinite(axis.covariance).all()):
        raise StreakError(
            "the streak does not determine the ball's path; a longer streak is needed"
        )
