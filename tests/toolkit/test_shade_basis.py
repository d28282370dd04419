import math
from dataclasses import replace

import torch

from toolkit import Camera
from toolkit.shade_basis import facing_places, lamp_directions, lamp_light
from toolkit.synthetic import benchmark_scene, true_disc

CAMERA = Camera(width=2000, height=1500, fx=1800.0, fy=1800.0, cx=1000.0, cy=750.0)


def test_places_of_a_disc_seen_near_by_and_askew_have_the_normals_of_the_sphere():
    centre, radius = torch.tensor([0.5, -0.3, 1.0]).double(), 0.09
    scene = benchmark_scene(width_px=30, length_widths=2, size=(CAMERA.width, CAMERA.height))
    scene = replace(scene, ball_radius=radius, camera=CAMERA)
    disc = true_disc(scene, tuple(centre.tolist()))
    line = torch.linspace(-0.95, 0.95, 21, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1).reshape(-1, 2)
    place = place[torch.linalg.vector_norm(place, dim=-1) < 0.98]
    ray = CAMERA.unproject(disc.from_unit(place))
    along = ray @ centre
    depth = along - (along**2 - centre @ centre + radius**2).sqrt()
    normal = (depth[:, None] * ray - centre) / radius
    away = torch.nn.functional.normalize(centre, dim=0)
    right = torch.nn.functional.normalize(torch.eye(3).double()[0] - away[0] * away, dim=0)
    down = torch.linalg.cross(away, right)
    true = torch.stack([normal @ right, normal @ down], dim=-1)
    middle = disc.to_unit(CAMERA.project(centre[None]))
    near = torch.cat([radius / centre.norm()[None], middle[0]])
    found = facing_places(place, near)
    # all turned alike about the view, which a shade is free to be
    found, true, plain = (torch.view_as_complex(x.contiguous()) for x in (found, true, place))
    turn = (true * found.conj()).sum() / (found * found.conj()).sum()
    assert abs(abs(complex(turn)) - 1) < 1e-3
    assert float((turn * found - true).abs().max()) < 2e-3
    turn = (true * plain.conj()).sum() / (plain * plain.conj()).sum()
    assert float((turn * plain - true).abs().max()) > 0.02


def test_places_from_afar_stay():
    place = torch.tensor([[0.3, -0.5], [0.0, 0.99], [0.0, 0.0]]).double()
    assert torch.allclose(
        facing_places(place, torch.tensor([1e-6, 0, 0]).double()), place, atol=1e-5
    )


def test_lamps_lie_evenly_before_the_ball():
    lamps = lamp_directions()
    assert torch.allclose(lamps.norm(dim=-1), torch.ones(len(lamps)).double())
    assert (lamps[:, 2] < 0).all()
    nearest = (lamps @ lamps.mT - 2 * torch.eye(len(lamps))).amax(1).acos()
    spacing = math.sqrt(2 * math.pi / len(lamps))
    assert (nearest > 0.5 * spacing).all()
    assert (nearest < 1.5 * spacing).all()
    assert float(lamp_light(torch.zeros(1, 2).double(), lamps[:1])[0, 0]) == -float(lamps[0, 2]) / 2
