"""The streak as the image of a canal surface: from two contours to the ball's place and direction.

A contour point and its tangent span, with the viewpoint, a plane that touches the ball. Two such
planes on facing contours, at coupled points, fix the cross section: the direction of motion lies in
both, and the ball radius sets the distance.
Source: Caglioti & Giusti 2007, section 4, and [derived] as each function says.
"""

import torch
from torch import Tensor

from toolkit.shapes import check_shape
from toolkit.types import CrossSections


def interpretation_normals(rays: Tensor, tangents: Tensor) -> Tensor:
    """Give the outward unit normals of the planes through contour points and tangents.

    Args:
        rays: unit viewing rays of left and right contour points [2, N, 3].
        tangents: derivative of those rays along the contour, in the order of the axis [2, N, 3].

    Returns:
        [2, N, 3].
    """
    check_shape("rays", rays, 2, "N", 3)
    normals = torch.linalg.cross(rays, tangents)
    normals = normals / torch.linalg.vector_norm(normals, dim=-1, keepdim=True)
    away = ((normals * (rays - rays.flip(0))).sum(-1, keepdim=True)).sign()
    outward: Tensor = normals * away
    return outward


def couple_points(rays: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """Find, for every left contour point, the right one that belongs to the same cross section.

    Source: Caglioti & Giusti 2007, section 4.1, property 1: p1 and p2 are coupled when they make
    the same angle with the vanishing point v = n1 x n2. Deviation: none.

    Args:
        rays: [2, N, 3].
        normals: [2, N, 3].

    Returns:
        Fractional index of the coupled right point for each left one [N], NaN where there is none,
        and whether there is one [N] bool.
    """
    left, right = rays
    direction = torch.linalg.cross(normals[0][:, None], normals[1][None])
    mismatch = ((left[:, None] - right[None]) * direction).sum(-1)
    changes = mismatch[:, :-1].sign() != mismatch[:, 1:].sign()
    # several crossings can only come from noise; the one nearest to straight across is meant
    count = len(left)
    across = (torch.arange(count)[:, None] - torch.arange(count - 1)[None]).abs()
    rank = torch.where(changes, across, count)
    nearest = rank.argmin(dim=1, keepdim=True)
    before = mismatch.gather(1, nearest)[:, 0]
    after = mismatch.gather(1, nearest + 1)[:, 0]
    is_coupled = rank.gather(1, nearest)[:, 0] < count
    index = nearest[:, 0] + before / (before - after)
    return torch.where(is_coupled, index, torch.nan), is_coupled


def place_cross_sections(
    rays: Tensor, normals: Tensor, opacity: Tensor, ball_radius: float
) -> CrossSections:
    """Place the ball on the axis for every pair of coupled contour points.

    With outward normals the centre is A = L p1 - R n1 = L p2 - R n2, so that
    L = R |n1 - n2| / |p1 - p2|; the direction is n1 x n2. [derived from section 4.1]

    Args:
        rays: unit viewing rays of the left and right point of each pair [N, 2, 3].
        normals: outward unit normals of their planes [N, 2, 3].
        opacity: at the pair [N].
        ball_radius: m.

    Returns:
        CrossSections, centres in metres.

    Raises:
        ShapeError: when N disagrees.
    """
    check_shape("rays", rays, len(opacity), 2, 3)
    check_shape("normals", normals, len(opacity), 2, 3)
    spread = torch.linalg.vector_norm(normals[:, 0] - normals[:, 1], dim=-1, keepdim=True)
    gap = torch.linalg.vector_norm(rays[:, 0] - rays[:, 1], dim=-1, keepdim=True)
    distance = ball_radius * spread / gap
    centre = distance[..., None] * rays - ball_radius * normals
    direction = torch.linalg.cross(normals[:, 0], normals[:, 1])
    return CrossSections(
        centre=centre.mean(1),
        direction=direction / torch.linalg.vector_norm(direction, dim=-1, keepdim=True),
        opacity=opacity,
    )


def straight_axis(rays: Tensor, weight: Tensor, ball_radius: float) -> tuple[Tensor, Tensor]:
    """Give the axis of a straight streak in closed form: no coupling is needed.

    Each contour is seen in one plane through the viewpoint; its normal is the direction the rays
    lie across from least. The axis is R away from both planes: its point nearest to the viewpoint
    is -R (n1 + n2) / (1 + n1.n2), its direction n1 x n2. [derived]

    Args:
        rays: left and right contour rays [2, N, 3].
        weight: of each point [2, N].
        ball_radius: m.

    Returns:
        The axis point nearest to the viewpoint [3] m and the unit direction [3], along rising N.
    """
    scatter = torch.einsum("sn,sni,snj->sij", weight, rays, rays)
    normals = torch.linalg.eigh(scatter).eigenvectors[:, :, 0]
    middle = (weight[..., None] * rays).sum(1)
    middle = middle / torch.linalg.vector_norm(middle, dim=-1, keepdim=True)
    away = ((normals * (middle - middle.flip(0))).sum(-1, keepdim=True)).sign()
    left, right = normals * away
    foot = -ball_radius * (left + right) / (1 + left @ right)
    direction = torch.linalg.cross(left, right)
    direction = direction / torch.linalg.vector_norm(direction)
    along = (rays[:, -1] - rays[:, 0]).sum(0) @ direction
    return foot, direction * along.sign()
