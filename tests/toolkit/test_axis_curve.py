from dataclasses import replace

import pytest
import torch

from toolkit.axis_curve import (
    AxisCurve,
    Edges,
    fit_axis,
    graze_residual,
    nearest_parameter,
    start_curve,
)
from toolkit.camera import Camera
from toolkit.errors import ConfigError
from toolkit.splines import SplineBasis
from toolkit.synthetic import ParabolicPath, StraightPath, true_contours

BALL_RADIUS = 0.05
EXPOSURE = 0.02
EDGE_STD = 0.1
"""px, across the profile, of centre and half width."""
CAMERA = Camera(
    width=1000,
    height=800,
    fx=900.0,
    fy=910.0,
    cx=505.0,
    cy=395.0,
    distortion=(-0.12, 0.05, 1e-3, -8e-4, 0.01),
)
PROFILES = 160

TILTED = StraightPath(start=(-0.3, 0.1, 1.2), start_velocity=(25.0, -6.0, 14.0))
# free of a change of depth, so that the curve can follow it exactly
FLAT_ARC = ParabolicPath(
    start=(-0.3, 0.0, 1.4), start_velocity=(30.0, -8.0, 0.0), acceleration=(0.0, 900.0, 0.0)
)
ARC = ParabolicPath(
    start=(-0.3, 0.1, 1.4), start_velocity=(30.0, -10.0, 5.0), acceleration=(0.0, 950.0, 120.0)
)


def some_curve():
    """A curve with more of everything, of no special shape."""
    generator = torch.Generator().manual_seed(3)
    across = torch.nn.functional.normalize(
        torch.tensor([0.1, 1.0]) + 0.2 * torch.randn(6, 2, generator=generator), dim=-1
    )
    image = torch.stack([torch.linspace(-0.3, 0.3, 6), 0.1 * torch.linspace(-1, 1, 6) ** 2], -1)
    return AxisCurve(
        image_basis=SplineBasis(start=0.0, stop=500.0, size=6),
        depth_basis=SplineBasis(start=0.0, stop=500.0, size=4),
        image=image.double(),
        inverse_depth=torch.tensor([0.6, 0.65, 0.7, 0.66], dtype=torch.float64),
        across=across.double(),
    )


def flat_arc_curve():
    """The exact curve of FLAT_ARC, s being 500 px for the exposure."""
    basis = SplineBasis(start=0.0, stop=500.0, size=3)
    x0, y0, z = FLAT_ARC.start
    vx, vy, _ = FLAT_ARC.start_velocity
    half = EXPOSURE / 2
    bend = FLAT_ARC.acceleration[1] * EXPOSURE**2 / 2
    image = torch.tensor(
        [
            [x0, y0],
            [x0 + vx * half, y0 + vy * half],
            [x0 + 2 * vx * half, y0 + 2 * vy * half + bend],
        ],
        dtype=torch.float64,
    )
    return AxisCurve(
        image_basis=basis,
        depth_basis=SplineBasis(start=0.0, stop=500.0, size=2),
        image=image / z,
        inverse_depth=torch.full((2,), 1 / z, dtype=torch.float64),
        across=torch.tensor([[0.2, 1.0], [0.0, 1.0], [-0.2, 1.0]], dtype=torch.float64),
    )


def true_edges(path, camera=CAMERA, count=PROFILES):
    """Edges of the tube at equal steps of time, free of noise."""
    pixels = true_contours(path, camera, BALL_RADIUS, EXPOSURE, count).transpose(0, 1)
    gap = pixels[:, 1] - pixels[:, 0]
    middle = camera.undistort(pixels.mean(1)) * ((camera.fx + camera.fy) / 2)
    steps = torch.linalg.vector_norm(middle.diff(dim=0), dim=-1)
    return Edges(
        s=torch.cat([torch.zeros(1).double(), steps.cumsum(0)]),
        pixels=pixels,
        normal=torch.nn.functional.normalize(gap, dim=-1),
        covariance=EDGE_STD**2 * torch.eye(2, dtype=torch.float64).expand(count, 2, 2),
        weight=torch.ones(count, dtype=torch.float64),
    )


def shifted(edges, shift):
    """Edges whose centre and half width changed by shift [P, 2] px."""
    sides = torch.stack([shift[:, 0] - shift[:, 1], shift[:, 0] + shift[:, 1]], dim=-1)
    return replace(edges, pixels=edges.pixels + sides[..., None] * edges.normal[:, None])


def rough_start(edges, depth=1.7, camera=CAMERA):
    focal = (camera.fx + camera.fy) / 2
    weight = edges.weight * focal**2 / edges.covariance[:, 0, 0]
    centres = camera.undistort(edges.pixels.mean(1))
    depths = torch.full_like(edges.s, depth)
    return start_curve(centres, edges.s, weight, depths, edges.weight)


def distance_from_path(curve, s, path):
    """Distance of curve points from the true path, in ball radii."""
    time = torch.linspace(-0.1 * EXPOSURE, 1.1 * EXPOSURE, 20_001, dtype=torch.float64)
    return torch.cdist(curve(s), path.position(time)).amin(1) / BALL_RADIUS


def test_shapes():
    curve = some_curve()
    s = torch.rand(7, 2, dtype=torch.float64) * 500
    assert curve(s).shape == (7, 2, 3)
    assert curve.tangent(s).shape == (7, 2, 3)
    assert curve.J_point(s).shape == (7, 2, 3, 10)
    assert curve.parameters.shape == (10,)
    assert curve.curvature_radius(s[:, 0]).shape == (7,)


def test_the_tangent_is_the_derivative():
    curve = some_curve()
    s = torch.linspace(-40, 540, 30, dtype=torch.float64)
    step = 1e-4
    slope = (curve(s + step) - curve(s - step)) / (2 * step)
    assert torch.allclose(curve.tangent(s), slope, atol=1e-9)


def test_J_point_is_the_derivative_in_the_parameters():
    curve = some_curve()
    s = torch.linspace(0, 500, 9, dtype=torch.float64)
    expected = torch.autograd.functional.jacobian(lambda p: curve.moved(p)(s), curve.parameters)
    assert torch.allclose(curve.J_point(s), expected, atol=1e-12)


def test_the_curve_moves_across_itself_only():
    curve = some_curve()
    assert torch.equal(curve.moved(curve.parameters).image, curve.image)
    shift = torch.zeros_like(curve.parameters)
    shift[2] = 0.01
    moved = curve.moved(curve.parameters + shift)
    assert torch.allclose(moved.image[2] - curve.image[2], 0.01 * curve.across[2])
    assert torch.equal(moved.inverse_depth, curve.inverse_depth)


def test_a_line_in_space_is_linear_in_s():
    ends = torch.tensor([[-0.3, 0.1, 1.2], [0.2, -0.02, 2.9]], dtype=torch.float64)
    curve = AxisCurve(
        image_basis=SplineBasis(start=0.0, stop=1.0, size=2),
        depth_basis=SplineBasis(start=0.0, stop=1.0, size=2),
        image=ends[:, :2] / ends[:, 2:],
        inverse_depth=1 / ends[:, 2],
        across=torch.ones(2, 2, dtype=torch.float64),
    )
    points = curve(torch.linspace(-0.2, 1.2, 15, dtype=torch.float64))
    off = torch.linalg.cross(points - ends[0], (ends[1] - ends[0]).expand_as(points))
    assert off.abs().max() < 1e-12
    assert torch.allclose(curve(torch.tensor([0.0, 1.0]).double()), ends)
    assert (curve.curvature_radius(torch.linspace(0, 1, 5).double()) > 1e6).all()


def test_the_radius_of_a_parabola_s_bend():
    curve = flat_arc_curve()
    time = torch.tensor([0.2, 0.5, 0.8], dtype=torch.float64) * EXPOSURE
    v = FLAT_ARC.velocity(time)
    a = torch.tensor(FLAT_ARC.acceleration, dtype=torch.float64).expand_as(v)
    expected = v.norm(dim=-1) ** 3 / torch.linalg.cross(v, a).norm(dim=-1)
    found = curve.curvature_radius(time / EXPOSURE * 500)
    assert torch.allclose(found, expected, rtol=1e-3)


def test_the_nearest_point_is_the_nearest():
    curve = flat_arc_curve()
    edges = true_edges(FLAT_ARC, count=12)
    rays = CAMERA.unproject(edges.pixels)
    start = torch.linspace(0, 500, 12, dtype=torch.float64)[:, None].expand(-1, 2) + 20
    nearest = nearest_parameter(curve, start, rays)
    fine = torch.linspace(-60, 560, 31_001, dtype=torch.float64)
    distance = torch.linalg.cross(curve(fine)[:, None, None], rays[None]).norm(dim=-1)
    assert torch.allclose(nearest, fine[distance.argmin(0)], atol=0.02)


def residual_of(curve, edges, camera=CAMERA):
    rays = camera.unproject(edges.pixels)
    swing = (camera.J_unproject(edges.pixels) @ edges.normal[:, None, :, None])[..., 0]
    s = torch.linspace(0, 500, len(edges.s), dtype=torch.float64)
    return graze_residual(curve, s, rays, swing, BALL_RADIUS)


def test_true_contours_graze_the_tube():
    residual, J = residual_of(flat_arc_curve(), true_edges(FLAT_ARC))
    assert residual.shape == (PROFILES, 2)
    assert J.shape == (PROFILES, 2, 5)
    assert residual.abs().max() < 1e-8  # px


def test_the_residual_counts_px_along_the_normal():
    shift = torch.zeros(PROFILES, 2).double()
    shift[:, 0] = 0.02
    moved, _ = residual_of(flat_arc_curve(), shifted(true_edges(FLAT_ARC), shift))
    assert torch.allclose(moved, torch.tensor(0.02).double(), atol=2e-4)
    wider = shift.flip(1)
    moved, _ = residual_of(flat_arc_curve(), shifted(true_edges(FLAT_ARC), wider))
    assert torch.allclose(moved, torch.tensor([-0.02, 0.02]).double(), atol=2e-4)


def test_the_residual_s_jacobian():
    curve, edges = flat_arc_curve(), true_edges(FLAT_ARC, count=20)
    _, J = residual_of(curve, edges)
    step = 1e-6
    for index in range(5):
        shift = torch.zeros(5).double()
        shift[index] = step
        ahead, _ = residual_of(curve.moved(curve.parameters + shift), edges)
        behind, _ = residual_of(curve.moved(curve.parameters - shift), edges)
        slope = (ahead - behind) / (2 * step)
        assert torch.allclose(J[..., index], slope, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("distortion", [(), CAMERA.distortion], ids=["ideal lens", "real lens"])
@pytest.mark.parametrize("depth", [1.2, 2.5])
def test_a_tilted_line_comes_back_exactly(distortion, depth):
    camera = replace(CAMERA, distortion=distortion)
    edges = true_edges(TILTED, camera)
    axis = fit_axis(rough_start(edges, depth, camera), edges, camera, BALL_RADIUS)
    assert axis.converged
    assert len(axis.curve.inverse_depth) == 2
    points = axis.curve(edges.s)
    time = torch.zeros(1).double()
    along = torch.nn.functional.normalize(TILTED.velocity(time)[0], dim=0)
    away = torch.linalg.cross(points - TILTED.position(time), along.expand_as(points))
    assert away.norm(dim=-1).max() < 1e-6 * BALL_RADIUS
    assert axis.chi2 < 1e-9


@pytest.mark.parametrize("path", [FLAT_ARC, ARC], ids=["level", "with depth"])
def test_an_arc_comes_back(path):
    edges = true_edges(path)
    axis = fit_axis(rough_start(edges), edges, CAMERA, BALL_RADIUS)
    assert axis.converged
    assert distance_from_path(axis.curve, edges.s, path).max() < 0.01


def test_the_answer_scales_with_the_ball():
    edges = true_edges(TILTED)
    one = fit_axis(rough_start(edges), edges, CAMERA, BALL_RADIUS)
    two = fit_axis(rough_start(edges, 2 * 1.7), edges, CAMERA, 2 * BALL_RADIUS)
    assert torch.allclose(two.curve(edges.s), 2 * one.curve(edges.s), rtol=1e-6)


def test_profiles_without_weight_are_ignored():
    edges = true_edges(TILTED)
    spoiled = edges.pixels.clone()
    spoiled[10:20] += 30
    weight = edges.weight.clone()
    weight[10:20] = 0
    covariance = edges.covariance.clone()
    covariance[10:20] = torch.inf
    edges = replace(edges, pixels=spoiled, weight=weight, covariance=covariance)
    start = rough_start(true_edges(TILTED))
    axis = fit_axis(start, edges, CAMERA, BALL_RADIUS)
    assert distance_from_path(axis.curve, edges.s, TILTED).max() < 1e-3
    assert (axis.gain[10:20] == 0).all()


def noisy_fits(path, count):
    edges = true_edges(path)
    generator = torch.Generator().manual_seed(5)
    start = fit_axis(rough_start(edges), edges, CAMERA, BALL_RADIUS).curve
    size = (len(start.inverse_depth),)
    exact = fit_axis(start, edges, CAMERA, BALL_RADIUS, sizes=size)
    fits = []
    for _ in range(count):
        noise = EDGE_STD * torch.randn(PROFILES, 2, generator=generator, dtype=torch.float64)
        fits.append((noise, fit_axis(start, shifted(edges, noise), CAMERA, BALL_RADIUS, size)))
    return start, exact, fits


def test_noise_spreads_the_parameters_as_the_covariance_says():
    start, exact, fits = noisy_fits(TILTED, count=30)
    # each fit's parameters, counted from the same start
    across = start.across
    found = torch.stack(
        [
            torch.cat([((f.curve.image - start.image) * across).sum(-1), f.curve.inverse_depth])
            for _, f in fits
        ]
    )
    ratio = found.std(0) / exact.covariance.diagonal().sqrt()
    assert 0.65 < float(ratio.min()) <= float(ratio.max()) < 1.4  # 13 % each for 30 trials
    chi2 = torch.tensor([f.chi2_per_dof for _, f in fits])
    assert float(chi2.mean()) == pytest.approx(1, abs=0.05)


def test_the_gain_says_how_the_parameters_follow_each_profile():
    start, exact, fits = noisy_fits(TILTED, count=3)
    for noise, fit in fits:
        moved = torch.cat(
            [((fit.curve.image - start.image) * start.across).sum(-1), fit.curve.inverse_depth]
        )
        base = torch.cat(
            [((exact.curve.image - start.image) * start.across).sum(-1), exact.curve.inverse_depth]
        )
        predicted = torch.einsum("pka,pa->k", exact.gain, noise)
        std = exact.covariance.diagonal().sqrt()
        assert ((moved - base - predicted).abs() < 0.05 * std).all()


def test_gain_and_covariance_agree():
    _, exact, _ = noisy_fits(TILTED, count=0)
    spread = EDGE_STD**2 * torch.einsum("pka,pla->kl", exact.gain, exact.gain)
    assert torch.allclose(spread, exact.covariance, rtol=1e-6)


def test_depth_gets_no_more_coefficients_than_noise_leaves_visible():
    edges = true_edges(TILTED)
    generator = torch.Generator().manual_seed(6)
    noise = EDGE_STD * torch.randn(PROFILES, 2, generator=generator, dtype=torch.float64)
    axis = fit_axis(rough_start(edges), shifted(edges, noise), CAMERA, BALL_RADIUS)
    assert len(axis.curve.inverse_depth) == 2


def test_without_sizes_there_is_nothing_to_choose():
    edges = true_edges(TILTED)
    with pytest.raises(ConfigError, match="no number of depth coefficients"):
        fit_axis(rough_start(edges), edges, CAMERA, BALL_RADIUS, sizes=())
