"""Mean light along the chords of a ball's disc that a pixel of the streak sees.

A pixel looks along one ray u while the ball moves by. On the ball that ray draws half a small
circle: at offset s to the right of the motion, and at x = -1 (trailing rim) to 1 along the chord,
it meets the surface where its normal is

    s right + sqrt(1 - s^2) (x ahead - sqrt(1 - x^2) u),

with `ahead` the motion's part across the ray and right = u x ahead; x is even in time. This is
exact for straight motion, wherever on the sensor and however near the ball is. [derived]
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from plugins.ball_light import BallLight
from toolkit import Camera, Chord, Disc

OFFSETS = 49
"""At which means over whole chords are found; between them they are interpolated."""
PLACES = 40
"""Along a chord, or a part of it."""
KEPT = 4096
"""Lines of sight whose means are kept: fits ask for the same ones at every step."""
NEAREST = 1e-4
"""Height of a chord, ball radii, below which its slope in the offset does not grow further."""
RIM = 0.05
"""The same where means are interpolated."""
KEYS = torch.tensor([[0.0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
"""From four neighbours to the coefficients of the cubic between the middle two, lowest first.

Source: Keys 1981, "Cubic convolution interpolation", with a = -1/2: smooth to the first derivative,
its error of third order.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChordMeans:
    """The light of a ball, averaged along chords."""

    light: BallLight
    camera: Camera | None
    disc: Disc
    kept: "_Kept" = field(default_factory=lambda: _Kept(), repr=False, compare=False)

    def part(self, chord: Chord) -> Tensor:
        """Give the mean over each chord, or the part of it between start and stop, [..., S, 3]."""
        offset = chord.offset
        low, high = (
            torch.as_tensor(end).to(offset).clamp(-1, 1).asin() for end in (chord.start, chord.stop)
        )
        node, weight = _gauss(offset)
        angle = (low + high)[..., None] / 2 + (high - low)[..., None] / 2 * node
        weight = weight * angle.cos() + 1e-9
        light = self._along(chord, offset, angle)
        weight = weight.expand(light.shape[:-1])
        return (weight[..., None] * light).sum(-2) / weight.sum(-1, keepdim=True)

    def whole(self, chord: Chord) -> tuple[Tensor, Tensor]:
        """Give the mean over whole chords and its slope in the offset, both [..., S, 3].

        Beyond the rim they are those at the rim. In the angle whose sine is the offset, means of a
        matt ball are smooth up to it.
        """
        shape, offset = chord.offset.shape, chord.offset
        cubics, where = self._cubics(chord)
        cell, x, per_offset = _locate(offset.reshape(len(where), 1, shape[-1]))
        # channels before samples: this runs for every sample in every step of a fit
        near = cubics[where].flatten(1, 2).gather(2, cell.expand(-1, 12, -1))
        c0, c1, c2, c3 = near.reshape(len(where), 4, 3, shape[-1]).unbind(1)
        value = c0 + x * (c1 + x * (c2 + x * c3))
        slope = (c1 + x * (2 * c2 + x * (3 * c3))) * per_offset
        return value.mT.reshape(*shape, 3), slope.mT.reshape(*shape, 3)

    def _cubics(self, chord: Chord) -> tuple[Tensor, Tensor]:
        """Give cubics between nodes of the offset [K, 4, 3, OFFSETS - 1], and each row's number."""
        rows = chord.offset.shape[:-1]
        key = chord.direction.expand(*rows, 1).to(chord.offset)
        if chord.place is not None:
            key = torch.cat([key, chord.place.expand(*rows, 1, 2)[..., 0, :].to(key)], dim=-1)
        key = key.reshape(rows.numel(), key.shape[-1])
        if chord.direction.numel() == 1 and (chord.place is None or chord.place.numel() == 2):
            key = key[:1]
        where = self.kept.find(key, self._new_cubics)
        return self.kept.cubics, where.expand(rows.numel())

    def _new_cubics(self, key: Tensor) -> Tensor:
        phi = torch.linspace(-math.pi / 2, math.pi / 2, OFFSETS).to(key)
        line = Chord(
            offset=phi.sin().expand(len(key), -1),
            direction=key[:, :1],
            place=key[:, None, 1:] if key.shape[1] == 3 else None,
        )
        means = self.part(line)
        first, last = (
            3 * (means[:, a] - means[:, b]) + means[:, c] for a, b, c in ((0, 1, 2), (-1, -2, -3))
        )
        means = torch.cat([first[:, None], means, last[:, None]], dim=1)
        return torch.einsum("ij,rcqj->riqc", KEYS.to(means), means.unfold(1, 4, 1))

    def _along(self, chord: Chord, offset: Tensor, angle: Tensor) -> Tensor:
        """Give the light at angles along each chord [..., S, L, 3]."""
        ray, ahead = (v.to(offset) @ self.light.axes.mT.to(offset) for v in self._frame(chord))
        right = torch.linalg.cross(ray, ahead, dim=-1)
        inside = offset.clamp(-1, 1)
        height = (1 - inside * inside).clamp_min(NEAREST**2).sqrt()
        normal = (inside[..., None] * right)[..., None, :] + height[..., None, None] * (
            angle.sin()[..., None] * ahead[..., None, :]
            - angle.cos()[..., None] * ray[..., None, :]
        )
        return self.light.at(normal)

    def _frame(self, chord: Chord) -> tuple[Tensor, Tensor]:
        """Give the ray along which each chord is seen and the motion across it, [..., S, 3]."""
        if chord.ray is not None and chord.ahead is not None:
            return chord.ray, chord.ahead
        middle, ahead = self._middle(chord)
        right = torch.linalg.cross(middle, ahead, dim=-1)
        # its chords are seen along rays beside that of the ball's middle
        sine = (chord.offset.clamp(-1, 1) * self.light.sine)[..., None]
        ray = (1 - sine * sine).sqrt() * middle + sine * right
        return ray, ahead.expand_as(ray)

    def _middle(self, chord: Chord) -> tuple[Tensor, Tensor]:
        """Give the ray of the ball's middle and the motion across it, [..., 1, 3]."""
        step = torch.stack([chord.direction.cos(), chord.direction.sin()], dim=-1).double()
        if self.camera is None:
            right, down, away = self.light.axes
            return away.expand(*step.shape[:-1], 3), step[..., :1] * right + step[..., 1:] * down
        place = chord.place
        if place is None:
            place = torch.tensor(self.disc.centre)
        place = place.double().expand(*step.shape[:-1], 2)
        flat = place.reshape(-1, 2)
        ray, J_ray = self.camera.unproject_and_J(flat)
        ahead = torch.nn.functional.normalize((J_ray @ step.reshape(-1, 2, 1))[..., 0], dim=-1)
        ray = ray.reshape(*step.shape[:-1], 3)
        return ray, ahead.reshape(*step.shape[:-1], 3)


@dataclass(slots=True)
class _Kept:
    """Cubics of lines of sight that were asked for before."""

    key: Tensor | None = None
    cubics: Tensor = field(default_factory=lambda: torch.zeros(0))

    def find(self, key: Tensor, make: Callable[[Tensor], Tensor]) -> Tensor:
        """Give the places [R] of keys [R, D] among those kept, made where they are new."""
        kept = self.key
        if kept is None or kept.shape[1] != key.shape[1] or kept.dtype != key.dtype:
            kept = None
        if kept is None or len(kept) + len(key) > KEPT:
            self.key, self.cubics = key, make(key)
            return torch.arange(len(key))
        same = (key[:, None] == kept).all(-1)
        is_new = ~same.any(-1)
        if bool(is_new.any()):
            self.cubics = torch.cat([self.cubics, make(key[is_new])])
            self.key = torch.cat([kept, key[is_new]])
            same = (key[:, None] == self.key).all(-1)
        return same.to(torch.int8).argmax(-1)


def _gauss(like: Tensor) -> tuple[Tensor, Tensor]:
    """Give nodes on -1 to 1 and their weights [PLACES]."""
    node, weight = np.polynomial.legendre.leggauss(PLACES)
    return torch.from_numpy(node).to(like), torch.from_numpy(weight).to(like)


def _locate(share: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Find -1 to 1 among places evenly spaced in angle: the cell, the place in it, its slope.

    The slope is zero beyond the rim, and at it, where it would be infinite.
    """
    inside = share.clamp(-1, 1)
    scale = (OFFSETS - 1) / math.pi
    place = torch.asin(inside) * scale + (OFFSETS - 1) / 2
    cell = place.detach().clamp(0, OFFSETS - 1.5).long()
    height = (1 - inside * inside).clamp_min(0).sqrt()
    slope = torch.where(height > 0, scale / height.clamp_min(RIM), 0)
    return cell, place - cell, slope
