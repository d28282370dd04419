import math

import pytest
import torch

from toolkit.camera import Camera
from toolkit.canal import (
    couple_points,
    interpretation_normals,
    place_cross_sections,
    straight_axis,
)
from toolkit.errors import ShapeError
from toolkit.synthetic import CircularPath, ParabolicPath, StraightPath, true_contours
from toolkit.synthetic.truth import grazing_points

BALL_RADIUS = 0.05
EXPOSURE = 0.02
EXACT = 1e-9

STRAIGHT = {
    "across the view": StraightPath(start=(-0.3, 0.0, 1.5), start_velocity=(30.0, 0.0, 0.0)),
    "tilted": StraightPath(start=(-0.3, 0.1, 1.2), start_velocity=(25.0, -6.0, 14.0)),
    "coming closer": StraightPath(start=(0.3, -0.2, 1.6), start_velocity=(-20.0, 12.0, -17.0)),
    "far off the axis": StraightPath(start=(0.7, 0.5, 1.0), start_velocity=(5.0, -28.0, 9.0)),
    "close by": StraightPath(start=(-0.1, 0.0, 0.16), start_velocity=(10.0, 0.0, 1.0)),
}
CURVED = {
    "parabola": ParabolicPath(
        start=(-0.3, 0.1, 1.5), start_velocity=(30.0, -8.0, 5.0), acceleration=(0.0, 900.0, 100.0)
    ),
    "circle": CircularPath(
        centre=(0.0, 0.0, 1.4), arm=(0.3, 0.0, 0.05), axis=(0.2, 0.3, 1.0), rate=80.0
    ),
}
PATHS = STRAIGHT | CURVED


def contours(path, count=60, shift=0.0):
    """Rays, their derivatives along the contour, and the true normals, at equal steps of time."""
    step = EXPOSURE / (count - 1)
    time = torch.linspace(0, EXPOSURE, count, dtype=torch.float64) + shift * step
    time.requires_grad_(True)
    points, normals, _ = grazing_points(path, BALL_RADIUS, time)
    rays = points / torch.linalg.vector_norm(points, dim=-1, keepdim=True)
    tangents = torch.empty_like(rays)
    for side in range(2):
        for axis in range(3):
            (slope,) = torch.autograd.grad(rays[side, :, axis].sum(), time, retain_graph=True)
            tangents[side, :, axis] = slope
    return rays.detach(), tangents.detach(), normals.detach(), time.detach()


@pytest.mark.parametrize("name", PATHS)
def test_the_rays_are_those_of_the_renderer_s_contours(name):
    camera = Camera(width=900, height=900, fx=600.0, fy=620.0, cx=440.0, cy=460.0)
    rays, _, _, _ = contours(PATHS[name])
    pixels = true_contours(PATHS[name], camera, BALL_RADIUS, EXPOSURE, 60)
    assert torch.allclose(camera.unproject(pixels), rays, atol=1e-9)


@pytest.mark.parametrize("name", PATHS)
def test_interpretation_normals_are_the_tube_s_own(name):
    rays, tangents, expected, _ = contours(PATHS[name])
    normals = interpretation_normals(rays, tangents)
    assert normals.shape == (2, 60, 3)
    assert torch.allclose(normals, expected, atol=EXACT)
    # whichever way the contour is walked
    assert torch.allclose(interpretation_normals(rays, -tangents), expected, atol=EXACT)


@pytest.mark.parametrize("name", PATHS)
def test_coupled_points_place_the_ball_exactly(name):
    path = PATHS[name]
    rays, tangents, _, time = contours(path)
    normals = interpretation_normals(rays, tangents)
    opacity = torch.linspace(0.1, 0.2, 60, dtype=torch.float64)
    sections = place_cross_sections(
        rays.transpose(0, 1), normals.transpose(0, 1), opacity, BALL_RADIUS
    )
    assert torch.allclose(sections.centre, path.position(time), atol=EXACT)
    along = torch.nn.functional.normalize(path.velocity(time), dim=-1)
    # two planes tell the line of the motion, not its sign
    cosine = (sections.direction * along).sum(-1, keepdim=True)
    assert torch.allclose(sections.direction, cosine.sign() * along, atol=EXACT)
    assert torch.equal(sections.opacity, opacity)


def test_cross_sections_scale_with_the_ball():
    rays, tangents, _, _ = contours(PATHS["tilted"])
    normals = interpretation_normals(rays, tangents)
    arguments = (rays.transpose(0, 1), normals.transpose(0, 1), torch.ones(60).double())
    one, three = (place_cross_sections(*arguments, radius) for radius in (0.05, 0.15))
    assert torch.allclose(three.centre, 3 * one.centre, rtol=1e-12)
    assert torch.equal(three.direction, one.direction)


@pytest.mark.parametrize("name", PATHS)
def test_points_of_the_same_instant_are_coupled(name):
    rays, tangents, _, _ = contours(PATHS[name])
    partner, is_coupled = couple_points(rays, interpretation_normals(rays, tangents))
    assert partner.shape == is_coupled.shape == (60,)
    inner = slice(1, -1)
    assert is_coupled[inner].all()
    index = torch.arange(60.0).double()
    assert torch.allclose(partner[inner], index[inner], atol=1e-6)


@pytest.mark.parametrize("name", PATHS)
def test_coupling_finds_the_place_between_two_points(name):
    left = contours(PATHS[name])
    right = contours(PATHS[name], shift=0.3)
    rays = torch.stack([left[0][0], right[0][1]])
    tangents = torch.stack([left[1][0], right[1][1]])
    partner, is_coupled = couple_points(rays, interpretation_normals(rays, tangents))
    index = torch.arange(60.0).double() - 0.3
    assert is_coupled[2:-2].all()
    # linear between samples
    assert torch.allclose(partner[2:-2], index[2:-2], atol=0.03)


def test_points_without_a_partner_are_told():
    rays, tangents, _, _ = contours(PATHS["tilted"])
    normals = interpretation_normals(rays, tangents)
    # the right contour is seen in its first half only, twice as densely
    half = contours(PATHS["tilted"], count=119)
    rays = torch.stack([rays[0], half[0][1, :60]])
    normals = torch.stack([normals[0], half[2][1, :60]])
    partner, is_coupled = couple_points(rays, normals)
    assert is_coupled[1:29].all()
    assert not is_coupled[31:].any()
    assert partner[31:].isnan().all()
    assert torch.allclose(partner[1:29], 2 * torch.arange(1.0, 29.0).double(), atol=1e-6)


@pytest.mark.parametrize("name", STRAIGHT)
def test_the_straight_axis_is_exact(name):
    path = STRAIGHT[name]
    rays, _, normals, time = contours(path)
    foot, direction = straight_axis(rays, torch.ones(2, 60).double(), BALL_RADIUS)
    along = torch.nn.functional.normalize(path.velocity(time)[0], dim=0)
    start = path.position(time)[0]
    assert torch.allclose(direction, along, atol=EXACT)
    assert torch.allclose(foot, start - (start @ along) * along, atol=EXACT)
    # d = R / sin(a), 2a being the angle between the two planes
    angle = math.acos(-float(normals[0, 0] @ normals[1, 0])) / 2
    distance = float(torch.linalg.vector_norm(foot))
    assert distance == pytest.approx(BALL_RADIUS / math.sin(angle), rel=1e-9)


def test_the_straight_axis_follows_the_order_of_the_points():
    rays, _, _, _ = contours(STRAIGHT["tilted"])
    weight = torch.ones(2, 60).double()
    foot, direction = straight_axis(rays, weight, BALL_RADIUS)
    back_foot, back = straight_axis(rays.flip(1), weight, BALL_RADIUS)
    assert torch.allclose(back, -direction, atol=EXACT)
    assert torch.allclose(back_foot, foot, atol=EXACT)
    swapped_foot, swapped = straight_axis(rays.flip(0), weight, BALL_RADIUS)
    assert torch.allclose(swapped, direction, atol=EXACT)
    assert torch.allclose(swapped_foot, foot, atol=EXACT)


def test_the_straight_axis_needs_no_coupling_and_heeds_the_weights():
    path = STRAIGHT["tilted"]
    rays, _, _, _ = contours(path)
    foot, direction = straight_axis(rays, torch.ones(2, 60).double(), BALL_RADIUS)
    uncoupled = torch.stack([rays[0, :40], rays[1, 20:]])
    spoiled = uncoupled.clone()
    spoiled[0, 7] = torch.tensor([0.0, 0.6, 0.8]).double()
    weight = torch.ones(2, 40).double()
    weight[0, 7] = 0
    found = straight_axis(spoiled, weight, BALL_RADIUS)
    assert torch.allclose(found[0], foot, atol=EXACT)
    assert torch.allclose(found[1], direction, atol=EXACT)


def test_shapes_that_disagree_are_refused():
    rays, tangents, normals, _ = contours(PATHS["tilted"], count=5)
    with pytest.raises(ShapeError, match="rays"):
        interpretation_normals(rays[:1], tangents[:1])
    pairs, planes = rays.transpose(0, 1), normals.transpose(0, 1)
    with pytest.raises(ShapeError, match="rays"):
        place_cross_sections(pairs, planes, torch.ones(4), BALL_RADIUS)
    with pytest.raises(ShapeError, match="normals"):
        place_cross_sections(pairs, planes[:4], torch.ones(5), BALL_RADIUS)
