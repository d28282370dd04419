"""Mean colours along chords of a ball's disc, in a table made once.

Angles serve as coordinates: with offset = sin(phi) and place along the chord = sin(psi), the mean
colours of a matt ball, whose shade ends with a vertical slope at the rim, are smooth up to it.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from plugins.view_turn import change_of_look, to_angles
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
    beyond either end; C cells between neighbouring offsets. Four images follow one another: the
    colours, and their derivatives in the turn of the view, right and down, and in nearness.
    """

    cumulative: Tensor  # [4 T, O, L, 3] integral from the trailing rim, over the half length
    cubics: Tensor  # [4 T, 4, 3, C] in each cell, of the mean over the whole chord

    @classmethod
    def of(cls, ball: SharpBall) -> "RadonTable":
        """Integrate the colours of a sharp ball."""
        phi, psi = (_angles(count) for count in (OFFSETS, PLACES))
        theta = torch.arange(DIRECTIONS // 2) * (2 * math.pi / DIRECTIONS)
        places = _places_along(theta, phi.sin(), phi.cos(), psi.sin())
        by_angle = to_angles(places)
        right, down = (_look_up(image, by_angle) for image in change_of_look(ball))
        # a sharp picture sees each place along a ray of its own; a pixel of the streak sees all of
        # its chord along one ray, from which those of the picture are turned back and forth
        along = phi.cos()[:, None] * psi.sin()
        forward = theta.cos()[:, None, None, None] * right + theta.sin()[:, None, None, None] * down
        images = (_look_up(ball.rgb, places), right, down, -along[..., None] * forward)
        integrals = [_integrate(image, psi.sin()) for image in images]
        cumulative = _with_ghosts(_with_ghosts(torch.cat(integrals), 1), 2)
        neighbours = cumulative[:, :, -2].unfold(1, 4, 1) / 2
        return cls(cumulative=cumulative, cubics=torch.einsum("ij,tcqj->tiqc", KEYS, neighbours))

    def whole(
        self, offset: Tensor, direction: Tensor, turn: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Give the mean over whole chords and its slope in the offset.

        Args:
            offset: -1 to 1, from the left rim to the right one, [..., S].
            direction: of the motion, radians [..., 1].
            turn: of the view since the sharp picture, right and down, and the ball's own radius,
                radians [..., 1, 3].

        Returns:
            Colours and slopes [..., S, 3]; beyond the rim the colour is that of the rim.
        """
        if not _is_one(direction, turn):
            direction = direction.expand(*offset.shape[:-1], 1)
            turn = None if turn is None else turn.expand(*offset.shape[:-1], 1, -1)
        cubics = _mix(self.cubics, *_shares(direction, turn))
        # channels before samples: this runs for every sample in every step of the fit
        samples = offset.numel() // max(len(cubics), 1)
        cell, x, per_offset = _locate(offset.reshape(len(cubics), 1, samples), OFFSETS)
        near = cubics.flatten(1, 2).gather(2, cell.expand(-1, 12, -1))
        c0, c1, c2, c3 = near.reshape(len(cubics), 4, 3, samples).unbind(1)
        value = c0 + x * (c1 + x * (c2 + x * c3))
        slope = (c1 + x * (2 * c2 + x * (3 * c3))) * per_offset
        return value.mT.reshape(*offset.shape, 3), slope.mT.reshape(*offset.shape, 3)

    def part(
        self,
        offset: Tensor,
        direction: Tensor,
        start: float | Tensor,
        stop: float | Tensor,
        turn: Tensor | None = None,
    ) -> Tensor:
        """Give the mean over parts of chords [..., S, 3].

        Args:
            offset: [..., S].
            direction: radians [..., 1].
            start: where the part begins, -1 the trailing rim, 1 the leading one; broadcast.
            stop: where it ends; the same as start gives the colour of that point.
            turn: of the view, as in `whole`.
        """
        if _ends_at_rim(start, stop):
            return self.part(-offset, direction + math.pi, -1.0, -start, turn)
        row, x, _ = _locate(offset, OFFSETS)
        return self._over_part(row, _weights(x), self._seen(direction, turn), start, stop)

    def slope_of_part(
        self,
        offset: Tensor,
        direction: Tensor,
        start: float | Tensor,
        stop: float | Tensor,
        turn: Tensor | None = None,
    ) -> Tensor:
        """Give the slope of `part` in the offset [..., S, 3]."""
        if _ends_at_rim(start, stop):
            return -self.slope_of_part(-offset, direction + math.pi, -1.0, -start, turn)
        row, x, per_offset = _locate(offset, OFFSETS)
        across = _slopes(x) * per_offset[..., None]
        return self._over_part(row, across, self._seen(direction, turn), start, stop)

    def _seen(self, direction: Tensor, turn: Tensor | None) -> "_Seen":
        """Choose what is needed; for one direction and turn it is added up at once."""
        index, shares = _shares(direction, turn)
        if _is_one(direction, turn):
            table = _mix(self.cumulative, index, shares)
            return _Seen(table=table, index=index.new_zeros(1, 1), share=shares.new_ones(1, 1))
        used, index = _distinct(index)
        return _Seen(table=self.cumulative[used].to(shares), index=index, share=shares)

    def _over_part(
        self,
        row: Tensor,
        across: Tensor,
        seen: "_Seen",
        start: float | Tensor,
        stop: float | Tensor,
    ) -> Tensor:
        """Average over parts with given weights of the four offsets from `row` on [..., S, 4]."""
        begin, end = (torch.as_tensor(place).to(across) for place in (start, stop))
        half = ((end - begin) / 2).abs().clamp(SHORTEST, 1)
        middle = torch.minimum(torch.maximum((begin + end) / 2, half - 1), 1 - half)
        total = seen.until(middle + half, row, across)
        if isinstance(start, Tensor) or start > -1:
            total = total - seen.until(middle - half, row, across)
        return total / (2 * half[..., None])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """The K integrals whose sum each chord shows, out of U."""

    table: Tensor  # [U, O, L, 3]
    index: Tensor  # [..., 1, K]
    share: Tensor  # [..., 1, K]

    def until(self, place: Tensor, row: Tensor, across: Tensor) -> Tensor:
        """Integrate from the trailing rim to a place [..., S, 3]."""
        column, y, _ = _locate(place, PLACES)
        weights = (across[..., None] * _weights(y)[..., None, :]).flatten(-2)
        step = torch.arange(4, device=across.device)
        corner = row * (PLACES + 2) + column
        cell = corner[..., None] + (step[:, None] * (PLACES + 2) + step).flatten()
        colours, size = self.table.flatten(0, 2), (OFFSETS + 2) * (PLACES + 2)
        terms = [
            self.share[..., k, None, None]
            * (weights[..., None, :] @ colours[cell + size * self.index[..., k, None]])
            for k in range(self.index.shape[-1])
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


def _is_one(direction: Tensor, turn: Tensor | None) -> bool:
    return direction.numel() == 1 and (turn is None or turn.shape[:-1].numel() == 1)


def _shares(direction: Tensor, turn: Tensor | None) -> tuple[Tensor, Tensor]:
    """Say which rows of the table are seen and how much of each, both [..., 1, K].

    Args:
        direction: [..., 1].
        turn: [..., 1, 3]; None leaves the derivatives out.
    """
    index, weights = _neighbouring_directions(direction)
    if turn is None:
        return index, weights
    parts = turn.shape[-1]
    index = torch.cat([index + image * DIRECTIONS for image in range(1 + parts)], dim=-1)
    shares = [turn[..., part, None] * weights for part in range(parts)]
    return index, torch.cat([weights, *shares], dim=-1)


def _distinct(index: Tensor) -> tuple[Tensor, Tensor]:
    """Give the distinct numbers [U], rising, and where among them each one stands."""
    used = torch.bincount(index.flatten()).nonzero()[:, 0]
    return used, torch.searchsorted(used, index)


def _mix(table: Tensor, index: Tensor, shares: Tensor) -> Tensor:
    """Add up shares of a table's rows [..., 1, K]: [R, ...], in the shares' precision."""
    index, shares = index.flatten(0, -2), shares.flatten(0, -2)
    # of all rows a straight streak needs a few only
    used, where = _distinct(index)
    mixing = shares.new_zeros(len(index), len(used)).scatter_(1, where, shares)
    return (mixing @ table[used].to(shares).flatten(1)).reshape(len(index), *table.shape[1:])


def _angles(count: int) -> Tensor:
    return torch.linspace(-math.pi / 2, math.pi / 2, count)


def _places_along(theta: Tensor, offset: Tensor, half_length: Tensor, place: Tensor) -> Tensor:
    """Give every place of every chord on the unit disc, [T, O, L, 2]."""
    tangent = torch.stack([theta.cos(), theta.sin()], dim=-1)[:, None, None]
    normal = torch.stack([-theta.sin(), theta.cos()], dim=-1)[:, None, None]
    across, along = offset[:, None, None], half_length[:, None, None] * place[:, None]
    return across * normal + along * tangent


def _look_up(image: Tensor, places: Tensor) -> Tensor:
    """Look up an image [3, N, N] that spans -1 to 1 at places [T, O, L, 2]: [T, O, L, 3]."""
    colours = torch.nn.functional.grid_sample(
        image.float()[None],
        places.flatten(0, 1)[None],
        padding_mode="border",
        align_corners=True,
    )
    return colours[0].reshape(3, *places.shape[:-1]).movedim(0, -1)


def _integrate(colour: Tensor, place: Tensor) -> Tensor:
    """Integrate colours [T / 2, O, L, 3] from the trailing rim on, for all directions."""
    steps = (colour[:, :, 1:] + colour[:, :, :-1]) / 2 * place.diff()[:, None]
    half = torch.nn.functional.pad(steps, (0, 0, 1, 0)).cumsum(2)
    # the opposite motion runs along the same chords backwards, its left being our right
    opposite = half[:, :, -1:].flip(1) - half.flip(1, 2)
    return torch.cat([half, opposite])


def _with_ghosts(table: Tensor, dim: int) -> Tensor:
    """Lengthen a table by one place at either end, in the parabola of the outermost three."""
    first, last = (
        3 * (table.select(dim, a) - table.select(dim, b)) + table.select(dim, c)
        for a, b, c in ((0, 1, 2), (-1, -2, -3))
    )
    return torch.cat([first.unsqueeze(dim), table, last.unsqueeze(dim)], dim=dim)
