"""What is special about a chroma key."""

import pytest
import torch
from chroma_key import ChromaKey

from toolkit import ConfigError, LinearImage, NoiseModel, measure, registry
from toolkit.synthetic import StripedBall
from toolkit.testing import make_sample

GREEN = (0.1, 0.5, 0.15)
GREY = (0.8, 0.8, 0.8)
NOISE = NoiseModel(
    read_variance=torch.full((1, 3), 1e-4), gain=torch.zeros(1, 3), density=torch.ones(3)
)


def picture(*colours: tuple[float, float, float]) -> LinearImage:
    """Make a picture one pixel high."""
    rgb = torch.tensor(colours).T[None, :, None, :]
    return LinearImage(rgb=rgb, clipped=torch.zeros_like(rgb[:, :1], dtype=torch.bool))


def test_the_toolkit_finds_it():
    """The entry point leads to the class."""
    assert registry.load("chroma-key") is ChromaKey


def test_every_grey_hides_the_screen_alike():
    """Alpha is that of the mixture, whatever the grey."""
    mixtures = [tuple(0.3 * grey + 0.7 * part for part in GREEN) for grey in (0.0, 0.2, 0.5, 0.9)]
    seen = ChromaKey().observe(picture(*mixtures), picture(*4 * [GREEN]), NOISE)
    assert torch.allclose(seen.signal, torch.tensor(0.3))


@pytest.mark.parametrize(("screen", "channel"), [("red", 0), ("green", 1), ("blue", 2)])
def test_each_screen_is_keyed(screen, channel):
    """An empty screen of each colour has alpha 0."""
    colour = [0.1, 0.1, 0.1]
    colour[channel] = 0.6
    seen = ChromaKey(screen=screen).observe(picture(tuple(colour)), picture(tuple(colour)), NOISE)
    assert float(seen.signal.abs().max()) < 1e-6


def test_what_is_no_screen_is_not_used():
    """A grey background tells nothing; its variance is infinite."""
    seen = ChromaKey().observe(picture(GREY, GREY), picture((0.3, 0.3, 0.3), GREEN), NOISE)
    assert torch.isinf(seen.variance[0, 0, 0]).tolist() == [True, False]
    assert torch.isfinite(seen.signal).all()


def test_a_spinning_pattern_is_measured():
    """Black and white stripes that turn, which no single colour describes."""
    stripes = StripedBall(colours=((0.85, 0.85, 0.85), (0.05, 0.05, 0.05)), spin=(0.0, 400.0, 0.0))
    sample = make_sample(stripes, background_colour=GREEN)
    scene = sample.shot.scene
    ball = measure(
        sample.image,
        sample.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=ChromaKey(),
    )
    error = torch.tensor(ball.position_m, dtype=torch.float64) - sample.shot.position
    assert float(error.norm()) < 0.3 * scene.ball_radius
    speed = float(sample.shot.velocity.norm())
    assert ball.speed_m_s == pytest.approx(speed, rel=0.02)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"screen": "pink"}, "screen is 'pink'; it must be one of red, green, blue"),
        ({"least_key": 0.0}, "least_key is 0.0; a number between 0 and 1"),
    ],
)
def test_a_bad_option_is_refused(options, reason):
    """Each names the option and what it must be."""
    with pytest.raises(ConfigError, match=reason):
        ChromaKey(**options)
