import pytest
import torch

from toolkit.sweep.paths import PARABOLA, STRAIGHT, BouncePath, SplinePath
from toolkit.synthetic import BouncingPath

PATHS = {
    "straight": STRAIGHT,
    "parabola": PARABOLA,
    "chain of lines": SplinePath(1, 3),
    "spline": SplinePath(2, 4),
    "corner": BouncePath((0.1,), is_accelerated=False),
    "bounce": BouncePath((-0.2,)),
    "two bounces": BouncePath((-0.2, 0.3)),
}
TIME = torch.linspace(-0.7, 0.7, 29, dtype=torch.float64)  # beyond the exposure too


@pytest.fixture(params=PATHS, ids=str)
def path(request):
    return PATHS[request.param]


def parameters_of(path, seed=0):
    """Numbers of a few metres; instants where the path has them."""
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(path.size, generator=generator, dtype=torch.float64)
    if isinstance(path, BouncePath):
        x[-len(path.instants) :] = torch.tensor(path.instants) + 0.03
    return x


def test_arcs_follow_one_another(path):
    x = parameters_of(path)
    arcs = path.arcs(x)
    assert x.shape == (path.size,)
    assert arcs.coefficients.shape == (len(arcs.joints) + 1, 3, 3)
    assert arcs.J.shape == (len(arcs.coefficients), 9, path.size)
    assert (arcs.joints.diff() > 0).all()
    for instant, before, after in zip(
        arcs.joints, arcs.coefficients[:-1], arcs.coefficients[1:], strict=True
    ):
        powers = instant ** torch.arange(3)
        assert torch.allclose(powers @ before, powers @ after)
        slope = torch.tensor([0.0, 1.0, 2 * float(instant)]).double()
        is_smooth = torch.allclose(slope @ before, slope @ after)
        assert is_smooth == (isinstance(path, SplinePath) and path.degree == 2)


def test_velocity_is_the_change_of_position(path):
    arcs = path.arcs(parameters_of(path))
    time = TIME[(TIME[:, None] - arcs.joints).abs().amin(-1) > 1e-3] if len(arcs.joints) else TIME
    step = 1e-5
    _, velocity = arcs.at(time)
    change = (arcs.at(time + step)[0] - arcs.at(time - step)[0]) / (2 * step)
    assert torch.allclose(velocity, change, atol=1e-8)


def test_derivatives_agree_with_differences(path, differences):
    x = parameters_of(path)
    arcs = path.arcs(x)
    steps = torch.full_like(x, 1e-5)
    J = differences(lambda x: path.arcs(x).coefficients.flatten(1), x, steps)
    assert torch.allclose(arcs.J, J, atol=1e-8)
    J_position, J_velocity = arcs.J_at(TIME)
    assert torch.allclose(
        J_position, differences(lambda x: path.arcs(x).at(TIME)[0], x, steps), atol=1e-8
    )
    assert torch.allclose(
        J_velocity, differences(lambda x: path.arcs(x).at(TIME)[1], x, steps), atol=1e-8
    )


def test_a_path_goes_through_its_own_points(path):
    x = parameters_of(path)
    if isinstance(path, BouncePath):
        x[-len(path.instants) :] = torch.tensor(path.instants)
    time = torch.linspace(-0.5, 0.5, 65, dtype=torch.float64)
    found = path.through(time, path.arcs(x).at(time)[0])
    assert torch.allclose(found, x, atol=1e-9)


def test_the_nearest_path_is_taken():
    time = torch.linspace(-0.5, 0.5, 65, dtype=torch.float64)
    bent = torch.stack([time, time**2, 0 * time], dim=-1)
    straight = STRAIGHT.arcs(STRAIGHT.through(time, bent)).at(time)[0]
    assert torch.allclose(straight, torch.stack([time, (time**2).mean() + 0 * time, 0 * time], -1))


def test_vectors_turn_with_the_world(path):
    """The leading parameters make up vectors: turning them turns the path."""
    x = parameters_of(path)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)).double())[
        0
    ]
    turned = x.clone()
    turned[: path.vectors] = (x[: path.vectors].reshape(-1, 3) @ turn.mT).flatten()
    position, velocity = path.arcs(x).at(TIME)
    expected = position @ turn.mT, velocity @ turn.mT
    for found, wanted in zip(path.arcs(turned).at(TIME), expected, strict=True):
        assert torch.allclose(found, wanted, atol=1e-12)


def test_exposures_are_cut_at_the_joints():
    arcs = SplinePath(2, 4).arcs(parameters_of(SplinePath(2, 4)))
    start = torch.tensor([-0.5, -0.3, 0.1, 0.4], dtype=torch.float64)
    stop = start + 0.35
    parts = arcs.limits(start, stop)
    assert len(parts) == 4
    lengths = torch.stack([high - low for low, high in parts])
    assert (lengths >= 0).all()
    assert torch.allclose(lengths.sum(0), stop - start)
    for (low, high), left, right in zip(
        parts, (-9.0, -0.25, 0.0, 0.25), (-0.25, 0.0, 0.25, 9.0), strict=True
    ):
        is_seen = high > low
        assert (low[is_seen] >= left).all()
        assert (high[is_seen] <= right).all()


def test_a_real_bounce_is_such_a_path():
    ball = BouncingPath(start=(0.0, 0.0, 2.0), start_velocity=(1.0, 2.0, 0.3), contact_height=0.3)
    exposure = 0.25
    time = torch.linspace(-0.5, 0.5, 65, dtype=torch.float64)
    points = ball.position((time + 0.5) * exposure)
    path = BouncePath((ball.bounce_time / exposure - 0.5,))
    x = path.through(time, points)
    assert torch.allclose(path.arcs(x).at(time)[0], points, atol=1e-9)
    # half of it, m per exposure^2
    bend = torch.tensor([0, 9.81, 0], dtype=torch.float64) * exposure**2 / 2
    assert torch.allclose(path.arcs(x).coefficients[:, 2], bend.expand(2, 3), atol=1e-9)
