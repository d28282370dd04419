"""The light that each part of a ball's surface sends, while lamp and room stay where they are.

A sharp picture tells it for the part that faces the camera there; a ball seen along another ray
shows another part. A matt surface sends the same light every way, so that it is enough to know
which normal is seen where. A glossy highlight follows the view by half its turn, which one picture
alone does not tell from shading: it is held on the surface.

What the sharp picture does not show is continued from its rim, as a linear function of the normal
fitted there: a matt ball before one distant lamp, in a room of even light, is one. [derived]
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit import Camera, Disc, SharpBall

NODES = 321
"""Along a side of the chart."""
ERROR_NODES = 129
"""The same of errors of the light."""
WIDEST = 1.8
"""Half its side: normals up to 122 degrees from those that face the camera."""
RIM = 0.999
"""Share of the disc's radius within which its light is taken as it is."""
AZIMUTHS = 96
"""About the disc, at which its light is continued."""
RIDGE = 1e-4
"""Squared noise over light, about: what it takes to tell the four numbers of a fit apart."""
REACH = math.radians(15)
"""Standard deviation of the angle from there of what is fitted."""
STRIDE = 8
"""Of the nodes that the fits look at."""
BLOCK, WITHIN = 3, 0.9
"""Nodes along the side of blocks whose noise is compared, and how near to the rim, radii."""
FEWEST = 33
"""Nodes along a side from which it is: sharp pictures have 65 or more."""
HALF_OF_NORMAL = 0.6745
"""Standard deviations within which half of normally spread numbers lie."""
FADING = math.radians(10)
"""Angle beyond the rim over which what the fit misses there fades."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallLight:
    """Light by the normal of the surface.

    The chart is stereographic about the normal that faced the camera: smooth up to the rim of the
    disc and beyond, at the same scale every way, and found without any angle.
    """

    chart: Tensor  # [1, C, nodes, nodes] over -WIDEST to WIDEST
    axes: Tensor  # [3, 3] right, down and away in the view of the sharp picture, as rows
    sine: float  # of the angle under which the ball's radius was seen there, 0 from afar

    @classmethod
    def of(cls, ball: SharpBall, camera: Camera | None = None) -> "BallLight":
        """Lay a sharp picture's light out on the ball; without a camera, as if seen from afar."""
        picture = _Picture.of(ball, ball.rgb, camera)
        chart = picture.laid_out(NODES).clamp_min(0)
        return cls(chart=chart, axes=picture.axes, sine=picture.sine)

    @classmethod
    def of_errors(cls, ball: SharpBall, errors: Tensor, camera: Camera | None) -> "BallLight":
        """Lay out errors of its light [C, N, N], which may be negative; they are smooth."""
        picture = _Picture.of(ball, errors, camera)
        chart = picture.laid_out(ERROR_NODES).float()
        return cls(chart=chart, axes=picture.axes, sine=picture.sine)

    def at(self, normal: Tensor) -> Tensor:
        """Give the light at unit normals [..., 3] along the axes, [..., C]."""
        place = normal[..., :2] / ((1 - normal[..., 2:]).clamp_min(0.1) * WIDEST)
        light = torch.nn.functional.grid_sample(
            self.chart.to(normal),
            place.reshape(1, 1, -1, 2),
            padding_mode="border",
            align_corners=True,
        )
        return light[0, :, 0].mT.reshape(*normal.shape[:-1], self.chart.shape[1])


def picture_noise(ball: SharpBall) -> tuple[float, ...]:
    """Give the noise of a sharp picture's light in each channel, a node's if it were white.

    It is what differs from block to block of nodes otherwise than a smooth shade does: their fourth
    differences.
    """
    if ball.rgb.shape[-1] < FEWEST:
        return (0.0,) * len(ball.rgb)
    blocks = torch.nn.functional.avg_pool2d(ball.rgb.double()[None], BLOCK)[0]
    line = torch.linspace(-1, 1, ball.rgb.shape[-1], dtype=torch.float64)
    middle = torch.nn.functional.avg_pool1d(line[None, None], BLOCK)[0, 0]
    found = []
    for light in (blocks, blocks.mT):
        windows = light.unfold(-1, 5, 1)
        change = windows @ torch.tensor([1.0, -4, 6, -4, 1], dtype=torch.float64) / math.sqrt(70)
        is_inside = torch.hypot(middle[:, None], middle.unfold(0, 5, 1).abs().amax(-1)) < WITHIN
        found.append(change[:, is_inside])
    change = torch.cat(found, dim=1)
    return tuple((change.abs().median(1).values / HALF_OF_NORMAL * BLOCK).tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Picture:
    """A sharp picture of the ball, and how it was seen."""

    disc: Disc
    light: Tensor  # [C, N, N] over it
    camera: Camera | None
    axes: Tensor
    sine: float

    @classmethod
    def of(cls, ball: SharpBall, light: Tensor, camera: Camera | None) -> "_Picture":
        """Find the axes of the view of a disc, and the sine of the angle of its radius."""
        axes, sine = torch.eye(3, dtype=torch.float64), 0.0
        if camera is not None:
            rim = camera.unproject(ball.disc.from_unit(_circle()))
            rim = rim[torch.isfinite(rim).all(-1)]
            # all rays of the outline are inclined alike to that of the middle
            ones = torch.ones(len(rim), 1, dtype=torch.float64)
            axis = torch.linalg.lstsq(rim, ones).solution[:, 0]
            length = float(torch.linalg.vector_norm(axis))
            away = axis / length
            right = torch.nn.functional.normalize(axes[0] - away[0] * away, dim=0)
            axes = torch.stack([right, torch.linalg.cross(away, right), away])
            sine = math.sqrt(max(1 - 1 / length**2, 1e-12))
        return cls(disc=ball.disc, light=light.double(), camera=camera, axes=axes, sine=sine)

    def at(self, normal: Tensor) -> tuple[Tensor, Tensor]:
        """Give the light seen where the surface has normals [..., 3], and whether it is seen."""
        if self.camera is None:
            place = normal[..., :2]
        else:
            middle = torch.tensor([0.0, 0.0, 1 / self.sine], dtype=torch.float64)
            pixel = self.camera.project((middle + normal) @ self.axes)
            place = torch.nan_to_num(self.disc.to_unit(pixel), nan=9.0)
        light = torch.nn.functional.grid_sample(
            self.light[None],
            place.reshape(1, 1, -1, 2),
            padding_mode="border",
            align_corners=True,
        )[0, :, 0]
        # the tangents from the viewer touch the ball this far from its middle
        is_seen = (torch.linalg.vector_norm(place, dim=-1) <= RIM) & (-normal[..., 2] > self.sine)
        return light.mT.reshape(*normal.shape[:-1], -1), is_seen

    def laid_out(self, nodes: int) -> Tensor:
        """Give a chart of the light, continued to what is not seen, [1, C, nodes, nodes]."""
        line = torch.linspace(-WIDEST, WIDEST, nodes, dtype=torch.float64)
        normal = _normals(torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1))
        light, is_seen = self.at(normal)
        light[~is_seen] = _continued(self, normal[is_seen], light[is_seen], normal[~is_seen])
        return light.movedim(-1, 0)[None].contiguous()


def _circle() -> Tensor:
    turn = torch.arange(AZIMUTHS, dtype=torch.float64) * (2 * math.pi / AZIMUTHS)
    return torch.stack([turn.cos(), turn.sin()], dim=-1)


def _normals(place: Tensor) -> Tensor:
    """Give the unit normal at each place of the chart [..., 2]: [..., 3] along the axes."""
    square = (place * place).sum(-1, keepdim=True)
    return torch.cat([2 * place, square - 1], dim=-1) / (1 + square)


def _continued(picture: _Picture, known: Tensor, light: Tensor, hidden: Tensor) -> Tensor:
    """Continue the light known at normals [K, 3] to hidden ones [H, 3]: [H, 3]."""
    widest = float(torch.acos((-known[:, 2]).clamp(-1, 1)).max())
    circle = _circle()
    rim = torch.cat(
        [circle * math.sin(widest), torch.full_like(circle[:, :1], -math.cos(widest))], dim=-1
    )
    known, light = known[::STRIDE], light[::STRIDE]
    weight = torch.exp(-0.5 * (torch.acos((rim @ known.mT).clamp(-1, 1)) / REACH) ** 2)
    basis = _with_one(known)
    equations = torch.einsum("an,ni,nj->aij", weight, basis, basis)
    equations += RIDGE * torch.eye(4, dtype=torch.float64)
    fit = torch.linalg.solve(equations, torch.einsum("an,ni,nc->aic", weight, basis, light))
    miss = picture.at(rim)[0][:, None] - _with_one(rim)[:, None] @ fit
    azimuth = torch.atan2(hidden[:, 1], hidden[:, 0]) * (AZIMUTHS / (2 * math.pi))
    low = azimuth.floor()
    before, after, share = low.long() % AZIMUTHS, (low.long() + 1) % AZIMUTHS, azimuth - low
    fit, miss = (
        table[before] + share[:, None, None] * (table[after] - table[before])
        for table in (fit, miss)
    )
    beyond = torch.acos((-hidden[:, 2]).clamp(-1, 1)) - widest
    fading = torch.exp(-beyond.clamp_min(0) / FADING)[:, None]
    found: Tensor = (_with_one(hidden)[:, None] @ fit + fading[..., None] * miss)[:, 0]
    return found


def _with_one(normal: Tensor) -> Tensor:
    return torch.cat([torch.ones_like(normal[:, :1]), normal], dim=-1)
