import math
from dataclasses import replace

import pytest
import torch

from toolkit.errors import ConfigError
from toolkit.synthetic import (
    LambertBall,
    LitBall,
    PanelledBall,
    PlainBall,
    StripedBall,
    benchmark_scene,
    mean_colour,
    pigments,
    render_sharp,
)

RED, BLUE = (0.8, 0.1, 0.1), (0.1, 0.2, 0.7)
BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
SPIN = (300.0, -500.0, 400.0)


def directions(count=20_000, seed=0):
    generator = torch.Generator().manual_seed(seed)
    vectors = torch.randn(count, 3, dtype=torch.float64, generator=generator)
    return torch.nn.functional.normalize(vectors, dim=-1)


def patterns(colours=(RED, BLUE), spin=(0.0, 0.0, 0.0)):
    return [StripedBall(colours=colours, spin=spin), PanelledBall(colours=colours, spin=spin)]


def turn(axis, angle):
    """Rotation matrix by the matrix exponential."""
    x, y, z = torch.nn.functional.normalize(torch.tensor(axis).double(), dim=0) * angle
    zero = torch.zeros_like(x)
    generator = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    return torch.matrix_exp(generator)


def plane_normal(colours):
    first, second = torch.tensor(colours, dtype=torch.float64)
    return torch.nn.functional.normalize(torch.linalg.cross(first, second), dim=0)


def test_a_football_has_twelve_pentagons_that_cover_28_percent():
    ball = PanelledBall(colours=(WHITE, BLACK))
    light = ball(directions(200_000), 0.0)[:, 0]
    # solid angle of a pentagon of a truncated icosahedron seen from its centre: 0.29546 sr
    assert float(1 - light.mean()) == pytest.approx(12 * 0.29546 / (4 * math.pi), abs=3e-3)
    golden = (1 + math.sqrt(5)) / 2
    vertices = torch.tensor([(0.0, i, j * golden) for i in (1, -1) for j in (1, -1)])
    vertices = torch.cat([vertices.roll(k, dims=1) for k in range(3)]).double()
    vertices = torch.nn.functional.normalize(vertices, dim=-1)
    assert (ball(vertices, 0.0) == 0).all()
    middles = torch.nn.functional.normalize(vertices[:, None] + vertices, dim=-1)
    is_edge = (vertices @ vertices.mT - 1 / math.sqrt(5)).abs() < 1e-6
    assert int(is_edge.sum()) == 60
    assert (ball(middles[is_edge], 0.0) == 1).all()


@pytest.mark.parametrize("index", [0, 1])
def test_spin_is_a_rotation_of_the_body(index):
    time = 0.0123
    still, spinning = patterns()[index], patterns(spin=SPIN)[index]
    normal = directions()
    rotation = turn(SPIN, math.hypot(*SPIN) * time)
    expected = still(normal @ rotation, 0.0)  # rows: R' n, the body's own coordinates
    differs = (spinning(normal, time) != expected).any(-1)
    assert differs.double().mean() < 1e-3  # at most along an edge, by rounding
    assert torch.equal(spinning(normal, 0.0), still(normal, 0.0))


@pytest.mark.parametrize("index", [0, 1])
def test_several_turns_average_each_latitude_about_the_spin(index):
    axis = torch.nn.functional.normalize(torch.tensor(SPIN).double(), dim=0)
    turns = 5
    exposure = turns * 2 * math.pi / math.hypot(*SPIN)
    ball, still = patterns(spin=SPIN)[index], patterns()[index]
    normal = directions(40)
    times = (torch.arange(2000) + 0.5) * exposure / 2000
    mean = torch.stack([ball(normal, float(t)) for t in times]).mean(0)
    # the mean over the circle of latitude, taken on the still ball
    circle = [turn(SPIN, 2 * math.pi * (i + 0.5) / 1000) for i in range(1000)]
    expected = torch.stack([still(normal @ r, 0.0) for r in circle]).mean(0)
    assert (mean - expected).abs().max() < 0.01
    # mirrored through the axis, the same latitude: the same mean
    opposite = 2 * (normal @ axis)[:, None] * axis - normal
    again = torch.stack([ball(opposite, float(t)) for t in times]).mean(0)
    assert (mean - again).abs().max() < 0.01
    assert mean.std(dim=0).max() > 0.02  # but not one colour all over


@pytest.mark.parametrize("index", [0, 1])
def test_white_light_keeps_pigments_and_their_mixtures_in_their_plane(index):
    ball = LitBall(pattern=patterns(spin=SPIN)[index], ambient=0.2)
    normal = directions(2000)
    light = torch.stack([ball(normal, t / 1000) for t in range(20)]).mean(0)
    assert (light @ plane_normal((RED, BLUE))).abs().max() < 1e-12
    assert float(light.norm(dim=-1).max() / light.norm(dim=-1).min()) > 3


def test_highlights_and_coloured_lamps_leave_the_plane():
    pattern, normal = patterns()[0], directions()
    plane = plane_normal((RED, BLUE))
    glossy = LitBall(pattern=pattern, highlight=0.5)(normal, 0.0) @ plane
    assert glossy.abs().max() > 0.05
    assert (glossy.abs() < 1e-6).double().mean() > 0.4  # the highlight is small
    warm = LitBall(pattern=pattern, light_colour=(1.0, 0.7, 0.3))(normal, 0.0) @ plane
    assert warm.abs().max() > 0.02


def test_the_light_stays_while_the_ball_spins():
    ball = LitBall(pattern=PanelledBall(colours=(WHITE, WHITE), spin=SPIN), highlight=0.3)
    normal = directions(100)
    assert torch.allclose(ball(normal, 0.0), ball(normal, 0.0137))


def test_shade_falls_with_the_cosine_down_to_the_ambient_light():
    ball = LitBall(pattern=PlainBall(colour=RED), light=(0.0, -2.0, 0.0), ambient=0.25)
    normal = torch.tensor([[0.0, -1.0, 0.0], [0.0, -0.6, -0.8], [0.0, 0.6, -0.8]]).double()
    shares = ball(normal, 0.0) / torch.tensor(RED).double()
    expected = torch.tensor([1.0, 0.25 + 0.75 * 0.6, 0.25]).double()
    assert torch.allclose(shares, expected[:, None].expand(3, 3))


def test_the_highlight_lies_half_way_between_lamp_and_camera():
    dark = LitBall(pattern=PlainBall(colour=BLACK), highlight=0.4, light=(-1.0, 0.0, 0.0))
    normal = directions()
    brightest = normal[dark(normal, 0.0)[:, 0].argmax()]
    half = torch.tensor([-1.0, 0.0, -1.0]).double() / math.sqrt(2)
    assert float(brightest @ half) > 0.999
    assert float(dark(half[None], 0.0).max()) == pytest.approx(0.4)


def test_a_lambert_ball_is_a_lit_plain_one():
    lambert = LambertBall(colour=RED, light=(1.0, -1.0, 0.0), ambient=0.4, highlight=0.2, gloss=9)
    lit = LitBall(
        pattern=PlainBall(colour=RED), light=(1.0, -1.0, 0.0), ambient=0.4, highlight=0.2, gloss=9
    )
    assert torch.equal(lambert(directions(50), 0.0), lit(directions(50), 0.0))


@pytest.mark.parametrize("changes", [{"ambient": 1.2}, {"highlight": -0.1}, {"gloss": 0.0}])
def test_impossible_light_is_refused(changes):
    with pytest.raises(ConfigError, match="ambient light"):
        LitBall(pattern=PlainBall(colour=RED), **changes)


def test_the_mean_colour_is_that_of_the_rendered_disc():
    scene = replace(
        benchmark_scene(width_px=60, length_widths=3, blur=0.0),
        appearance=LitBall(pattern=PanelledBall(colours=(RED, BLUE)), highlight=0.2),
    )
    sharp = render_sharp(scene)
    ball = sharp.clean_image - (1 - sharp.alpha) * scene.background
    mean = ball.sum(dim=(1, 2)) / sharp.alpha.sum()
    assert mean_colour(scene.appearance, scene.exposure) == pytest.approx(mean.tolist(), abs=4e-3)
    times = []
    mean_colour(lambda normal, time: times.append(time) or normal, 0.5)
    assert 0 < min(times) < 0.01
    assert 0.49 < max(times) < 0.5


def test_pigments_are_found_under_any_light():
    assert pigments(PlainBall(colour=RED)) == pigments(LambertBall(colour=RED)) == (RED,)
    for pattern in patterns():
        assert pigments(pattern) == pigments(LitBall(pattern=pattern)) == (RED, BLUE)
    assert pigments(lambda normal, time: normal) == ()
