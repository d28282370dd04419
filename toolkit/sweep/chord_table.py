"""What an estimator says of the ball, asked at nodes along and across the streak, and in between.

Nodes across are even in the angle whose sine is the chord's offset, those along a chord in the
angle whose sine is the place on it: so the means of a shaded ball are smooth up to its rim. Means
over parts of chords come from their integrals from the trailing rim on. [derived]
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.alpha import AlphaEstimator, Chord
from toolkit.camera import Camera
from toolkit.sweep.paths import Arcs

WHOLE, PARTS, PLACES = 49, 33, 17
"""Nodes across the streak, those where chords are cut, and those along a cut chord."""
SHORTEST = 0.04
"""Shares of half a chord to which shorter parts are lengthened."""
STEEPEST = 0.05
"""Height, ball radii, of chords and their ends below which slopes do not grow further."""
LEANING = 0.9
"""Sine of the angle by which pixels that see the ball at once may lean to the motion, at most."""
KEYS = torch.tensor([[0.0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]).double() / 2
"""From four neighbours to the coefficients of the cubic between the middle two, lowest first.

Source: Keys 1981, "Cubic convolution interpolation", with a = -1/2.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """T instants of a path and where between two of them M pixels lie."""

    time: Tensor  # [T] exposures, even
    index: Tensor  # [M] of the one before
    share: Tensor  # [M] of the way to the next

    @classmethod
    def about(cls, instant: Tensor, first: float, last: float, count: int) -> "Rows":
        """Lay out rows over a span, for instants within it."""
        time = torch.linspace(first, last, count + 1, dtype=torch.float64)
        place = (instant.clamp(first, last) - first) / (last - first) * count
        index = place.long().clamp(0, count - 1)
        return cls(time=time, index=index, share=place - index)

    def chosen(self, pixels: Tensor) -> "Rows":
        """Give those that some of the pixels need."""
        index, share = self.index[pixels], self.share[pixels]
        used, where = torch.unique(torch.cat([index, index + 1]), return_inverse=True)
        before = where[: len(pixels)]
        # instants left out in between leave those that follow one another side by side
        return Rows(time=self.time[used], index=before, share=share)

    @property
    def step(self) -> float:
        """Exposures from one row to the next."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Nodes:
    """Chords at S offsets for each of T instants."""

    offset: Tensor  # [T, S]
    direction: Tensor  # [T, 1]
    place: Tensor  # [T, 1, 2]
    ray: Tensor  # [T, S, 3]
    ahead: Tensor  # [T, S, 3]

    @classmethod
    def of(
        cls, time: Tensor, arcs: Arcs, camera: Camera, ball_radius: float, count: int
    ) -> "Nodes":
        """Find the rays that pass the ball at each offset when it is nearest to them.

        These do not lie straight across the motion where that comes or goes: at an angle b beside
        the centre they lean ahead by the angle whose sine is tan b times the motion's part along
        the ray over its part across.
        """
        centre, velocity = arcs.at(time)
        x, y = (camera.J_project(centre) @ velocity[..., None])[..., 0].mT
        distance = torch.linalg.vector_norm(centre, dim=-1, keepdim=True)
        view = centre / distance
        along = (velocity * view).sum(-1, keepdim=True)
        across = velocity - along * view
        speed = torch.linalg.vector_norm(across, dim=-1, keepdim=True).clamp_min(1e-12)
        ahead = across / speed
        right = torch.linalg.cross(view, ahead, dim=-1)
        offset = _angles(count).sin().expand(len(time), -1)
        sine = (offset * ball_radius / distance).clamp(-0.99, 0.99)[..., None]
        cosine = (1 - sine * sine).sqrt()
        lean = (sine / cosine * (along / speed)[:, None]).clamp(-LEANING, LEANING)
        beside = lean * ahead[:, None] + (1 - lean * lean).sqrt() * right[:, None]
        ray = cosine * view[:, None] + sine * beside
        motion = velocity[:, None] - (velocity[:, None] * ray).sum(-1, keepdim=True) * ray
        return cls(
            offset=offset,
            direction=torch.atan2(y, x)[:, None],
            place=camera.project(centre)[:, None],
            ray=ray,
            ahead=torch.nn.functional.normalize(motion, dim=-1),
        )

    def whole(self, estimator: AlphaEstimator, looks: list[Tensor | None]) -> Tensor:
        """Ask for whole chords, for each of some looks: [T, S + 2, Q, len(looks)]."""
        chord = Chord(
            offset=self.offset,
            direction=self.direction,
            place=self.place,
            ray=self.ray,
            ahead=self.ahead,
        )
        values = [estimator.foreground(chord, look).double() for look in looks]
        return _with_ghosts(torch.stack(values, dim=-1), 1)

    def integrals(self, estimator: AlphaEstimator, looks: list[Tensor | None]) -> Tensor:
        """Ask for integrals from the trailing rim: [T, S + 2, PLACES + 2, Q, len(looks)]."""
        stop = _angles(PLACES).sin()
        size = (*self.offset.shape, PLACES)

        def spread(values: Tensor) -> Tensor:
            return values[:, :, None].expand(*size, 3).flatten(1, 2)

        chord = Chord(
            offset=self.offset[..., None].expand(size).flatten(1),
            direction=self.direction,
            place=self.place,
            ray=spread(self.ray),
            ahead=spread(self.ahead),
            stop=stop.expand(size).flatten(1),
        )
        values = [estimator.foreground(chord, look).double() for look in looks]
        means = torch.stack(values, dim=-1)
        means = means.reshape(*size, *means.shape[2:])
        return _with_ghosts(_with_ghosts(means * (stop + 1)[:, None, None], 1), 2)


def between(table: Tensor, rows: Rows, angle: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Interpolate in a table of whole chords [T, S + 2, C], at angles [M] across.

    Returns:
        Values [M, C], their derivatives in the angle and in time.
    """
    near, share, per_angle = _locate(angle, table.shape[1] - 2)
    cells = rows.index[:, None] * table.shape[1] + near
    flat = table.flatten(0, 1)
    before, after = flat[cells], flat[cells + table.shape[1]]
    rise = after - before
    seen = before + rows.share[:, None, None] * rise
    weights, slopes = _weights(share), _slopes(share) * per_angle
    return (
        (weights[..., None] * seen).sum(1),
        (slopes[..., None] * seen).sum(1),
        (weights[..., None] * rise).sum(1) / rows.step,
    )


def between_parts(
    table: Tensor, rows: Rows, angle: Tensor, start: Tensor, stop: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Interpolate in a table of integrals [T, S + 2, L + 2, C], for parts of chords [M].

    Returns:
        Mean values [M, C], their derivatives in the angle across, in start and in stop.
    """
    half = ((stop.clamp(-1, 1) - start.clamp(-1, 1)) / 2).clamp_min(SHORTEST / 2)
    middle = (stop.clamp(-1, 1) + start.clamp(-1, 1)) / 2
    middle = torch.minimum(torch.maximum(middle, half - 1), 1 - half)
    length = 2 * half[:, None]
    high, high_across, high_along = _integral(table, rows, angle, middle + half)
    low, low_across, low_along = _integral(table, rows, angle, middle - half)
    mean = (high - low) / length
    by_stop = (high_along - mean) / length * (stop.abs() < 1)[:, None]
    by_start = (mean - low_along) / length * (start.abs() < 1)[:, None]
    return mean, (high_across - low_across) / length, by_start, by_stop


def _integral(
    table: Tensor, rows: Rows, angle: Tensor, place: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Give integrals up to places on chords [M, C], their slopes across in angle, and along."""
    _, offsets, places, _ = table.shape
    psi = place.clamp(-1, 1).asin()
    across, share, per_angle = _locate(angle, offsets - 2)
    along, part, per_psi = _locate(psi, places - 2)
    cells = (rows.index[:, None, None] * offsets + across[..., None]) * places + along[:, None]
    flat = table.flatten(0, 2)
    seen = flat[cells]
    seen = seen + rows.share[:, None, None, None] * (flat[cells + offsets * places] - seen)
    weights, slopes = _weights(part), _slopes(part) * per_psi
    upwards = slopes / psi.cos().clamp_min(STEEPEST)[:, None]
    value = (weights[:, None, :, None] * seen).sum(2)
    rise = (upwards[:, None, :, None] * seen).sum(2)
    over, tilt = _weights(share)[..., None], (_slopes(share) * per_angle)[..., None]
    return (over * value).sum(1), (tilt * value).sum(1), (over * rise).sum(1)


def _angles(count: int) -> Tensor:
    return torch.linspace(-math.pi / 2, math.pi / 2, count, dtype=torch.float64)


def _locate(angle: Tensor, count: int) -> tuple[Tensor, Tensor, float]:
    """Find angles [M] among `count` even ones: four neighbours [M, 4], the place, its slope."""
    scale = (count - 1) / math.pi
    place = (angle + math.pi / 2) * scale
    cell = place.long().clamp(0, count - 2)
    return cell[:, None] + torch.arange(4), place - cell, scale


def _weights(x: Tensor) -> Tensor:
    """Weights of the four neighbours [M, 4] at x = 0 to 1 between the middle two."""
    return torch.stack([torch.ones_like(x), x, x * x, x * x * x], dim=-1) @ KEYS


def _slopes(x: Tensor) -> Tensor:
    """Derivative of `_weights`."""
    return torch.stack([torch.zeros_like(x), torch.ones_like(x), 2 * x, 3 * x * x], dim=-1) @ KEYS


def _with_ghosts(table: Tensor, dim: int) -> Tensor:
    """Lengthen a table by one place at either end, in the parabola of the outermost three."""
    first, last = (
        3 * (table.select(dim, a) - table.select(dim, b)) + table.select(dim, c)
        for a, b, c in ((0, 1, 2), (-1, -2, -3))
    )
    return torch.cat([first.unsqueeze(dim), table, last.unsqueeze(dim)], dim=dim)
