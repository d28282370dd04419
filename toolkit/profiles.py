"""Profiles across the streak, made of the picture's own pixels.

The paper samples shot and background along lines. Here every pixel joins the profile it lies
nearest to, at its exact offset from the axis: nothing is interpolated, so that noise stays
independent and as large as it is, each pixel is used once, and behind a colour mosaic each counts
for the one channel that was measured there.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit.alpha import Observation
from toolkit.box_filter import ring_mean
from toolkit.shapes import check_shape
from toolkit.types import Profiles

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

BEND_REACH = 10
"""px to either side over which the axis' bend is taken."""
COARSE = 8
"""px between the profiles among which a pixel's nearest is first looked for."""
MAX_ROUNDS = 4
"""In which pixels move to a profile nearer by, where the axis bends."""


def gather_profiles(
    observation: Observation,
    clipped: Tensor,
    axis: Tensor,
    reach: float,
    *,
    corner: tuple[int, int] = (0, 0),
    spacing: float = 1.0,
    every: int = 1,
    smooth_ground: Tensor | None = None,
) -> Profiles:
    """Gather the pixels about an axis into profiles perpendicular to it.

    Source: Caglioti & Giusti 2007, section 3.2. Deviation: pixels are taken where they are instead
    of samples being interpolated.

    Args:
        observation: signal, ground and variance on a window of the picture [B, Q, H, W].
        clipped: pixels not to be trusted [B, 1, H, W] bool.
        axis: points along the streak in the order of the motion assumed [B, N, 2] px of the whole
            picture.
        reach: how far profiles extend to either side, px.
        corner: where the window's top-left pixel lies in the whole picture, (x, y).
        spacing: from one profile to the next, px.
        every: keep one profile of so many; what is only a first look needs no more.
        smooth_ground: `ring_mean` of the ground, where it is at hand.

    Raises:
        ShapeError: when B disagrees.
    """
    check_shape("axis", axis, observation.signal.shape[0], "N", 2)
    origin, normal, position = place_profiles(axis, spacing)
    height, width = observation.signal.shape[-2:]
    size, corner_px = (height, width), torch.tensor(corner)
    slots = [
        _assign(size, (origin[b] - corner_px).numpy(), normal[b].numpy(), reach, every)
        for b in range(len(axis))
    ]
    count = max(slot.pixel.shape[1] for slot in slots)
    index = torch.stack([_pad(slot.pixel, count) for slot in slots])
    is_filled = index >= 0
    safe = index.clamp_min(0)
    offset = torch.stack([_pad(slot.offset, count) for slot in slots])
    untouched = ~torch.stack([clipped[b].flatten()[safe[b]] for b in range(len(clipped))])
    if smooth_ground is None:
        smooth_ground = ring_mean(observation.ground)
    return Profiles(
        origin=origin[:, ::every],
        normal=normal[:, ::every],
        position=position[:, ::every],
        offset=torch.where(is_filled, offset, 0),
        signal=_take(observation.signal, safe),
        ground=_take(observation.ground, safe),
        smooth_ground=_take(smooth_ground, safe),
        variance=_take(observation.variance, safe),
        is_filled=is_filled,
        valid=is_filled & untouched,
    )


def place_profiles(axis: Tensor, spacing: float = 1.0) -> tuple[Tensor, Tensor, Tensor]:
    """Place profiles evenly along a polyline.

    Args:
        axis: [B, N, 2] px.
        spacing: px from one to the next, about (on the longest axis, in a batch).

    Returns:
        Origins [B, P, 2], unit normals to the right of the motion [B, P, 2] and arc lengths [B, P],
        px.
    """
    steps = torch.linalg.vector_norm(axis.diff(dim=1), dim=-1)
    length = torch.cat([torch.zeros_like(steps[:, :1]), steps.cumsum(1)], dim=1)
    count = max(2, round(float(length[:, -1].max()) / spacing) + 1)
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
    # y points down, so that (-y, x) points to the right of a motion (x, y) as seen in the picture
    normal = torch.stack([-tangent[..., 1], tangent[..., 0]], dim=-1)
    return origin, normal, position


def axis_bend(profiles: Profiles) -> Tensor:
    """Give the curvature of the axis at each profile [B, P], 1 / px, positive to the right."""
    normal = profiles.normal
    spacing = profiles.position[:, 1:2] - profiles.position[:, :1]
    reach = max(1, min(round(BEND_REACH / float(spacing.max())), (normal.shape[1] - 1) // 2))
    padded = torch.nn.functional.pad(normal.mT, (reach, reach), mode="replicate").mT
    turned = padded[:, 2 * reach :] - padded[:, : len(padded[0]) - 2 * reach]
    tangent = torch.stack([normal[..., 1], -normal[..., 0]], dim=-1)
    places = torch.arange(normal.shape[1])
    last = normal.shape[1] - 1
    span = (places + reach).clamp(max=last) - (places - reach).clamp(min=0)
    return -(turned * tangent).sum(-1) / (span * spacing)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slots:
    """Which pixel fills each place of each profile; -1 where none does."""

    pixel: Tensor  # [P, S]
    offset: Tensor  # [P, S] px


def _assign(
    size: tuple[int, int], origin: Array, normal: Array, reach: float, every: int
) -> _Slots:
    """Give every pixel of a window (height, width) near the axis to its nearest profile.

    Profiles keep their breadth where only one of so many is laid, and what lies between is left.
    """
    breadth = max(float(np.hypot(*np.diff(origin, axis=0).T).mean()), 1e-9)
    origin, normal = origin[::every], normal[::every]
    spacing, last = every * breadth, len(origin) - 1
    frame = np.ascontiguousarray(np.concatenate([origin, normal], axis=1).T)
    x, y, profile = _rough_neighbours(size, origin, reach, spacing)
    along, offset = _from_profile(x, y, frame, profile)
    if every > 1:
        steps = np.rint(along / spacing)
        # by so much may the axis' turn change where it lies from the next profile
        turn = float(np.hypot(*np.diff(normal, axis=0).T).max(initial=0))
        slack = turn * np.abs(steps) * (np.abs(offset) + spacing)
        may_be_taken = (np.abs(offset) <= reach + slack) & (
            np.abs(along - steps * spacing) <= breadth / 2 + slack
        )
        x, y, along, offset = (values[may_be_taken] for values in (x, y, along, offset))
        profile = profile[may_be_taken]
    for _ in range(MAX_ROUNDS):
        nearer = (profile + np.rint(along / spacing).astype(np.intp)).clip(0, last)
        moved = np.nonzero(nearer != profile)[0]
        if not len(moved):
            break
        profile[moved] = nearer[moved]
        along[moved], offset[moved] = _from_profile(x[moved], y[moved], frame, profile[moved])
    # what lies beyond the first or the last profile belongs to none
    is_outer = (profile == 0) | (profile == last) | (every > 1)
    room = np.where(is_outer, breadth / 2, breadth)
    chosen = np.nonzero((np.abs(offset) <= reach) & (np.abs(along) <= room))[0]
    # numbers of 16 bits are sorted by their digits
    number = profile[chosen].astype(np.uint16 if last < 1 << 16 else np.intp)
    order = np.argsort(number, kind="stable")
    chosen, row = chosen[order], number[order].astype(np.intp)
    sizes = np.bincount(row, minlength=last + 1)
    place = np.arange(len(row)) - (np.cumsum(sizes) - sizes)[row]
    shape = (last + 1, max(int(sizes.max()), 1))
    pixel_table = np.full(shape, -1)
    pixel_table[row, place] = y[chosen].astype(np.intp) * size[1] + x[chosen].astype(np.intp)
    offset_table = np.zeros(shape)
    offset_table[row, place] = offset[chosen]
    return _Slots(pixel=torch.from_numpy(pixel_table), offset=torch.from_numpy(offset_table))


def _from_profile(x: Array, y: Array, frame: Array, profile: Indices) -> tuple[Array, Array]:
    """Where pixels (x, y) lie from the origin of their profile: along the axis and across it.

    The frame holds x and y of all origins and of all normals, [4, P].
    """
    origin_x, origin_y, normal_x, normal_y = (values.take(profile) for values in frame)
    right, down = x - origin_x, y - origin_y
    return right * normal_y - down * normal_x, right * normal_x + down * normal_y


def _rough_neighbours(
    size: tuple[int, int], origin: Array, reach: float, spacing: float
) -> tuple[Array, Array, Indices]:
    """Give the pixels (x, y) of a window that may lie within reach of the axis, and profiles near.

    Whole blocks of them are looked at, since their distances to all profiles take the longest.
    """
    height, width = size
    y, x = (np.arange(0, extent, COARSE) + (COARSE - 1) / 2 for extent in size)
    stride = max(1, int(COARSE / spacing))
    at_x, at_y = origin[::stride].T
    squared = ((x[:, None] - at_x) ** 2)[None] + ((y[:, None] - at_y) ** 2)[:, None]
    nearest = squared.argmin(-1)
    distance = np.sqrt(np.take_along_axis(squared, nearest[..., None], -1)[..., 0])
    # a block's corner is 0.7 blocks from its middle, a place on the axis half one from an origin
    nearest[distance > reach + 0.8 * COARSE + stride * spacing / 2] = -1
    fine = nearest.repeat(COARSE, 1).repeat(COARSE, 0)[:height, :width]
    rows, columns = np.nonzero(fine >= 0)
    return columns.astype(np.float64), rows.astype(np.float64), stride * fine[rows, columns]


def _pad(table: Tensor, count: int) -> Tensor:
    return torch.nn.functional.pad(table, (0, count - table.shape[1]), value=-1)


def _take(picture: Tensor, index: Tensor) -> Tensor:
    """Values of [B, Q, H, W] at flat pixel indices [B, P, S]: [B, P, S, Q] float64."""
    flat = picture.flatten(2)
    taken = [flat[b][:, index[b]] for b in range(len(flat))]
    # channels stay apart in memory, as they are fitted
    return torch.stack(taken).to(torch.float64).permute(0, 2, 3, 1)
