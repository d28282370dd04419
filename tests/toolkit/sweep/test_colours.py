from dataclasses import dataclass, replace

import pytest
import torch

from plugins.two_colour import TwoColour
from plugins.uniform import Uniform
from toolkit import AlphaEstimator, Chord, Observation
from toolkit.sweep.colours import count_channels, is_plain, plain_colours
from toolkit.sweep.likelihood import compare
from toolkit.sweep.paths import STRAIGHT
from toolkit.synthetic import LambertBall

LAMP = LambertBall(colour=(0.8, 0.5, 0.2), light=(-0.8, -0.4, -0.6), ambient=0.4)
COUNT = 20


@dataclass(frozen=True, kw_only=True)
class Lit(AlphaEstimator):
    """A ball lit by a known lamp, its chords averaged by brute force, seen from afar."""

    ball: LambertBall = LAMP
    is_scaled: bool = False
    """Whether a factor on all its light is left open."""

    def observe(self, image, background, noise):
        variance = noise.variance(image.rgb)
        return Observation(signal=image.rgb, ground=background.rgb, variance=2 * variance)

    def unknowns(self):
        return int(self.is_scaled)

    def foreground(self, chord, appearance):
        offset, direction = chord.offset[..., None], chord.direction[..., None]
        start, stop = (
            torch.as_tensor(end).double()[..., None] for end in (chord.start, chord.stop)
        )
        share = (torch.arange(COUNT, dtype=torch.float64) + 0.5) / COUNT
        s = offset.clamp(-0.999, 0.999)
        along = (1 - s * s).sqrt() * (start + (stop - start) * share)
        x = -direction.sin() * s + direction.cos() * along
        y = direction.cos() * s + direction.sin() * along
        z = -(1 - x * x - y * y).clamp_min(1e-9).sqrt()
        normal = torch.stack(torch.broadcast_tensors(x, y, z), dim=-1)
        light = self.ball(normal.reshape(-1, 3), 0.0).reshape(normal.shape).mean(-2)
        return light if appearance is None else light * appearance[0]


def lit(scene):
    return replace(scene, appearance=LAMP)


def test_a_plain_ball_shows_the_same_on_every_chord():
    assert is_plain(Uniform(colour=(0.3, 0.2, 0.1)))
    assert is_plain(Uniform())
    assert not is_plain(Lit())
    found = plain_colours(Uniform(colour=(0.3, 0.2, 0.1)), torch.zeros(0))
    assert torch.allclose(found.colour, torch.tensor([[0.3], [0.2], [0.1]]).double())
    assert (found.slope, found.design) == (None, None)


def test_an_open_colour_is_linear_in_itself():
    looks = torch.tensor([0.3, 0.2, 0.1], dtype=torch.float64)
    found = plain_colours(Uniform(), looks)
    assert torch.allclose(found.colour[:, 0], looks)
    assert torch.equal(found.design[..., 0], torch.eye(3, dtype=torch.float64))


def test_channels_are_counted():
    assert count_channels(Uniform()) == count_channels(Lit()) == 3
    assert count_channels(TwoColour(colours=((0.8, 0.1, 0.1), (0.1, 0.1, 0.8)))) == 1


@pytest.fixture(scope="module")
def shaded(streak):
    """From so far that the ball looks the same all along its path."""
    return streak(Lit(), lit, length_widths=2.0, distance_R=200.0)


def test_the_model_shows_what_is_rendered_the_ends_included(shaded):
    pixels = shaded.clean().pixels()
    seen = compare(shaded.model(), shaded.truth(), pixels)
    ball = shaded.model().colours(shaded.truth(), pixels, seen.coverage)
    assert ball.colour.shape == ball.slope.shape == (3, len(pixels))
    alpha = seen.coverage.alpha
    error = pixels.signal - pixels.ground - alpha * (ball.colour - pixels.ground)
    assert error.abs().max() < 0.012
    assert error.square().mean().sqrt() < 1e-3
    # one colour for all of it would be off by far more
    mean = (ball.colour * alpha).sum(-1, keepdim=True) / alpha.sum()
    even = pixels.signal - pixels.ground - alpha * (mean - pixels.ground)
    assert even.square().mean() > 50 * error.square().mean()


def test_both_ends_show_parts_of_chords(shaded):
    """At its first image only the leading part of the ball has passed a ray, and the other way."""
    seen: list[Chord] = []

    @dataclass(frozen=True, kw_only=True)
    class Watched(Lit):
        def foreground(self, chord, appearance):
            seen.append(chord)
            return super().foreground(chord, appearance)

    model = replace(shaded.model(), estimator=Watched())
    pixels = shaded.pixels()
    model.colours(shaded.truth(), pixels, model.opacity(shaded.truth(), pixels))
    cut = [chord for chord in seen if isinstance(chord.start, torch.Tensor)]
    assert cut
    start = torch.cat([chord.start.flatten() for chord in cut])
    stop = torch.cat([chord.stop.flatten() for chord in cut])
    assert (start <= stop).all()
    assert (start.abs() <= 1).all()
    assert (stop.abs() <= 1).all()
    # cut at the beginning, at the end, or both, but not at neither
    assert ((start > -1) | (stop < 1)).all()
    assert bool(((start > -1) & (stop == 1)).any())
    assert bool(((start == -1) & (stop < 1)).any())
    place = torch.cat([chord.place for chord in seen if chord.place is not None])
    middle = shaded.scene.camera.project(shaded.points())
    assert torch.cdist(place, middle).amin(1).max() < 1.5


def test_offsets_are_positive_to_the_right_of_the_motion(shaded):
    model, pixels = shaded.model(), shaded.pixels()
    x = shaded.truth()
    covered = model.opacity(x, pixels)
    first, last = shaded.scene.camera.project(shaded.points(2))
    along = (last - first) / (last - first).norm()
    aside = pixels.place - first
    # y points down: to the right of (1, 0) is (0, 1)
    distance = along[0] * aside[:, 1] - along[1] * aside[:, 0]
    is_clear = distance.abs() > 1
    assert torch.equal((covered.passage.side > 0)[is_clear], (distance > 0)[is_clear])


@pytest.mark.parametrize("is_scaled", [False, True])
def test_the_gradient_follows_the_colours(shaded, differences, is_scaled):
    """The ball's colour changes with the path too: by the slope across the chord."""
    model = replace(shaded.model(), estimator=Lit(is_scaled=is_scaled))
    k = STRAIGHT.size + 1
    x = shaded.truth()
    x = torch.cat([x[:k], torch.ones(int(is_scaled), dtype=torch.float64), x[k:]])
    pixels = shaded.pixels()
    scale = compare(model, x, pixels).information.diagonal().rsqrt()
    generator = torch.Generator().manual_seed(1)
    x = x + 3 * scale * torch.randn(len(x), generator=generator).double()
    seen = compare(model, x, pixels)
    expected = differences(
        lambda x: torch.tensor([compare(model, x, pixels).cost]).double(), x, 0.3 * scale
    )
    expected = expected[0] * scale / 2
    # how the mean colour of a cut chord changes with the path is left out
    assert (seen.gradient * scale - expected).norm() < 0.15 * expected.norm()
    assert model.opacity(x, pixels).alpha.max() > 0.4
