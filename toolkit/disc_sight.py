"""Where the pixels of a sharp ball look: blurred by lens and pixel, and cut off at its rim."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.rim import rim_radius

Places = tuple[Tensor, Tensor, Tensor]
"""Of pixels [G], on the unit disc [G, 2], and their weights [G]."""
FINE = 0.25
"""px between the places near the rim that a pixel's light is summed over."""
REACH = 3.5
"""Standard deviations of lens and pixel within which it sees anything."""


def look_places(place: Tensor, disc: Disc, spread: float) -> Places:
    """Give where pixels look: [G] pixel, places on the unit disc [G, 2] and weights [G]."""
    unit = disc.to_unit(place)
    away = (torch.linalg.vector_norm(unit, dim=-1) - 1) * disc.semi_axes[1]
    std = math.sqrt(spread + 1 / 12)
    near = away > -REACH * std
    inner, outer = (~near).nonzero()[:, 0], near.nonzero()[:, 0]
    inside = _inside(place[inner], std)
    rim = _rim(place[outer], unit[outer], disc, spread)
    index = torch.cat([inner[inside[0]], outer[rim[0]]])
    unit = disc.to_unit(torch.cat([inside[1], rim[1]]))
    weight = torch.cat([inside[2], rim[2]])
    length = torch.linalg.vector_norm(unit, dim=-1, keepdim=True)
    return index, unit / length.clamp_min(1), weight


def _inside(place: Tensor, std: float) -> tuple[Tensor, Tensor, Tensor]:
    """Five places about each pixel [P], as many times: exact to third order, and along x and y."""
    shift = torch.tensor([[0.0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]).double()
    weight = torch.tensor([2.0, 1, 1, 1, 1]).double() / 6
    points = place[:, None] + math.sqrt(3) * std * shift
    index = torch.arange(len(place))[:, None].expand(-1, 5)
    return index.flatten(), points.flatten(0, 1), weight.repeat(len(place))


def _rim(place: Tensor, unit: Tensor, disc: Disc, spread: float) -> tuple[Tensor, Tensor, Tensor]:
    """Places across the rim, as the lens and a square pixel weigh them, those on the ball alone."""
    std = math.sqrt(spread + 1 / 12)
    # the direction in which one leaves the disc fastest, and how fast
    ahead = unit @ (disc.to_unit(torch.eye(2).double()) - disc.to_unit(torch.zeros(2).double())).mT
    ahead = torch.nn.functional.normalize(ahead, dim=-1)
    beside = torch.stack([-ahead[:, 1], ahead[:, 0]], dim=-1)
    count = math.ceil((REACH * math.sqrt(spread) + 0.75) / FINE)
    x = torch.arange(-count, count + 1, dtype=torch.float64) * FINE
    weight = _kernel(x, ahead.abs().clamp_min(0.02), math.sqrt(spread))
    weight = weight / weight.sum(1, keepdim=True)
    step, share = torch.tensor([-1.0, 0, 1]).double(), torch.tensor([1.0, 4, 1]).double() / 6
    points = place[:, None, None] + x[:, None, None] * ahead[:, None, None]
    points = points + math.sqrt(3) * std * step[:, None] * beside[:, None, None]
    reach = torch.linalg.vector_norm(disc.to_unit(points), dim=-1)
    radius = rim_radius(disc, torch.atan2(unit[:, 1], unit[:, 0]))
    is_ball = ((1 - reach) * radius[:, None, None] / FINE + 0.5).clamp(0, 1)
    weight = weight[..., None] * share * is_ball
    index = torch.arange(len(place))[:, None, None].expand_as(weight)
    on = weight > 1e-7
    return index[on], points[on], weight[on]


def _kernel(x: Tensor, sides: Tensor, std: float) -> Tensor:
    """Density [P, X] of a square pixel, seen edge-on along a direction [P, 2], blurred."""
    a, b = (sides[:, i, None] / 2 for i in (0, 1))

    def ramp(at: Tensor) -> Tensor:
        z = at / std
        density = torch.exp(-0.5 * z * z) / math.sqrt(math.tau)
        value: Tensor = at * torch.special.ndtr(z) + std * density
        return value

    return (ramp(x + a + b) - ramp(x + a - b) - ramp(x - a + b) + ramp(x - a - b)).clamp_min(0)


def grown(disc: Disc, step: Tensor) -> Disc:
    """Move a disc by px, and add px to its shape: all round, along x, and along the diagonal."""
    x, y, all_round, along, diagonal = step.tolist()
    shape = disc.from_unit(torch.eye(2, dtype=torch.float64)) - torch.tensor(disc.centre).double()
    shape = shape + torch.tensor(
        [[all_round + along, diagonal], [diagonal, all_round - along]], dtype=torch.float64
    )
    lengths, turn = torch.linalg.eigh((shape + shape.mT) / 2)
    shorter, longer = lengths.tolist()
    return replace(
        disc,
        centre=(disc.centre[0] + x, disc.centre[1] + y),
        semi_axes=(longer, shorter),
        angle=math.atan2(float(turn[1, 1]), float(turn[0, 1])),
    )
