"""From contours to the path of the ball's centre in space."""

from dataclasses import replace

import torch
from torch import Tensor

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
from toolkit.errors import StreakError
from toolkit.splines import SIZES, up_to
from toolkit.types import Contours, CrossSections, ProfileFit


def place_ball(contours: Contours, camera: Camera, ball_radius: float) -> CrossSections:
    """Place the ball for every pair of coupled contour points.

    Source: Caglioti & Giusti 2007, section 5, "3D reconstruction". Deviation: the coupled point is
    taken to the nearest contour sample.
    """
    rays, J = camera.unproject_and_J(contours.points)
    tangents = (J @ contours.tangents[..., None])[..., 0]
    normals = interpretation_normals(rays, tangents)
    partner, is_coupled = couple_points(rays, normals)
    right = partner[is_coupled].round().long()
    pairs = torch.stack([rays[0][is_coupled], rays[1][right]], dim=1)
    planes = torch.stack([normals[0][is_coupled], normals[1][right]], dim=1)
    return place_cross_sections(pairs, planes, contours.opacity[is_coupled], ball_radius)


def check_rays(camera: Camera, points: Tensor) -> None:
    """Raise `StreakError` where the camera sees no ray at a streak's points [..., 2] px."""
    if not bool(torch.isfinite(camera.undistort(points)).all()):
        raise StreakError(
            "the camera's distortion cannot be inverted at the streak; check the camera file"
        )


def reconstruct_axis(
    fit: ProfileFit,
    contours: Contours,
    camera: Camera,
    ball_radius: float,
) -> AxisFit:
    """Find the path of the ball's centre from the contours of the whole streak.

    Cross sections from coupled points, or a straight axis from two planes where too few points are
    coupled, give the depth to start from; one smooth curve then explains the edges of all profiles.

    Args:
        fit: the profiles.
        contours: smoothed from them.
        camera: with distortion.
        ball_radius: m.

    Raises:
        StreakError: when the contours belong to no ball in front of the camera.
    """
    check_rays(camera, fit.edges[0][fit.good[0]])
    s = along_axis(fit, camera)
    good = fit.good[0].to(torch.float64)
    depth = _rough_depth(contours, camera, ball_radius)
    focal = (camera.fx + camera.fy) / 2
    centre_weight = good * focal**2 / fit.covariance[0, :, 0, 0]
    centres = camera.undistort(middle_points(fit))
    widths = length_in_widths(fit)
    start = start_curve(
        centres, s, centre_weight, depth.expand_as(s), good, up_to(3 + widths, SIZES)
    )
    depth_sizes = up_to(2 + widths / 1.5, DEPTH_SIZES)
    axis = fit_axis(start, edges_of(fit, s), camera, ball_radius, depth_sizes)
    _check_axis(axis, s[fit.good[0]], ball_radius)
    return axis


def refit_axis(
    fit: ProfileFit,
    curve: AxisCurve,
    s: Tensor,
    camera: Camera,
    ball_radius: float,
    extra: int = 0,
) -> AxisCurve:
    """Fit the curve again, through a camera that differs little or with `extra` coefficients.

    Two steps suffice from so near.
    """
    weight = fit.good[0] / fit.covariance[0, :, 0, 0]
    centres = camera.undistort(middle_points(fit))
    basis = replace(curve.image_basis, size=curve.image_basis.size + extra)
    start = start_curve_on(basis, centres, s, weight, curve.depth_basis, curve.inverse_depth)
    size = len(curve.inverse_depth) + extra
    return fit_axis(start, edges_of(fit, s), camera, ball_radius, sizes=(size,), steps=2).curve


def along_axis(fit: ProfileFit, camera: Camera) -> Tensor:
    """Give the arc length of the profiles' origins as an ideal lens would show it [P] px."""
    return ideal_length(camera.undistort(fit.origin[0]), camera)


def ideal_length(normalised: Tensor, camera: Camera) -> Tensor:
    """Give the length along normalised points [P, 2], in px of an ideal lens."""
    ideal = normalised * ((camera.fx + camera.fy) / 2)
    steps = torch.linalg.vector_norm(ideal.diff(dim=0), dim=-1)
    return torch.cat([steps.new_zeros(1), steps.cumsum(0)])


def middle_points(fit: ProfileFit) -> Tensor:
    """Centres of the good profiles, origins of the others [P, 2] px: a lens can invert both."""
    return torch.where(fit.good[0][:, None], fit.middle[0], fit.origin[0])


def edge_points(fit: ProfileFit) -> Tensor:
    """Edges of the good profiles, origins of the others [P, 2, 2] px: a lens can invert both."""
    return torch.where(fit.good[0][:, None, None], fit.edges[0], fit.origin[0][:, None])


def edges_of(fit: ProfileFit, s: Tensor) -> Edges:
    """Gather what the path is found from, at parameters s [P] along it."""
    return Edges(
        s=s,
        pixels=edge_points(fit),
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
