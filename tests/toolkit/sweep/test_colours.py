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
    assert (found.slopes, found.design) == (None, None)


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
    assert ball.colour.shape == (3, len(pixels))
    alpha = seen.coverage.alpha
    error = pixels.signal - pixels.ground - alpha * (ball.colour - pixels.ground)
    assert error.abs().max() < 0.004
    assert error.square().mean().sqrt() < 4e-4
    # one colour for all of it would be off by far more
    mean = (ball.colour * alpha).sum(-1, keepdim=True) / alpha.sum()
    even = pixels.signal - pixels.ground - alpha * (mean - pixels.ground)
    assert even.square().mean() > 50 * error.square().mean()


def test_an_estimator_is_asked_along_the_path_and_for_parts_at_its_ends(shaded):
    seen: list[Chord] = []

    @dataclass(frozen=True, kw_only=True)
    class Watched(Lit):
        def foreground(self, chord, appearance):
            seen.append(chord)
            return super().foreground(chord, appearance)

    model = replace(shaded.model(), estimator=Watched())
    pixels = shaded.pixels()
    model.colours(shaded.truth(), pixels, model.opacity(shaded.truth(), pixels))
    whole, parts = [chord for chord in seen if chord.place is not None]
    assert (whole.start, whole.stop, parts.start) == (-1, 1, -1)
    assert parts.stop.shape == parts.offset.shape == parts.ray.shape[:-1]
    assert parts.stop.min() == -1
    assert parts.stop.max() == 1
    # rays meet the ball beside its middle when it is nearest to them
    line = shaded.scene.camera.project(shaded.points(2))
    along = torch.nn.functional.normalize(line[1] - line[0], dim=0)
    for chord in (whole, parts):
        assert (chord.ray.norm(dim=-1) - 1).abs().max() < 1e-12
        assert (chord.ray * chord.ahead).sum(-1).abs().max() < 1e-12
        aside = shaded.scene.camera.project(chord.ray) - chord.place
        assert (aside @ along).abs().max() < 0.02
        right = aside @ torch.stack([-along[1], along[0]])
        assert (right / 15 - chord.offset).abs().max() < 0.01
    # one width, the ball's half before and after included, to a fourth of a width or less
    centre = whole.place[:, 0]
    assert centre.diff(dim=0).norm(dim=-1).max() < 0.3 * 30
    assert ((centre - line[0]) @ along).min() < -0.5 * 30
    assert ((centre - line[1]) @ along).max() > 0.5 * 30


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
    """The ball's colour changes with the path too, and that of a cut chord with where it is cut."""
    model = replace(shaded.model(), estimator=Lit(is_scaled=is_scaled))
    k = STRAIGHT.size + 1
    x = shaded.truth()
    x = torch.cat([x[:k], torch.ones(int(is_scaled), dtype=torch.float64), x[k:]])
    pixels = shaded.pixels()
    scale = compare(model, x, pixels).information.diagonal().rsqrt()
    generator = torch.Generator().manual_seed(1)
    x = x + 2 * scale * torch.randn(len(x), generator=generator).double()
    seen = compare(model, x, pixels)
    expected = differences(
        lambda x: torch.tensor([compare(model, x, pixels).cost]).double(), x, 0.3 * scale
    )
    expected = expected[0] * scale / 2
    # how the blur changes the colour at the rim is left out
    assert (seen.gradient * scale - expected).norm() < 0.06 * expected.norm()
    assert model.opacity(x, pixels).alpha.max() > 0.4
