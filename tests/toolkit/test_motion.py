import math

import pytest
import torch

from toolkit.axis_curve import Edges, fit_axis
from toolkit.camera import Camera
from toolkit.motion import (
    PATH_POINTS,
    OpacityData,
    Pace,
    describe_motion,
    fit_pace,
    make_clock,
    noise_covariance,
    pace_samples,
    propagate,
)
from toolkit.splines import SplineBasis
from toolkit.synthetic import (
    ParabolicPath,
    PlainBall,
    Scene,
    StraightPath,
    flat_background,
    render_shot,
    true_contours,
)
from toolkit.synthetic.truth import true_axis

BALL_RADIUS = 0.05
EXPOSURE = 0.02
LENGTH = 400.0
"""Of the streak along s, px."""
CAMERA = Camera(width=600, height=400, fx=700.0, fy=700.0, cx=299.5, cy=199.5)
TILTED = StraightPath(start=(-0.25, -0.05, 1.3), start_velocity=(22.0, 4.0, 12.0))
# speeds up along its own line: from 22 to 28 m/s
FASTER = ParabolicPath(
    start=(-0.25, 0.0, 1.5), start_velocity=(22.0, 0.0, 0.0), acceleration=(300.0, 0.0, 0.0)
)


def line_curve(path):
    """The exact axis of a path along a line; s runs from 0 to LENGTH during the exposure."""
    return true_axis(path, EXPOSURE, LENGTH)


def s_of(curve, points):
    """Parameter of points on the curve's line [N]."""
    first, last = curve.image
    share = ((points[:, :2] / points[:, 2:] - first) @ (last - first)) / ((last - first) ** 2).sum()
    return share * LENGTH


def exact_opacity(path, points, velocity):
    """k = 2R / (v e sin(gamma)) where the ball is at `points`."""
    rays = torch.nn.functional.normalize(points, dim=-1)
    speed_across = torch.linalg.cross(velocity, rays).norm(dim=-1)  # v sin(gamma)
    return 2 * BALL_RADIUS / (speed_across * EXPOSURE)


def opacity_data(path, curve, count=120, noise=0.0, std=1e-3, seed=0):
    time = torch.linspace(0.15, 0.85, count, dtype=torch.float64) * EXPOSURE
    points = path.position(time)
    generator = torch.Generator().manual_seed(seed)
    error = noise * torch.randn(count, generator=generator, dtype=torch.float64)
    covariance = torch.zeros(count, 3, 3, dtype=torch.float64)
    covariance[:, 0, 0] = covariance[:, 1, 1] = 0.1**2
    covariance[:, 2, 2] = std**2
    return OpacityData(
        s=s_of(curve, points),
        rays=torch.nn.functional.normalize(points, dim=-1),
        opacity=exact_opacity(path, points, path.velocity(time)) + error,
        covariance=covariance,
        weight=torch.ones(count, dtype=torch.float64),
    )


@pytest.mark.parametrize("velocity", [(40.0, 0.0, 0.0), (30.0, 8.0, 20.0), (25.0, -4.0, -25.0)])
def test_rendered_opacity_agrees_with_the_exact_formula(velocity):
    camera = Camera(width=170, height=130, fx=300.0, fy=300.0, cx=85.0, cy=64.0)
    exposure = 0.01
    middle = torch.tensor([0.02, 0.015, 1.0], dtype=torch.float64)
    v = torch.tensor(velocity, dtype=torch.float64)
    start = tuple((middle - v * exposure / 2).tolist())
    scene = Scene(
        camera=camera,
        path=StraightPath(start=start, start_velocity=velocity),
        ball_radius=BALL_RADIUS,
        exposure=exposure,
        appearance=PlainBall(colour=(1.0, 1.0, 1.0)),
        background=flat_background(170, 130),
    )
    alpha = render_shot(scene, step=0.04, supersampling=5).alpha.double()
    # a strip across the middle, where no ray meets the ball's first or last image
    x, y = camera.project(middle).round().long().tolist()
    pixels = torch.stack([torch.full((21,), x), torch.arange(y - 10, y + 11)], dim=-1)
    u = camera.unproject(pixels.double())
    w2 = (torch.linalg.cross(v.expand_as(u), u) ** 2).sum(-1)
    off = (u @ torch.linalg.cross(middle, v)) ** 2
    # MATHS: alpha(u) = 2 sqrt(R^2 |v x u|^2 - (u.(C x v))^2) / (e |v x u|^2)
    expected = 2 * (BALL_RADIUS**2 * w2 - off).sqrt() / (exposure * w2)
    assert torch.allclose(alpha[pixels[:, 1], pixels[:, 0]], expected, rtol=4e-3)
    # on the axis itself: the ball covers a ray while it travels 2R / sin(gamma)
    ray = middle / middle.norm()
    sine = torch.linalg.cross(v, ray).norm() / v.norm()
    k = 2 * BALL_RADIUS / (v.norm() * exposure * sine)
    assert float(alpha[y - 1 : y + 2, x].max()) == pytest.approx(float(k), rel=4e-3)


def test_the_pace_of_exact_opacity_is_one_over_speed_and_exposure():
    curve = line_curve(TILTED)
    samples, factor = pace_samples(curve, opacity_data(TILTED, curve), BALL_RADIUS)
    speed = math.sqrt(22**2 + 4**2 + 12**2)
    assert samples.shape == factor.shape == (120,)
    assert torch.allclose(samples, torch.full((120,), 1 / (speed * EXPOSURE)).double(), rtol=1e-6)
    data = opacity_data(TILTED, curve)
    assert torch.allclose(samples, data.opacity * factor)


def test_a_constant_speed_gets_a_constant_pace():
    curve = line_curve(TILTED)
    sizes, errors = [], []
    speed = math.sqrt(22**2 + 4**2 + 12**2)
    for seed in range(12):
        pace = fit_pace(curve, opacity_data(TILTED, curve, noise=1e-3, seed=seed), BALL_RADIUS)
        sizes.append(pace.basis.size)
        if pace.basis.size == 1:
            std = float(pace.inverse[0, 0].sqrt())
            errors.append((float(pace.coefficients[0]) - 1 / (speed * EXPOSURE)) / std)
    assert sizes.count(1) >= 10
    assert 0.5 < torch.tensor(errors).pow(2).mean().sqrt() < 1.6


def test_a_changing_speed_is_followed():
    curve = line_curve(FASTER)
    data = opacity_data(FASTER, curve)
    pace = fit_pace(curve, data, BALL_RADIUS)
    assert pace.basis.size > 1
    time = torch.linspace(0.2, 0.8, 9, dtype=torch.float64) * EXPOSURE
    exposures = pace.basis(s_of(curve, FASTER.position(time))) @ pace.coefficients
    speed = FASTER.velocity(time).norm(dim=-1)
    assert torch.allclose(1 / (exposures * EXPOSURE), speed, rtol=3e-3)


def test_profiles_without_weight_do_not_count():
    curve = line_curve(TILTED)
    data = opacity_data(TILTED, curve)
    opacity, weight = data.opacity.clone(), data.weight.clone()
    opacity[30:60] *= 3
    weight[30:60] = 0
    spoiled = OpacityData(
        s=data.s, rays=data.rays, opacity=opacity, covariance=data.covariance, weight=weight
    )
    pace = fit_pace(curve, spoiled, BALL_RADIUS)
    clean = fit_pace(curve, data, BALL_RADIUS)
    assert torch.allclose(pace.coefficients, clean.coefficients, rtol=1e-9)
    assert (pace.weight[30:60] == 0).all()


def constant_pace(path):
    speed = float(path.velocity(torch.zeros(1)).norm())
    return Pace(
        basis=SplineBasis(start=0.15 * LENGTH, stop=0.85 * LENGTH, size=1),
        coefficients=torch.tensor([1 / (speed * EXPOSURE)], dtype=torch.float64),
        inverse=torch.zeros(1, 1, dtype=torch.float64),
        weight=torch.ones(1, dtype=torch.float64),
    )


def test_the_clock_tells_the_share_of_the_exposure():
    curve = line_curve(TILTED)
    clock, rate = make_clock(curve, constant_pace(TILTED), 0.0, LENGTH)
    share = torch.linspace(0, 1, 23, dtype=torch.float64)
    s = s_of(curve, TILTED.position(share * EXPOSURE))
    assert torch.allclose(clock(s), share, atol=2e-5)
    middle = s[1:-1]
    slope = (clock(middle + 1.5) - clock(middle - 1.5)) / 3
    assert torch.allclose(rate(middle), slope, rtol=2e-3)
    assert (rate(s) > 0).all()


def test_the_clock_counts_from_its_own_start():
    curve = line_curve(TILTED)
    whole, _ = make_clock(curve, constant_pace(TILTED), -50.0, LENGTH + 50)
    part, _ = make_clock(curve, constant_pace(TILTED), 100.0, LENGTH)
    s = torch.tensor([100.0, 250.0, 400.0], dtype=torch.float64)
    assert float(part(s)[0]) == pytest.approx(0, abs=1e-12)
    assert torch.allclose(part(s), whole(s) - whole(s)[0], atol=1e-5)


@pytest.mark.parametrize("path", [TILTED, FASTER], ids=["constant", "accelerating"])
def test_the_motion_of_a_known_path(path):
    curve = line_curve(path)
    pace = fit_pace(curve, opacity_data(path, curve), BALL_RADIUS)
    motion = describe_motion(curve, pace, torch.tensor([0.0, LENGTH], dtype=torch.float64))
    time = torch.linspace(0, 1, PATH_POINTS, dtype=torch.float64) * EXPOSURE
    middle = torch.tensor([EXPOSURE / 2], dtype=torch.float64)
    tolerance = 2e-4 if path is TILTED else 0.03 * BALL_RADIUS
    assert torch.allclose(motion.position, path.position(middle)[0], atol=tolerance)
    assert torch.allclose(motion.path, path.position(time), atol=5 * tolerance)
    displacement = path.velocity(middle)[0] * EXPOSURE
    assert torch.allclose(motion.displacement, displacement, rtol=3e-3, atol=1e-6)
    # beyond the profiles (15 % at each end) the pace is taken to go on unchanged
    inner = slice(8, -8)
    assert torch.allclose(
        motion.path_displacement[inner], (path.velocity(time) * EXPOSURE)[inner], rtol=5e-3
    )
    assert float(motion.duration) == pytest.approx(1, abs=1e-3 if path is TILTED else 0.02)


def test_the_state_lists_everything_in_order():
    curve = line_curve(TILTED)
    motion = describe_motion(curve, constant_pace(TILTED), torch.tensor([0.0, LENGTH]).double())
    state = motion.state()
    assert state.shape == (8 + 3 * PATH_POINTS,)
    assert torch.equal(state[:3], motion.position)
    assert torch.equal(state[3:6], motion.displacement)
    assert float(state[6]) == pytest.approx(float(motion.displacement.norm()))
    assert float(state[7]) == float(motion.duration)
    assert torch.equal(state[8:].reshape(-1, 3), motion.path)
    assert torch.equal(motion.path[PATH_POINTS // 2], motion.position)


def test_ends_too_far_apart_for_the_opacity_are_seen():
    curve = line_curve(TILTED)
    pace = constant_pace(TILTED)
    wider = Pace(
        basis=pace.basis,
        coefficients=1.1 * pace.coefficients,
        inverse=pace.inverse,
        weight=pace.weight,
    )
    motion = describe_motion(curve, wider, torch.tensor([0.0, LENGTH]).double())
    assert float(motion.duration) == pytest.approx(1.1, abs=1e-3)


def test_propagate_is_exact_for_a_linear_map():
    generator = torch.Generator().manual_seed(0)
    A = torch.randn(5, 3, generator=generator, dtype=torch.float64)
    root = torch.randn(3, 3, generator=generator, dtype=torch.float64)
    covariance = root @ root.T
    found = propagate(lambda shift: A @ shift + 7, covariance)
    assert torch.allclose(found, A @ covariance @ A.T, atol=1e-10)


def test_propagate_bears_a_singular_covariance():
    covariance = torch.diag(torch.tensor([4.0, 0.0], dtype=torch.float64))
    found = propagate(lambda shift: torch.stack([shift.sum(), shift[1]]), covariance)
    assert torch.allclose(found, torch.tensor([[4.0, 0.0], [0.0, 0.0]]).double())


EDGE_STD, OPACITY_STD, END_STD = 0.15, 2e-3, 0.3
"""px, share, px of s."""
MIXED = -0.6
"""Correlation of half width and opacity: too wide a profile is too faint."""
PROFILES = 100
TRIALS = 40


def noisy_profiles(seed):
    """Edges and opacity whose errors are correlated as a profile fit's are; none for seed None."""
    curve = line_curve(TILTED)
    margin = 0.15 * EXPOSURE
    late = TILTED.position(torch.tensor([margin]))[0]
    inner = StraightPath(start=tuple(late.tolist()), start_velocity=TILTED.start_velocity)
    pixels = true_contours(inner, CAMERA, BALL_RADIUS, EXPOSURE - 2 * margin, PROFILES)
    pixels = pixels.transpose(0, 1)
    normal = torch.nn.functional.normalize(pixels[:, 1] - pixels[:, 0], dim=-1)
    std = torch.tensor([EDGE_STD, EDGE_STD, OPACITY_STD], dtype=torch.float64)
    correlation = torch.eye(3, dtype=torch.float64)
    correlation[1, 2] = correlation[2, 1] = MIXED
    covariance = (std[:, None] * correlation * std).expand(PROFILES, 3, 3)
    clean = opacity_data(TILTED, curve, count=PROFILES)
    error = torch.zeros(PROFILES, 3, dtype=torch.float64)
    if seed is not None:
        generator = torch.Generator().manual_seed(seed)
        white = torch.randn(PROFILES, 3, generator=generator, dtype=torch.float64)
        error = white @ torch.linalg.cholesky(covariance[0]).T
    sides = torch.stack([error[:, 0] - error[:, 1], error[:, 0] + error[:, 1]], dim=-1)
    edges = Edges(
        s=clean.s,
        pixels=pixels + sides[..., None] * normal[:, None],
        normal=normal,
        covariance=covariance[:, :2, :2],
        weight=clean.weight,
    )
    data = OpacityData(
        s=clean.s,
        rays=clean.rays,
        opacity=clean.opacity + error[:, 2],
        covariance=covariance,
        weight=clean.weight,
    )
    return curve, edges, data


def test_the_covariance_of_noise_agrees_with_repeating():
    curve, edges, data = noisy_profiles(None)
    ends = torch.tensor([0.0, LENGTH], dtype=torch.float64)
    ends_std = torch.full((2,), END_STD, dtype=torch.float64)
    axis = fit_axis(curve, edges, CAMERA, BALL_RADIUS, sizes=(2,))
    pace = fit_pace(axis.curve, data, BALL_RADIUS)
    covariance = noise_covariance(axis, data, pace, ends, ends_std, BALL_RADIUS)
    assert covariance.shape == (8 + 3 * PATH_POINTS,) * 2
    assert torch.allclose(covariance, covariance.mT)
    assert torch.linalg.eigvalsh(covariance).min() > -1e-12
    generator = torch.Generator().manual_seed(99)
    states = []
    for seed in range(TRIALS):
        _, edges, data = noisy_profiles(seed)
        fit = fit_axis(curve, edges, CAMERA, BALL_RADIUS, sizes=(2,))
        pace = fit_pace(fit.curve, data, BALL_RADIUS)
        moved = ends + END_STD * torch.randn(2, generator=generator, dtype=torch.float64)
        states.append(describe_motion(fit.curve, pace, moved).state())
    spread = torch.stack(states).std(0)
    ratio = (spread / covariance.diagonal().sqrt())[:8]
    # 11 % each for 40 trials
    assert 0.65 < float(ratio.min()) <= float(ratio.max()) < 1.45
