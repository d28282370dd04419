import math
from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit import Chord, ConfigError, LinearImage, NoiseModel

BALL = (0.8, 0.4, 0.1)
NOISE = NoiseModel(
    read_variance=torch.tensor([[1e-4, 4e-4, 1e-4]]),
    gain=torch.tensor([[1e-3, 0.0, 2e-3]]),
    density=torch.ones(3),
)


def image(rgb, frames=1):
    return LinearImage(rgb=rgb, clipped=torch.zeros_like(rgb[:, :1]).bool(), frames=frames)


def mixture(alpha, ground, colour=BALL):
    ball = torch.tensor(colour)[:, None, None]
    return alpha * ball + (1 - alpha) * ground


@pytest.fixture
def ground():
    generator = torch.Generator().manual_seed(0)
    return 0.1 + 0.4 * torch.rand(1, 3, 6, 11, generator=generator)


def test_alpha_of_known_mixtures(ground):
    alpha = torch.linspace(0, 1, 11).expand(1, 1, 6, 11)
    estimator = Uniform(colour=BALL)
    observation = estimator.observe(image(mixture(alpha, ground)), image(ground), NOISE)
    found, variance = estimator.alpha(observation)
    assert found.shape == (1, 1, 6, 11)
    assert variance.shape == (1, 1, 6, 11)
    assert torch.allclose(found, alpha, atol=1e-5)


def test_observe_hands_colours_on_and_adds_both_noises():
    ground = torch.tensor([0.2, 0.3, 0.4])[:, None, None].expand(1, 3, 6, 11)
    shot = mixture(torch.full((1, 1, 6, 11), 0.3), ground)
    observation = Uniform(colour=BALL).observe(image(shot), image(ground, frames=4), NOISE)
    assert torch.equal(observation.signal, shot)
    assert torch.equal(observation.ground, ground)
    expected = NOISE.variance(shot) + NOISE.variance(ground) / 4
    assert torch.allclose(observation.variance, expected)
    red = 1e-4 + 1e-3 * shot[0, 0] + (1e-4 + 1e-3 * ground[0, 0]) / 4
    assert torch.allclose(observation.variance[0, 0], red)


def test_behind_a_mosaic_only_measured_channels_count(ground):
    shot = replace(image(ground), mosaic=ground[:, :1], pattern=((0, 1), (1, 2)))
    variance = Uniform(colour=BALL).observe(shot, image(ground), NOISE).variance
    known = torch.isfinite(variance[0])
    assert (known.sum(0) == 1).all()
    assert known[0, 0, 0]
    assert known[1, 0, 1]
    assert known[2, 1, 1]
    # what is measured there counts as a raw sample
    assert float(variance[0, 1, 0, 1]) == pytest.approx(2 * 4e-4, rel=1e-5)


def test_the_variance_of_alpha_is_seen_when_repeating():
    generator = torch.Generator().manual_seed(1)
    ground = torch.tensor([0.2, 0.3, 0.5])[:, None, None].expand(1, 3, 100, 100)
    alpha = torch.full((1, 1, 100, 100), 0.25)
    clean = mixture(alpha, ground)

    def noisy(picture):
        std = NOISE.variance(picture).sqrt()
        return picture + std * torch.randn(picture.shape, generator=generator)

    estimator = Uniform(colour=BALL)
    observation = estimator.observe(image(noisy(clean)), image(ground), NOISE)
    # the ground is known exactly here
    found, variance = estimator.alpha(replace(observation, variance=NOISE.variance(clean)))
    assert float(found.var()) == pytest.approx(float(variance.mean()), rel=0.05)
    assert float(found.mean()) == pytest.approx(0.25, abs=0.005)


def test_the_weights_lower_the_variance():
    """Three channels weighed by noise and contrast beat the best of them alone."""
    ground = torch.full((1, 3, 4, 4), 0.3)
    estimator = Uniform(colour=BALL)
    observation = estimator.observe(image(ground), image(ground), NOISE)
    _, variance = estimator.alpha(observation)
    contrast = torch.tensor(BALL)[:, None, None] - ground[0]
    single = (observation.variance[0] / contrast**2).amin(0)
    assert (variance[0, 0] < single).all()


def test_foreground_is_one_colour_on_every_chord():
    estimator = Uniform(colour=BALL)
    offset = torch.linspace(-1, 1, 9, dtype=torch.float64).expand(2, 5, 9)
    chord = Chord(offset=offset, direction=torch.zeros(2, 5, 1, dtype=torch.float64))
    foreground = estimator.foreground(chord, None)
    assert foreground.shape == (2, 5, 9, 3)
    assert foreground.dtype == torch.float64
    assert torch.allclose(foreground, torch.tensor(BALL).double(), atol=1e-7)
    value, slope = estimator.foreground_and_slope(chord)
    assert torch.equal(value, foreground)
    assert slope is None


def test_where_the_ball_has_the_background_s_colour_nothing_is_known():
    ground = torch.tensor(BALL)[:, None, None].expand(1, 3, 2, 2)
    estimator = Uniform(colour=BALL)
    found, variance = estimator.alpha(estimator.observe(image(ground), image(ground), NOISE))
    assert torch.isfinite(found).all()
    assert (variance > 1e6).all()


@pytest.mark.parametrize(
    "colour",
    [(0.5, 0.5), (0.5, 0.5, 0.5, 0.5), (0.5, -0.1, 0.5), (0.5, math.nan, 0.5), (255, 120, 0)],
)
def test_a_bad_colour_is_refused(colour):
    with pytest.raises(ConfigError, match="not three linear values R,G,B, sensor white = 1"):
        Uniform(colour=colour)


def test_its_option_can_be_set_by_name():
    assert Uniform.option_names() == ("colour",)
