"""Sampling shot and background along lines across the streak, all profiles at once."""

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from toolkit.alpha import Observation
from toolkit.shapes import check_shape
from toolkit.types import Profiles


def sample_profiles(
    observation: Observation,
    clipped: Tensor,
    axis: Tensor,
    reach: Tensor,
    *,
    corner: tuple[int, int] = (0, 0),
    spacing: float = 1.0,
) -> Profiles:
    """Sample an observation along lines perpendicular to the axis, one sample a pixel, bilinearly.

    The variance handed on is that of raw samples, taken for independent: interpolation smooths and correlates them, which
    cancels in every sum over many samples, while the variance of a single interpolated sample would be too small by half.
    Source: Caglioti & Giusti 2007, section 3.2. Deviation: none.

    Args:
        observation: signal, ground and variance on a window of the picture [B, Q, H, W].
        clipped: samples not to be trusted [B, 1, H, W] bool.
        axis: points along the streak in the order of the motion assumed [B, N, 2] px of the whole picture.
        reach: how far profiles extend to either side [B] px; the largest counts.
        corner: where the window's top-left pixel lies in the whole picture, (x, y).
        spacing: px between profiles along the axis.

    Raises:
        ShapeError: when B disagrees.
    """
    check_shape("axis", axis, observation.signal.shape[0], "N", 2)
    origin, normal, position = place_profiles(axis, spacing)
    half = int(torch.ceil(reach.max()).item())
    offset = torch.arange(-half, half + 1, dtype=origin.dtype)
    points = origin[:, :, None] + offset[:, None] * normal[:, :, None]
    shift = torch.tensor(corner, dtype=origin.dtype)
    local = points - shift
    height, width = observation.signal.shape[-2:]
    size = torch.tensor([width, height], dtype=origin.dtype)
    inside = ((local >= 0) & (local <= size - 1)).all(-1)
    grid = (2 * local + 1) / size - 1
    signal = _sample(observation.signal, grid)
    touched = _sample(clipped.to(signal.dtype), grid)[..., 0] > 0
    return Profiles(
        origin=origin,
        normal=normal,
        position=position,
        offset=offset,
        signal=signal,
        ground=_sample(observation.ground, grid),
        variance=_sample(observation.variance, grid),
        valid=inside & ~touched,
    )


def place_profiles(axis: Tensor, spacing: float) -> tuple[Tensor, Tensor, Tensor]:
    """Place profiles evenly along a polyline.

    Args:
        axis: [B, N, 2] px.
        spacing: px.

    Returns:
        Origins [B, P, 2], unit normals to the right of the motion [B, P, 2] and arc lengths [B, P], px.
    """
    steps = torch.linalg.vector_norm(axis.diff(dim=1), dim=-1)
    length = torch.cat([torch.zeros_like(steps[:, :1]), steps.cumsum(1)], dim=1)
    count = max(2, int(round(float(length[:, -1].max()) / spacing)) + 1)
    share = torch.linspace(0, 1, count, dtype=axis.dtype)
    position = share * length[:, -1:]
    segment = torch.searchsorted(length.contiguous(), position).clamp(1, axis.shape[1] - 1)
    before, after = segment - 1, segment

    def at(values: Tensor, index: Tensor) -> Tensor:
        return values.gather(1, index[..., None].expand(-1, -1, 2))

    start, stop = length.gather(1, before), length.gather(1, after)
    local = ((position - start) / (stop - start).clamp_min(1e-9))[..., None]
    origin = (1 - local) * at(axis, before) + local * at(axis, after)
    tangent = torch.gradient(axis, dim=1)[0]
    tangent = (1 - local) * at(tangent, before) + local * at(tangent, after)
    tangent = tangent / torch.linalg.vector_norm(tangent, dim=-1, keepdim=True).clamp_min(1e-9)
    # y points down, so turning (x, y) into (-y, x) points to the right of the motion as seen in the picture
    normal = torch.stack([-tangent[..., 1], tangent[..., 0]], dim=-1)
    return origin, normal, position


def _sample(picture: Tensor, grid: Tensor) -> Tensor:
    """Bilinear samples of [B, Q, H, W] at grid [B, P, S, 2]: [B, P, S, Q] float64."""
    sampled = grid_sample(
        picture, grid.to(picture.dtype), mode="bilinear", padding_mode="border", align_corners=False
    )
    return sampled.permute(0, 2, 3, 1).to(torch.float64)
