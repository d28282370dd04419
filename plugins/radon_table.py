"""Mean colours along chords of a ball's disc, in a table made once.

Angles serve as coordinates: with offset = sin(phi) and place along the chord = sin(psi), the mean
colours of a matt ball, whose shade ends with a vertical slope at the rim, are smooth up to it.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit import SharpBall

DIRECTIONS = 64
"""Over the whole circle; even, since opposite ones share their chords."""
OFFSETS = 65
PLACES = 65
"""Along a chord."""
SHORTEST = 0.02
"""Half length, in shares of the chord, to which shorter parts are lengthened about their middle."""
RIM = 0.05
"""Half length of a chord at which the slope in the offset, infinite at the rim, stops growing."""
KEYS = torch.tensor([[0.0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
"""From four neighbours to the coefficients of the cubic between the middle two, lowest first.

Source: Keys 1981, "Cubic convolution interpolation", with a = -1/2: smooth to the first derivative,
its error of third order.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadonTable:
    """Integrals of a disc's colours along its chords, for every direction of the motion.

    T directions, O offsets and L places evenly spaced in angle, the latter two with one place more
    beyond either end; C cells between neighbouring offsets.
    """

    cumulative: Tensor  # [T, O, L, 3] integral from the trailing rim, over the chord's half length
    cubics: Tensor  # [T, 4, 3, C] in each cell, of the mean over the whole chord

    @classmethod
    def of(cls, ball: SharpBall) -> "RadonTable":
        """Integrate the colours of a sharp ball."""
        phi, psi = (_angles(count) for count in (OFFSETS, PLACES))
        theta = torch.arange(DIRECTIONS // 2) * (2 * math.pi / DIRECTIONS)
        colour = _colours_along(ball, theta, phi.sin(), phi.cos(), psi.sin())
        steps = (colour[:, :, 1:] + colour[:, :, :-1]) / 2 * psi.sin().diff()[:, None]
        half = torch.nn.functional.pad(steps, (0, 0, 1, 0)).cumsum(2)
        # the opposite motion runs along the same chords backwards, its left being our right
        opposite = half[:, :, -1:].flip(1) - half.flip(1, 2)
        cumulative = _with_ghosts(_with_ghosts(torch.cat([half, opposite]), 1), 2)
        neighbours = cumulative[:, :, -2].unfold(1, 4, 1) / 2
        return cls(cumulative=cumulative, cubics=torch.einsum("ij,tcqj->tiqc", KEYS, neighbours))

    def whole(self, offset: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """Give the mean over whole chords and its slope in the offset.

        Args:
            offset: -1 to 1, from the left rim to the right one, [..., S].
            direction: of the motion, radians [..., 1].

        Returns:
            Colours and slopes [..., S, 3]; beyond the rim the colour is that of the rim.
        """
        if direction.numel() > 1:
            direction = direction.expand(*offset.shape[:-1], 1)
        cubics = _among_directions(self.cubics.to(offset), direction.flatten())
        # channels before samples: this runs for every sample in every step of the fit
        samples = offset.numel() // max(len(cubics), 1)
        cell, x, per_offset = _locate(offset.reshape(len(cubics), 1, samples), OFFSETS)
        near = cubics.flatten(1, 2).gather(2, cell.expand(-1, 12, -1))
        c0, c1, c2, c3 = near.reshape(len(cubics), 4, 3, samples).unbind(1)
        value = c0 + x * (c1 + x * (c2 + x * c3))
        slope = (c1 + x * (2 * c2 + x * (3 * c3))) * per_offset
        return value.mT.reshape(*offset.shape, 3), slope.mT.reshape(*offset.shape, 3)

    def part(
        self, offset: Tensor, direction: Tensor, start: float | Tensor, stop: float | Tensor
    ) -> Tensor:
        """Give the mean over parts of chords [..., S, 3].

        Args:
            offset: [..., S].
            direction: radians [..., 1].
            start: where the part begins, -1 the trailing rim, 1 the leading one; broadcast.
            stop: where it ends; the same as start gives the colour of that point.
        """
        if _ends_at_rim(start, stop):
            return self.part(-offset, direction + math.pi, -1.0, -start)
        row, x, _ = _locate(offset, OFFSETS)
        return self._over_part(row, _weights(x), direction, start, stop)

    def slope_of_part(
        self, offset: Tensor, direction: Tensor, start: float | Tensor, stop: float | Tensor
    ) -> Tensor:
        """Give the slope of `part` in the offset [..., S, 3]."""
        if _ends_at_rim(start, stop):
            return -self.slope_of_part(-offset, direction + math.pi, -1.0, -start)
        row, x, per_offset = _locate(offset, OFFSETS)
        across = _slopes(x) * per_offset[..., None]
        return self._over_part(row, across, direction, start, stop)

    def _over_part(
        self,
        row: Tensor,
        across: Tensor,
        direction: Tensor,
        start: float | Tensor,
        stop: float | Tensor,
    ) -> Tensor:
        """Average over parts with given weights of the four offsets from `row` on [..., S, 4]."""
        begin, end = (torch.as_tensor(place).to(across) for place in (start, stop))
        half = ((end - begin) / 2).abs().clamp(SHORTEST, 1)
        middle = torch.minimum(torch.maximum((begin + end) / 2, half - 1), 1 - half)
        total = self._until(middle + half, row, across, direction)
        if isinstance(start, Tensor) or start > -1:
            total = total - self._until(middle - half, row, across, direction)
        return total / (2 * half[..., None])

    def _until(self, place: Tensor, row: Tensor, across: Tensor, direction: Tensor) -> Tensor:
        """Integrate from the trailing rim to a place [..., S, 3].

        One direction for all is settled first; of several, each is found between its neighbours.
        """
        table = self.cumulative.to(across)
        index, share = _neighbouring_directions(direction)
        if direction.numel() == 1:
            table = _among_directions(table, direction.flatten())
            index, share = index.new_zeros(1, 1), share.new_ones(1, 1)
        column, y, _ = _locate(place, PLACES)
        weights = (across[..., None] * _weights(y)[..., None, :]).flatten(-2)
        step = torch.arange(4, device=across.device)
        corner = row * (PLACES + 2) + column
        cell = corner[..., None] + (step[:, None] * (PLACES + 2) + step).flatten()
        colours, size = table.flatten(0, 2), (OFFSETS + 2) * (PLACES + 2)
        terms = [
            share[..., k, None, None]
            * (weights[..., None, :] @ colours[cell + size * index[..., k, None]])
            for k in range(index.shape[-1])
        ]
        return torch.stack(terms).sum(0)[..., 0, :]


def _ends_at_rim(start: float | Tensor, stop: float | Tensor) -> bool:
    """Whether only the start cuts the chord: backwards, by the opposite motion, half the work."""
    return not isinstance(stop, Tensor) and stop >= 1 and (isinstance(start, Tensor) or start > -1)


def _weights(x: Tensor) -> Tensor:
    """Weights of the four neighbours [..., 4] at x = 0 to 1 between the middle two."""
    return torch.stack([torch.ones_like(x), x, x * x, x * x * x], dim=-1) @ KEYS.to(x)


def _slopes(x: Tensor) -> Tensor:
    """Derivative of `_weights`."""
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    return torch.stack([zero, one, 2 * x, 3 * x * x], dim=-1) @ KEYS.to(x)


def _locate(share: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Find -1 to 1 among places evenly spaced in angle: the cell, the place in it, its slope.

    The slope is zero beyond the rim, and at it, where it would be infinite.
    """
    inside = share.clamp(-1, 1)
    scale = (count - 1) / math.pi
    place = torch.asin(inside) * scale + (count - 1) / 2
    cell = place.detach().clamp(0, count - 1.5).long()
    height = (1 - inside * inside).clamp_min(0).sqrt()
    slope = torch.where(height > 0, scale / height.clamp_min(RIM), 0)
    return cell, place - cell, slope


def _neighbouring_directions(direction: Tensor) -> tuple[Tensor, Tensor]:
    """Give the four directions of the table about each, and their weights, both [..., 4]."""
    place = direction * (DIRECTIONS / (2 * math.pi))
    before = place.floor()
    near = before.long()[..., None] + torch.arange(-1, 3, device=direction.device)
    return near % DIRECTIONS, _weights(place - before)


def _among_directions(table: Tensor, direction: Tensor) -> Tensor:
    """Interpolate a table [T, ...] at directions [R]: [R, ...]."""
    index, weights = _neighbouring_directions(direction)
    mixing = table.new_zeros(len(direction), DIRECTIONS).scatter_(1, index, weights)
    return (mixing @ table.flatten(1)).reshape(-1, *table.shape[1:])


def _angles(count: int) -> Tensor:
    return torch.linspace(-math.pi / 2, math.pi / 2, count)


def _colours_along(
    ball: SharpBall, theta: Tensor, offset: Tensor, half_length: Tensor, place: Tensor
) -> Tensor:
    """Look up the disc's colours at every place of every chord, [T, O, L, 3]."""
    tangent = torch.stack([theta.cos(), theta.sin()], dim=-1)[:, None, None]
    normal = torch.stack([-theta.sin(), theta.cos()], dim=-1)[:, None, None]
    across, along = offset[:, None, None], half_length[:, None, None] * place[:, None]
    points = across * normal + along * tangent
    colours = torch.nn.functional.grid_sample(
        ball.rgb.float()[None],
        points.flatten(0, 1)[None],
        padding_mode="border",
        align_corners=True,
    )
    return colours[0].reshape(3, *points.shape[:-1]).movedim(0, -1)


def _with_ghosts(table: Tensor, dim: int) -> Tensor:
    """Lengthen a table by one place at either end, in the parabola of the outermost three."""
    first, last = (
        3 * (table.select(dim, a) - table.select(dim, b)) + table.select(dim, c)
        for a, b, c in ((0, 1, 2), (-1, -2, -3))
    )
    return torch.cat([first.unsqueeze(dim), table, last.unsqueeze(dim)], dim=dim)
