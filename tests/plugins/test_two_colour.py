from dataclasses import replace

import pytest
import torch

from plugins.two_colour import TwoColour
from toolkit import (
    Chord,
    ConfigError,
    LinearImage,
    NoiseModel,
    StreakError,
    measure,
)
from toolkit.synthetic import StripedBall, benchmark_scene, render_shot

RED, BLUE = (0.8, 0.1, 0.06), (0.06, 0.1, 0.8)
NOISE = NoiseModel(
    read_variance=torch.full((1, 3), 1e-4),
    gain=torch.zeros(1, 3),
    density=torch.ones(3),
)


def picture(colour, size=(12, 16)):
    rgb = torch.tensor(colour, dtype=torch.float32)[None, :, None, None].expand(1, 3, *size)
    return LinearImage(rgb=rgb.clone(), clipped=torch.zeros(1, 1, *size, dtype=torch.bool))


def test_the_plane_holds_both_pigments_and_all_their_mixtures_and_shades():
    normal = torch.tensor(TwoColour(colours=(RED, BLUE)).normal, dtype=torch.float64)
    mixtures = torch.rand(20, 2, dtype=torch.float64) @ torch.tensor([RED, BLUE]).double()
    assert (mixtures @ normal).abs().max() < 1e-7  # they come in single precision
    assert float(normal.norm()) == pytest.approx(1)


def test_the_opacity_does_not_depend_on_the_mixture():
    estimator, grey = TwoColour(colours=(RED, BLUE)), (0.4, 0.45, 0.35)
    for share in (0.0, 0.3, 1.0):
        mixture = torch.tensor(RED) * share + torch.tensor(BLUE) * (1 - share)
        shot = 0.3 * 0.7 * mixture + (1 - 0.3) * torch.tensor(grey)
        seen = estimator.observe(picture(shot.tolist()), picture(grey), NOISE)
        alpha, _ = estimator.alpha(seen)
        assert torch.allclose(alpha, torch.full_like(alpha, 0.3), atol=1e-5)


def test_the_variance_is_that_of_simulated_noise():
    estimator, grey = TwoColour(colours=(RED, BLUE)), (0.4, 0.45, 0.35)
    clean, shape = picture(grey, (80, 90)), (1, 3, 80, 90)
    torch.manual_seed(3)
    noisy = [replace(clean, rgb=clean.rgb + 0.01 * torch.randn(shape)) for _ in range(2)]
    seen = estimator.observe(*noisy, NOISE)
    spread = (seen.signal - seen.ground).var()
    assert float(seen.variance.mean()) == pytest.approx(float(spread), rel=0.05)


def test_several_backgrounds_are_less_noisy():
    estimator, grey = TwoColour(colours=(RED, BLUE)), (0.4, 0.45, 0.35)
    one = estimator.observe(picture(grey), picture(grey), NOISE)
    four = estimator.observe(picture(grey), replace(picture(grey), frames=4), NOISE)
    assert float(four.variance.mean() / one.variance.mean()) == pytest.approx(1.25 / 2)


def test_behind_a_mosaic_each_cell_counts_once():
    estimator, grey = TwoColour(colours=(RED, BLUE)), torch.tensor([0.4, 0.45, 0.35])
    pattern, size = ((0, 1), (1, 2)), 64
    torch.manual_seed(5)
    channel = torch.tensor(pattern).repeat(size // 2, size // 2)
    density = torch.tensor([0.25, 0.5, 0.25])
    pictures = [
        LinearImage(
            mosaic=(grey[channel] + 0.01 * torch.randn(size, size))[None, None],
            pattern=pattern,
            clipped=torch.zeros(1, 1, size, size, dtype=torch.bool),
        )
        for _ in range(2)
    ]
    seen = estimator.observe(*pictures, replace(NOISE, density=density))
    used = torch.isfinite(seen.variance)
    assert int(used.sum()) == size * size // 4
    # sums of many samples scatter as their variances say
    inner = used.clone()
    inner[..., :2, :] = inner[..., -2:, :] = inner[..., :2] = inner[..., -2:] = False
    difference = torch.where(inner, seen.signal - seen.ground, 0)
    blocks = difference[..., 2:-2, 2:-2].unfold(2, 10, 10).unfold(3, 10, 10).sum((-1, -2))
    expected = 25 * float(seen.variance[used].mean())
    assert float(blocks.var()) == pytest.approx(expected, rel=0.5)


def test_the_ball_itself_shows_nothing():
    chord = Chord(offset=torch.linspace(-1, 1, 7), direction=torch.zeros(1))
    assert torch.equal(TwoColour(colours=(RED, BLUE)).foreground(chord, None), torch.zeros(7, 1))


def test_a_background_in_the_plane_is_refused():
    purple = (0.43, 0.1, 0.43)
    with pytest.raises(StreakError, match="background lies in the plane of the ball's two colours"):
        TwoColour(colours=(RED, BLUE)).observe(picture(purple), picture(purple), NOISE)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({}, "needs the ball's two pigments, 0 given"),
        ({"colours": (RED,)}, "two pigments, 1 given"),
        ({"colours": (RED, BLUE, RED)}, "two pigments, 3 given"),
        ({"colours": (RED, (0.4, 0.05, 0.03))}, "nearly the same hue"),
        ({"colours": (RED, (0.0, 0.0, 0.0))}, "not all 0"),
        ({"colours": (RED, (float("nan"), 0.1, 0.1))}, "not three finite numbers"),
        ({"plane_normal": (0.0, 0.0, 0.0)}, "not all 0"),
    ],
)
def test_impossible_pigments_are_refused(options, reason):
    with pytest.raises(ConfigError, match=reason):
        TwoColour(**options)


def test_a_plane_serves_instead_of_pigments():
    by_colours = TwoColour(colours=(RED, BLUE))
    by_plane = TwoColour(plane_normal=tuple(3 * n for n in by_colours.normal))
    assert by_plane.normal == pytest.approx(by_colours.normal)


@pytest.fixture(scope="module")
def spinning():
    scene = benchmark_scene(width_px=60, length_widths=4, seed=4, tilt=0.15, heading=0.4)
    ball = StripedBall(colours=(RED, BLUE), pole=(0.3, 1.0, 0.2), spin=(900.0, 400.0, 200.0))
    return render_shot(replace(scene, appearance=ball), seed=4)


def test_a_striped_spinning_ball_is_measured(spinning):
    scene = spinning.scene
    result = measure(
        spinning.image,
        spinning.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=TwoColour(colours=(RED, BLUE)),
    )
    assert result.estimator == "two-colour"
    error = torch.tensor(result.position_m) - spinning.position
    std = torch.tensor(result.position_std_m)
    assert (error.abs() < 4 * std).all()
    assert std[2] < 0.25 * scene.ball_radius
    truth = float(spinning.velocity.norm())
    assert abs(result.speed_m_s - truth) < 4 * result.speed_std_m_s < 0.1 * truth
