import math
from dataclasses import dataclass

import pytest
import torch

from toolkit import AlphaEstimator, Camera
from toolkit.sweep.chord_table import Nodes, Rows, between, between_parts
from toolkit.sweep.paths import Arcs

CAMERA = Camera.centred(400, 300, 300.0, distortion=(-0.1, 0.02, 0.0, 0.0))
RADIUS = 0.05
TIME = torch.linspace(-0.5, 0.5, 9, dtype=torch.float64)


def arcs(c2=(0.0, 0.0, 0.0)):
    """At 15 R, half across the view and half towards the viewer."""
    coefficients = torch.tensor([[[0.1, -0.05, 0.75], [0.3, 0.1, -0.3], c2]], dtype=torch.float64)
    return Arcs(coefficients=coefficients, joints=torch.zeros(0), J=torch.eye(9)[None].double())


@dataclass(frozen=True, kw_only=True)
class Lamp(AlphaEstimator):
    """Its light is (offset + 2) (3 + place on the chord), with the ray's part to the right."""

    def observe(self, image, background, noise):
        raise NotImplementedError  # no picture is looked at here

    def foreground(self, chord, appearance):
        middle = (torch.as_tensor(chord.start) + torch.as_tensor(chord.stop)) / 2
        light = (chord.offset + 2) * (3 + middle)
        return torch.stack([light, 1 + chord.ray[..., 0].expand_as(light)], dim=-1)


@pytest.mark.parametrize("c2", [(0.0, 0.0, 0.0), (0.0, 0.05, 0.0)])
def test_rays_pass_the_ball_at_their_offset_when_it_is_nearest(c2):
    path = arcs(c2)
    nodes = Nodes.of(TIME, path, CAMERA, RADIUS, 9)
    centre, velocity = path.at(TIME)
    beside = centre[:, None] - (centre[:, None] * nodes.ray).sum(-1, keepdim=True) * nodes.ray
    assert (beside * velocity[:, None]).sum(-1).abs().max() < 1e-12
    right = torch.linalg.cross(nodes.ray, nodes.ahead, dim=-1)
    assert (beside + nodes.offset[..., None] * RADIUS * right).norm(dim=-1).max() < 1e-12
    assert (nodes.ray.norm(dim=-1) - 1).abs().max() < 1e-12
    across = velocity[:, None] - (velocity[:, None] * nodes.ray).sum(-1, keepdim=True) * nodes.ray
    assert (nodes.ahead - across / across.norm(dim=-1, keepdim=True)).abs().max() < 1e-12
    assert torch.allclose(nodes.place[:, 0], CAMERA.project(centre))


def test_a_ball_that_comes_straight_on_has_rays_all_the_same():
    coefficients = torch.tensor([[[0.0, 0.0, 0.75], [0.0, 0.0, -0.1], [0.0] * 3]]).double()
    path = Arcs(coefficients=coefficients, joints=torch.zeros(0), J=torch.eye(9)[None].double())
    nodes = Nodes.of(TIME, path, CAMERA, RADIUS, 9)
    for part in (nodes.ray, nodes.ahead, nodes.place, nodes.direction):
        assert torch.isfinite(part).all()


def some(count=200):
    generator = torch.Generator().manual_seed(1)
    instant, offset, one, other = torch.rand(4, count, generator=generator).double() * 2 - 1
    rows = Rows.about(instant / 2, -0.5, 0.5, 8)
    return rows, offset.asin(), torch.minimum(one, other), torch.maximum(one, other)


def test_whole_chords_are_interpolated_across_and_along_the_path():
    rows, angle, _, _ = some()
    nodes = Nodes.of(rows.time, arcs(), CAMERA, RADIUS, 49)
    table = nodes.whole(Lamp(), [None])[..., 0]
    assert table.shape == (9, 51, 2)
    value, by_angle, by_time = between(table, rows, angle)
    time = rows.time[rows.index] + rows.share / 8
    near = ((angle + math.pi / 2) / math.pi * 480).round().long()
    own = Nodes.of(time, arcs(), CAMERA, RADIUS, 481)
    assert (value[:, 0] - 3 * (angle.sin() + 2)).abs().max() < 1e-4
    assert (by_angle[:, 0] - 3 * angle.cos()).abs().max() < 1e-2
    assert by_time[:, 0].abs().max() < 1e-9
    seen = 1 + own.ray[torch.arange(len(near)), near, 0]
    assert (value[:, 1] - seen).abs().max() < 0.003
    step = 1e-4
    later = Nodes.of(time + step, arcs(), CAMERA, RADIUS, 481)
    rise = (later.ray - own.ray)[torch.arange(len(near)), near, 0] / step
    assert (by_time[:, 1] - rise).abs().max() < 0.05 * rise.abs().max()


def test_parts_of_chords_are_interpolated():
    rows, angle, start, stop = some()
    chosen = rows.chosen(torch.arange(len(angle)))
    table = Nodes.of(chosen.time, arcs(), CAMERA, RADIUS, 33).integrals(Lamp(), [None])[..., 0]
    assert table.shape == (9, 35, 19, 2)

    def light(angle, start, stop):
        return (angle.sin() + 2) * (3 + (start + stop) / 2)

    value, by_angle, by_start, by_stop = between_parts(table, chosen, angle, start, stop)
    is_long = stop - start > 0.3
    error = (value[:, 0] - light(angle, start, stop)).abs()
    assert error[is_long].max() < 0.02
    assert (by_angle[:, 0] - angle.cos() * (3 + (start + stop) / 2)).abs()[is_long].max() < 0.05
    for slope in (by_start, by_stop):
        assert (slope[:, 0] - (angle.sin() + 2) / 2).abs()[is_long].max() < 0.2
    # shorter parts are lengthened
    assert error.max() < 0.1


def test_only_the_rows_that_pixels_need_are_asked_for():
    rows, _, _, _ = some()
    ends = (rows.index == 0).nonzero()[:, 0]
    chosen = rows.chosen(ends)
    assert torch.equal(chosen.time, rows.time[:2])
    assert torch.equal(chosen.share, rows.share[ends])
    both = rows.chosen(((rows.index == 0) | (rows.index == 6)).nonzero()[:, 0])
    assert torch.equal(both.time, rows.time[[0, 1, 6, 7]])
    assert set(both.index.tolist()) == {0, 2}
