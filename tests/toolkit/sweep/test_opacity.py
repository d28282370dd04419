"""The opacity in closed form against the mean of many sharp images."""

import functools
import math
from dataclasses import replace

import pytest
import torch

from toolkit.sweep.opacity import PIXEL_VARIANCE, arc_opacity
from toolkit.sweep.rays import RayGrid
from toolkit.synthetic import PlainBall, benchmark_scene, render_shot

LENS = (-0.25, 0.08, 1e-3, -5e-4, 0.0)
STRAIGHT = {"width_px": 30, "heading": 0.4}
TILTED = STRAIGHT | {"distance_R": 15.0, "tilt": math.radians(60)}


@functools.cache
def find_rays(camera, place):
    return RayGrid.over(camera, place.amin(0), place.amax(0)).rays(place)


def rendered(**options):
    """Scene, and the mean of many sharp images [H, W]: a white ball before black."""
    scene = benchmark_scene(seed=3, **(STRAIGHT | options))
    scene = replace(
        scene, appearance=PlainBall(colour=(1.0, 1.0, 1.0)), background=0 * scene.background
    )
    return scene, render_shot(scene).clean_image[0].double()


def arc_of(scene):
    """c0, c1 and c2 of the true path, time from -1/2 to 1/2."""
    first, middle, last = scene.path.position(
        torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64) * scene.exposure
    )
    bend = 2 * (first + last - 2 * middle)
    # a straight path is exactly that
    bend = torch.where(bend.abs() < 1e-12, 0, bend)
    return torch.stack([middle, last - first, bend])


def rays_of(scene):
    height, width = scene.camera.height, scene.camera.width
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return find_rays(scene.camera, torch.stack([x.flatten(), y.flatten()], dim=-1).double())


def exposed(rays, start=-0.5, stop=0.5):
    ones = torch.ones_like(rays.unit[0])
    return start * ones, stop * ones


def opacity(scene, arc=None, spread=None, start=-0.5, stop=0.5, rays=None):
    """All pixels' opacity [N], or that of some rays, and what gave it."""
    rays = rays_of(scene) if rays is None else rays
    part = arc_opacity(
        arc_of(scene) if arc is None else arc,
        rays,
        *exposed(rays, start, stop),
        scene.blur**2 + PIXEL_VARIANCE if spread is None else spread,
        scene.ball_radius,
    )
    alpha = torch.zeros_like(rays.unit[0])
    alpha[part.passage.index] = part.alpha
    return alpha, part


LONG, SHORT, CORNERED = 2e-4, 1e-3, 5e-3
CASES = {
    "long": ({"length_widths": 5.0, "blur": 0.7}, LONG),
    "long, soft": ({"length_widths": 5.0, "blur": 1.2}, 5e-4),
    "two widths": ({"length_widths": 2.0, "blur": 0.7}, LONG),
    "two widths, soft": ({"length_widths": 2.0, "blur": 1.2}, SHORT),
    "half a width": ({"length_widths": 0.5, "blur": 0.7}, 5e-4),
    "half a width, soft": ({"length_widths": 0.5, "blur": 1.2}, SHORT),
    "as good as still": ({"length_widths": 0.01, "blur": 0.7}, 0.01),
    "as good as still, soft": ({"length_widths": 0.01, "blur": 1.2}, 0.01),
    # a pixel's own square is taken for a round spot of its variance
    "no lens": ({"length_widths": 5.0, "blur": 0.0}, 2e-3),
    "half a width, no lens": ({"length_widths": 0.5, "blur": 0.0}, 0.015),
    "tilted": (TILTED | {"length_widths": 2.0, "blur": 0.7}, 2e-3),
    "tilted, long": (TILTED | {"length_widths": 5.0, "blur": 0.7}, SHORT),
    "tilted, half a width": (TILTED | {"length_widths": 0.5, "blur": 0.7}, CORNERED),
    "parabola": ({"length_widths": 5.0, "sagitta_widths": 0.5, "tilt": 0.3}, LONG),
    "short parabola": ({"length_widths": 2.0, "sagitta_widths": 0.3}, CORNERED),
    "through a real lens": ({"length_widths": 2.0, "distance_R": 30.0, "distortion": LENS}, LONG),
}


@pytest.mark.parametrize("name", CASES)
def test_the_opacity_is_the_mean_of_sharp_images(name):
    options, limit = CASES[name]
    scene, expected = rendered(**options)
    alpha, _ = opacity(scene)
    error = alpha.reshape(expected.shape) - expected
    assert error.abs().max() < limit
    # what is wrong somewhere is made good beside it
    assert error.sum().abs() < 5e-4 * expected.sum()


def test_nothing_is_seen_of_a_ball_that_passes_beside_the_rays_or_at_another_time():
    scene, _ = rendered(length_widths=2.0)
    rays = rays_of(scene)
    away = arc_of(scene)
    away[0] += torch.tensor([9.0, 0.0, 0.0])
    part = arc_opacity(away, rays, *exposed(rays), 0.6, scene.ball_radius)
    assert float(part.alpha.abs().sum()) < 1e-12
    later = arc_opacity(arc_of(scene), rays, *exposed(rays, 30.0, 31.0), 0.6, scene.ball_radius)
    assert float(later.alpha.abs().sum()) < 1e-9


def test_parts_of_the_exposure_add_up():
    scene, _ = rendered(length_widths=2.0, sagitta_widths=0.3)
    whole, _ = opacity(scene)
    parts = sum(opacity(scene, start=low, stop=low + 0.25)[0] for low in (-0.5, -0.25, 0.0, 0.25))
    # a joint within the exposure is seen by rays near a rim only, each in its own approximation
    assert (parts - whole).abs().max() < 5e-4


def test_the_passage_tells_instant_room_and_side():
    scene, _ = rendered(length_widths=2.0, heading=0.0)
    _, part = opacity(scene)
    arc, rays = arc_of(scene), rays_of(scene)[part.passage.index]
    time = torch.linspace(-1, 1, 4001, dtype=torch.float64)
    centre = arc[0] + time[:, None] * arc[1]
    distance = torch.linalg.cross(centre[:, None], rays.unit.mT[None, ::7]).norm(dim=-1)
    is_inside = (distance.argmin(0) > 0) & (distance.argmin(0) < len(time) - 1)
    nearest, at = distance.min(0)
    passage = part.passage
    assert (passage.instant[::7] - time[at])[is_inside].abs().max() < 1e-3
    room = scene.ball_radius**2 - nearest**2
    assert (passage.room[::7] - room)[is_inside].abs().max() < 1e-3 * scene.ball_radius**2
    # the ball moves right: what lies below its path is on its right hand
    middle = scene.camera.project(arc[0])[1]
    row = scene.camera.project(rays.unit.mT)[:, 1]
    assert torch.equal(passage.side > 0, row > middle)


DERIVATIVES = {
    "long": ({"length_widths": 5.0}, 0.01),
    # wide beside a narrow ball: what little slopes of slopes do is left out
    "two widths, soft": ({"length_widths": 2.0, "blur": 1.2}, 0.04),
    "half a width": ({"length_widths": 0.5}, 0.02),
    "a third of a width": ({"length_widths": 0.3}, 0.02),
    "tilted": (TILTED | {"length_widths": 2.0}, 0.02),
    "tilted, half a width": (TILTED | {"length_widths": 0.5}, 0.02),
    "parabola": ({"length_widths": 3.0, "sagitta_widths": 0.3, "tilt": 0.3}, 0.02),
    "short parabola": ({"length_widths": 1.0, "sagitta_widths": 0.05, "tilt": 0.3}, 0.02),
    "no lens": ({"length_widths": 2.0, "blur": 0.0}, 0.02),
    "through a real lens": ({"length_widths": 2.0, "distance_R": 30.0, "distortion": LENS}, 0.02),
}


def relative_error(found, expected):
    return float((found - expected).norm() / expected.norm())


@pytest.mark.parametrize("name", DERIVATIVES)
def test_derivatives_agree_with_differences(name, differences):
    options, limit = DERIVATIVES[name]
    scene, expected = rendered(**options)
    arc, spread = arc_of(scene), scene.blur**2 + PIXEL_VARIANCE
    rays = rays_of(scene)[(expected.flatten() > 0).nonzero()[:, 0]]
    _, part = opacity(scene, rays=rays)
    assert len(part.alpha) == len(rays.unit[0])
    # wide steps: where a ray passes from one approximation to the other, there is a seam of 1e-4
    step = torch.full((9,), 0.01 * scene.ball_radius, dtype=torch.float64)
    J = differences(lambda x: opacity(scene, x.reshape(3, 3), rays=rays)[0], arc.flatten(), step).mT
    assert relative_error(part.J_arc[:3], J[:3]) < limit
    assert relative_error(part.J_arc[3:6], J[3:6]) < limit
    assert relative_error(part.J_arc[6:], J[6:]) < 3 * limit
    wider, narrower = (opacity(scene, spread=spread * k, rays=rays)[0] for k in (1.1, 0.9))
    assert relative_error(part.J_spread, (wider - narrower) / (0.2 * spread)) < 0.07


def test_a_straight_arc_is_the_limit_of_bent_ones():
    """Also its derivative in the bend, which straight arcs take from a closed form."""
    scene, _ = rendered(length_widths=2.0, tilt=0.3)
    arc = arc_of(scene)
    bent = arc.clone()
    bent[2] = 1e-7 * torch.tensor([1.0, -0.5, 2.0])
    straight, one = opacity(scene, arc)
    almost, other = opacity(scene, bent)
    assert (straight - almost).abs().max() < 1e-5
    both = torch.isin(one.passage.index, other.passage.index)
    assert relative_error(other.J_arc, one.J_arc[:, both]) < 1e-3
