import functools
import math
from dataclasses import replace

import pytest
import torch

from plugins.two_colour import TwoColour
from plugins.uniform import Uniform
from toolkit.motion import SPEED
from toolkit.sweep.doubt import J_state, motion_of
from toolkit.sweep.likelihood import compare
from toolkit.sweep.paths import PARABOLA, STRAIGHT, BouncePath
from toolkit.sweep.pixels import Frame
from toolkit.sweep.shade import Shaded
from toolkit.synthetic import PlainBall, StraightPath
from toolkit.view import observe_streak

SEEDS = 40


def moved(x, information, seed=0, size=1.0):
    """Parameters about `size` standard deviations from x, each on its own."""
    generator = torch.Generator().manual_seed(seed)
    step = torch.randn(len(x), generator=generator, dtype=torch.float64)
    return x + size * step * information.diagonal().rsqrt()


def check_gradient(model, x, pixels, differences, limit=0.02):
    """Half the cost's derivative, each parameter in its own standard deviation."""
    scale = compare(model, x, pixels).information.diagonal().rsqrt()
    x = moved(x, compare(model, x, pixels).information, size=3.0)
    gradient = compare(model, x, pixels).gradient * scale
    costs = differences(
        lambda x: torch.tensor([compare(model, x, pixels).cost]).double(), x, 0.3 * scale
    )
    expected = costs[0] * scale / 2
    assert (gradient - expected).norm() < limit * expected.norm()
    # no part may hide behind the largest one
    assert (gradient - expected).abs().max() < 0.02 * expected.abs().max() + 0.3


@pytest.mark.parametrize("colour", ["known", "unknown"])
@pytest.mark.parametrize("path", [STRAIGHT, PARABOLA], ids=["straight", "parabola"])
def test_the_gradient_is_that_of_the_cost(streak, differences, colour, path):
    seen = streak(None if colour == "known" else Uniform(), length_widths=1.0)
    check_gradient(seen.model(path), seen.truth(path), seen.pixels(), differences)


def test_it_is_on_squares_of_pixels(streak, differences):
    seen = streak(Uniform(), length_widths=1.0)
    check_gradient(seen.model(), seen.truth(), seen.pixels(2), differences)


def test_it_is_for_a_bounce(streak, differences):
    """The instant of the bounce among the parameters."""
    path = BouncePath((0.1,))
    seen = streak(length_widths=2.0)
    check_gradient(seen.model(path), seen.truth(path), seen.pixels(), differences, limit=0.04)


def test_it_is_for_channels_that_mix_colours(streak, differences):
    seen = streak(length_widths=1.0)
    estimator = TwoColour(colours=(seen.scene.appearance.colour, (0.02, 0.02, 0.9)))
    view = observe_streak(seen.shot.image, seen.shot.background, estimator)
    pixels = Frame.of(view, estimator, seen.scene.camera).about(
        seen.scene.camera.project(seen.points()), 16.0
    )
    two = replace(seen, estimator=estimator)
    assert two.model().channels == 1
    assert len(two.truth()) == STRAIGHT.size + 1 + 2
    check_gradient(two.model(), two.truth(), pixels, differences)


def test_it_is_for_a_shaded_ball(streak, differences):
    """Its colour depends on where on the disc a ray passes, and so on the path."""
    seen = streak(length_widths=2.0)
    shaded = Shaded(estimator=seen.estimator, channels=3)
    model = replace(seen.model(), estimator=shaded, shade_std=0.1)
    x, k = seen.truth(), STRAIGHT.size + 1
    lean = torch.tensor([0.03, 0.0, -0.02, 0.0, 0.02, 0.01], dtype=torch.float64)
    x = torch.cat([x[:k], lean, x[k:]])
    # the offset's change follows the disc's middle, not the spread over each pixel
    check_gradient(model, x, seen.pixels(), differences, limit=0.05)


def test_channels_that_were_not_measured_count_for_nothing(streak):
    seen = streak(length_widths=1.0)
    frame, half = seen.frame(), seen.frame()
    shot = frame.shot_variance.clone()
    shot[1] = torch.inf
    half = replace(frame, shot_variance=shot)
    middle = seen.scene.camera.project(seen.points())
    whole, two = (
        compare(seen.model(), seen.truth(), one.about(middle, 16.0)) for one in (frame, half)
    )
    assert (two.residual[1] == 0).all()
    assert torch.equal(two.residual[::2], whole.residual[::2])
    assert torch.isfinite(two.gradient).all()
    assert two.cost < whole.cost


def test_far_pixels_count_linearly(streak):
    seen = streak(length_widths=1.0)
    pixels = seen.pixels()
    costs = []
    for size in (1.0, 2.0):
        signal = pixels.signal.clone()
        signal[:, 5] += size
        costs.append(compare(seen.model(), seen.truth(), replace(pixels, signal=signal)).cost)
    plain = compare(seen.model(), seen.truth(), pixels).cost
    assert (costs[1] - plain) / (costs[0] - plain) == pytest.approx(2, rel=0.05)


def test_beyond_the_streak_the_background_tells_gain_and_offset(streak):
    seen = streak(length_widths=1.0)
    frame = seen.frame()
    brighter = replace(frame, signal=1.01 * frame.signal + 0.002)
    pixels = brighter.about(seen.scene.camera.project(seen.points()), 16.0)
    step, _ = compare(seen.model(), seen.truth(), pixels).step()
    gain, offset = step[-6:].chunk(2)
    level = frame.ground.double().mean((1, 2))
    assert torch.allclose(gain * level + offset, 0.01 * level + 0.002, atol=1e-3)


READOUTS = {"down": math.pi / 2, "up": -math.pi / 2, "aslant": 0.5}


def rolling(heading, scene):
    """A white ball before black, rows exposed one after another: each a few percent later."""
    place = scene.path.position(torch.tensor([scene.exposure / 2]))[0]
    speed = 4 * scene.ball_radius / scene.exposure
    velocity = torch.tensor([math.cos(heading), math.sin(heading), 0.3], dtype=torch.float64)
    readout = 1.2 * scene.exposure
    # before the camera when its own rows are exposed
    start = place - velocity * speed * (scene.exposure + readout) / 2
    return replace(
        scene,
        path=StraightPath(
            start=tuple(start.tolist()), start_velocity=tuple((velocity * speed).tolist())
        ),
        readout=readout,
        appearance=PlainBall(colour=(1.0, 1.0, 1.0)),
        background=0 * scene.background,
    )


ROLLING = {name: functools.partial(rolling, heading) for name, heading in READOUTS.items()}


@pytest.mark.parametrize("name", READOUTS)
def test_a_rolling_shutter_sees_each_row_at_its_own_time(streak, name):
    seen = streak(change=ROLLING[name], length_widths=3.0, heading=0.0)
    model = seen.model()
    assert model.row_delay > 0.005
    pixels = seen.pixels()
    begin, end = model.exposure_of(pixels)
    assert torch.allclose(end - begin, torch.ones_like(begin))
    at_middle = (pixels.place[:, 1] - model.middle_row).abs() < 0.5
    assert (begin[at_middle] + 0.5).abs().max() <= model.row_delay
    x, y = pixels.place.long().mT
    alpha = model.opacity(seen.truth(), pixels).alpha
    expected = seen.shot.clean_image[0].double()[y, x]
    assert (alpha - expected).abs().max() < 2e-3
    assert expected.sum() > 0.99 * seen.shot.clean_image[0].double().sum()
    # taken for a global one it is far off
    still = replace(model, row_delay=0.0).opacity(seen.truth(), pixels).alpha
    assert (still - expected).abs().max() > 0.1


def test_the_opacity_s_slope_is_its_change_from_pixel_to_pixel(streak):
    for path in (PARABOLA, BouncePath((0.1,))):
        seen = streak(length_widths=2.0, blur=1.2)
        model, pixels, x = seen.model(path), seen.pixels(), seen.truth(path)
        covered = model.opacity(x, pixels)
        slope = model.opacity_slope(x, pixels, covered)
        picture = torch.zeros(seen.scene.camera.height, seen.scene.camera.width).double()
        column, row = pixels.place.long().mT
        picture[row, column] = covered.alpha
        right = (picture[row, column + 1] - picture[row, column - 1]) / 2
        down = (picture[row + 1, column] - picture[row - 1, column]) / 2
        expected = torch.stack([right, down])
        # a difference over two px, where the rim is three px wide
        assert (slope - expected).norm() < 0.1 * expected.norm()


@functools.cache
def errors(streak):
    """Errors over their standard deviations [seeds, 4] of x, y, z and speed; colour unknown."""
    # so near that the motion in depth is known well, on which the speed hangs by its square
    first = streak(Uniform(), length_widths=1.5, tilt=0.3, distance_R=15.0)
    exposure = first.scene.exposure
    position, velocity = first.shot.position, first.shot.velocity * exposure
    truth = torch.cat([position, velocity.norm()[None]])
    rows = []
    for seed in range(SEEDS):
        fit = first.again(seed + 100).fit()
        assert fit.converged
        at = [0, 1, 2, SPEED]
        J = J_state(fit)[at]
        std = (J @ fit.path_covariance @ J.mT).diagonal().sqrt()
        rows.append((motion_of(fit).state()[at] - truth) / std)
    return torch.stack(rows)


@pytest.mark.parametrize(("index", "name"), list(enumerate(["x", "y", "z", "speed"])))
def test_the_likeliest_motion_is_the_true_one_but_for_noise_as_stated(streak, index, name):
    z = errors(streak)[:, index]
    assert z.mean().abs() < 3 / SEEDS**0.5, f"{name} is off by {float(z.mean()):.2f}"
    spread = float(z.square().mean().sqrt())
    assert 0.75 < spread < 1.3, f"{name} spreads by {spread:.2f}"


@pytest.mark.parametrize("path", [STRAIGHT, PARABOLA], ids=["straight", "parabola"])
def test_chords_change_with_the_path_as_their_derivatives_say(streak, differences, path):
    """Offset, instant and half the time that the ball takes to cross a ray."""
    seen = streak(length_widths=2.0, distance_R=15.0, tilt=0.5)
    model, pixels, x = seen.model(path), seen.pixels(), seen.truth(path)
    k = path.size
    inside = model.opacity(x, pixels).passage.room > 0.2 * model.ball_radius**2

    def told(shape):
        passage = model.opacity(torch.cat([shape, x[k:]]), pixels).passage
        room, side = passage.room[inside], passage.side[inside]
        offset = (1 - room / model.ball_radius**2).clamp_min(0).sqrt() * side
        half = (room / passage.stiffness[inside]).log() / 2
        return torch.cat([offset, passage.instant[inside], half])

    found = model.J_chord(x, pixels, model.opacity(x, pixels), 3)[..., inside]
    expected = differences(told, x[:k], torch.full((k,), 1e-6)).reshape(3, -1, k).mT
    # within 0.05 R of the middle the side of a ray is not told apart
    is_aside = told(x[:k])[: expected.shape[-1]].abs() > 0.1
    for own, other in zip(found, expected, strict=True):
        error = (own - other)[:, is_aside].abs().max()
        assert error < 0.02 * other[:, is_aside].abs().max()
