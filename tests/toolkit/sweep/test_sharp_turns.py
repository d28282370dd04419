"""Arcs whose velocity changes much while the ball crosses a ray, against sharp images."""

import functools
from dataclasses import replace

import pytest
import torch

from toolkit.camera import Camera
from toolkit.sweep.opacity import arc_opacity
from toolkit.sweep.paths import PARABOLA
from toolkit.sweep.rays import RayGrid
from toolkit.sweep.sharp_turns import opacity_parts
from toolkit.synthetic import ParabolicPath, PlainBall, benchmark_scene, render_shot

FLIGHTS = {  # velocity at first, and acceleration: right and down, ball radii an exposure
    "a throw straight up": ((0.0, -6.0), (0.0, 12.0)),
    "a throw to its side": ((3.0, -6.0), (0.0, 12.0)),
    "a fall from rest": ((0.0, 0.0), (0.0, 8.0)),
    "there and back": ((1.0, 0.0), (-2.0, 0.0)),
    "a tight bend": ((4.0, -4.0), (0.0, 8.0)),
}


@functools.cache
def find_rays(camera, place):
    return RayGrid.over(camera, place.amin(0), place.amax(0)).rays(place)


def flight(name):
    """Scene, true arc, rays, and the mean of many sharp images [N]: a white ball before black."""
    scene = benchmark_scene(width_px=30, length_widths=3.0, heading=0.0, seed=3)
    unit = scene.ball_radius / scene.exposure
    middle = scene.path.position(torch.tensor([scene.exposure / 2]))[0].tolist()
    (vx, vy), (ax, ay) = FLIGHTS[name]
    path = ParabolicPath(
        start=tuple(middle),
        start_velocity=(vx * unit, vy * unit, 0.0),
        acceleration=(ax * unit / scene.exposure, ay * unit / scene.exposure, 0.0),
    )
    scene = replace(
        scene,
        path=path,
        appearance=PlainBall(colour=(1.0, 1.0, 1.0)),
        background=0 * scene.background,
    )
    seen = render_shot(scene).clean_image[0].double()
    row, column = (seen >= 0).nonzero().mT
    near = torch.nn.functional.max_pool2d(seen[None, None], 9, 1, 4)[0, 0].flatten() > 0
    rays = find_rays(scene.camera, torch.stack([column, row], dim=-1)[near].double())
    time = torch.linspace(-0.5, 0.5, 9, dtype=torch.float64)
    points = path.position((time + 0.5) * scene.exposure)
    arc = PARABOLA.arcs(PARABOLA.through(time, points)).coefficients[0]
    return scene, arc, rays, seen.flatten()[near]


def seen_by(scene, arc, rays):
    """Opacity [N] and its derivative in the arc [9, N], all pieces together."""
    half = torch.full_like(rays.unit[0], 0.5)
    alpha, J = torch.zeros_like(half), torch.zeros(9, len(half), dtype=half.dtype)
    parts = opacity_parts(arc, rays, -half, half, scene.blur**2 + 1 / 12, scene.ball_radius)
    for part, J_piece in parts:
        J_arc = part.J_arc if J_piece is None else J_piece.mT @ part.J_arc
        alpha.index_add_(0, part.passage.index, part.alpha)
        J.index_add_(1, part.passage.index, J_arc)
    return alpha, J, len(parts)


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_opacity_is_the_mean_of_sharp_images(name):
    scene, arc, rays, expected = flight(name)
    alpha, _, count = seen_by(scene, arc, rays)
    assert count > 1
    assert (alpha - expected).abs().max() < 2e-3
    assert (alpha - expected).sum().abs() < 2e-4 * expected.sum()


@pytest.mark.parametrize("name", ["a throw to its side", "a fall from rest"])
def test_derivatives_agree_with_differences(name, differences):
    scene, arc, rays, _ = flight(name)
    rays = rays[torch.arange(0, len(rays.unit[0]), 3)]
    _, J, _ = seen_by(scene, arc, rays)
    step = torch.full((9,), 0.003 * scene.ball_radius, dtype=torch.float64)
    expected = differences(
        lambda x: seen_by(scene, x.reshape(3, 3), rays)[0], arc.flatten(), step
    ).mT
    assert (J - expected).norm() < 0.03 * expected.norm()


@functools.cache
def long_flight():
    """A ball 120 px wide that flies through an apex and on; some rays that see it on its way."""
    camera = Camera.centred(1400, 1400, 3000.0)
    radius, distance = 0.02, 1.0
    arc = torch.tensor([[0.0, -0.15, distance], [0.28, 0.0, 0.0], [0.0, 1.2, 0.0]]).double()
    time = torch.linspace(-0.48, 0.48, 4001, dtype=torch.float64)[:, None]
    generator = torch.Generator().manual_seed(5)
    aside = 0.7 * radius * torch.randn(len(time), 3, generator=generator, dtype=torch.float64)
    place = camera.project(arc[0] + time * (arc[1] + time * arc[2]) + aside)
    return arc, find_rays(camera, place), radius


def long_opacity(arc, rays, radius):
    half = torch.full_like(rays.unit[0], 0.5)
    parts = opacity_parts(arc, rays, -half, half, 0.6, radius)
    alpha = torch.zeros_like(half)
    for part, _ in parts:
        alpha.index_add_(0, part.passage.index, part.alpha)
    return alpha, parts


def test_an_arc_is_cut_where_it_turns_and_whole_before_and_behind():
    _, parts = long_opacity(*long_flight())
    whole = [part for part, J in parts if J is None]
    assert len(whole) == 2
    assert len(parts) > 20


def test_wide_balls_are_followed_through_an_apex_to_a_thousandth_of_their_opacity():
    arc, rays, radius = long_flight()
    alpha, _ = long_opacity(arc, rays, radius)
    # which rays are covered at which of very many instants, the rims smeared out by these alone
    time = (torch.arange(40_000, dtype=torch.float64) + 0.5) / 40_000 - 0.5
    inner = rays.unit[:, ::25]
    covered = torch.zeros_like(inner[0])
    for t in time.split(4000):
        centre = arc[0] + t[:, None] * (arc[1] + t[:, None] * arc[2])
        gap = (centre * centre).sum(-1)[:, None] - (centre @ inner) ** 2
        covered += (gap < radius**2).double().sum(0)
    sharp = covered / len(time)
    is_inside = sharp > sharp.median()  # rims apart, which the lens blurs
    error = (alpha[::25] - sharp)[is_inside]
    assert is_inside.sum() > 30
    assert error.square().mean().sqrt() < 8e-4 * sharp[is_inside].mean()


def test_a_smooth_arc_stays_whole():
    scene, arc, rays, _ = flight("a tight bend")
    arc = arc.clone()
    arc[2] *= 0.05
    half = torch.full_like(rays.unit[0], 0.5)
    ((part, J),) = opacity_parts(arc, rays, -half, half, 0.6, scene.ball_radius)
    assert J is None
    assert torch.equal(
        part.alpha, arc_opacity(arc, rays, -half, half, 0.6, scene.ball_radius).alpha
    )


def test_pieces_far_from_all_rays_are_left_out():
    scene, arc, rays, _ = flight("a tight bend")
    away = arc.clone()
    away[0] += torch.tensor([9.0, 0.0, 0.0])
    half = torch.full_like(rays.unit[0], 0.5)
    assert opacity_parts(away, rays, -half, half, 0.6, scene.ball_radius) == []
