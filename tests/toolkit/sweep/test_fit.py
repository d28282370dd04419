from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.sweep.fit import LARGEST_SPREAD, SMALLEST_SPREAD, fit_sweep, outline, search
from toolkit.sweep.likelihood import compare
from toolkit.sweep.paths import PARABOLA, STRAIGHT


@pytest.fixture(scope="module")
def short(streak):
    return streak(Uniform(), length_widths=1.5, distance_R=20.0, tilt=0.2)


def away(seen, path=STRAIGHT, by=0.1):
    """Parameters a tenth of a radius off, in another light."""
    x = seen.truth(path)
    generator = torch.Generator().manual_seed(5)
    step = torch.randn(path.size, generator=generator, dtype=torch.float64)
    x[: path.size] += by * seen.scene.ball_radius * step
    x[path.size] = 1.2
    return x


def std_of(fit):
    return fit.covariance.diagonal().sqrt()


def test_from_anywhere_near_it_comes_to_the_same_end(short):
    near = short.fit()
    far = fit_sweep(short.model(), away(short), short.frame(), doubt=3.0)
    assert near.converged
    assert far.converged
    assert 1 <= near.iterations < far.iterations < 12
    apart = (near.parameters - far.parameters).abs() / std_of(near)
    assert (apart[:10] < 0.1).all()
    # the pixels beside, which tell of gain and offset, are not all the same
    assert (apart[10:] < 1).all()


def test_at_the_end_no_step_promises_more(short):
    fit = short.fit()
    end = compare(fit.model, fit.parameters, fit.pixels)
    _, gain = end.step()
    assert 0 <= gain < 0.02
    # and none keeps more than it promises
    generator = torch.Generator().manual_seed(0)
    factor = torch.linalg.cholesky(fit.covariance)
    for _ in range(5):
        step = factor @ torch.randn(len(fit.parameters), generator=generator).double()
        other = compare(fit.model, fit.parameters + step, fit.pixels)
        information = fit.seen.information
        assert other.cost - end.cost == pytest.approx(float(step @ information @ step), rel=0.2)


def test_the_state_is_that_of_the_path(short):
    fit = short.fit()
    position, displacement = fit.state()
    first, last = fit.parameters[:3], fit.parameters[3:6]
    assert torch.allclose(position, (first + last) / 2)
    assert torch.allclose(displacement, last - first)
    assert torch.allclose(fit.state(0.5)[0], last)


def test_the_colour_is_found_with_it(short):
    fit = short.fit()
    colour = fit.parameters[7:10]
    std = std_of(fit)[7:10]
    truth = torch.tensor(short.scene.appearance.colour, dtype=torch.float64)
    assert ((colour - truth).abs() < 4 * std).all()
    assert (std < 0.03).all()


def test_the_lens_s_blur_is_found_too(streak):
    for blur in (0.4, 1.2):
        fit = streak(blur=blur, length_widths=1.0).fit()
        spread, std = float(fit.parameters[6]), float(std_of(fit)[6])
        assert abs(spread - (blur**2 + 1 / 12)) < 4 * std < 0.3


def test_a_blur_that_cannot_be_is_held_at_its_bound(short):
    """A picture sharper than any lens: of a ball rendered without one, and sharpened."""
    frame = short.clean().frame()
    light = frame.signal
    soft = torch.nn.functional.avg_pool2d(light[None], 5, 1, 2)[0]
    sharpened = replace(frame, signal=light + 2.5 * (light - soft))
    fit = fit_sweep(short.model(), short.truth(), sharpened, doubt=1.0)
    assert float(fit.parameters[6]) == pytest.approx(SMALLEST_SPREAD)
    out_of_focus = torch.nn.functional.avg_pool2d(light[None], 15, 1, 7)[0]
    fit = fit_sweep(short.model(), short.truth(), replace(frame, signal=out_of_focus), doubt=4.0)
    assert float(fit.parameters[6]) <= LARGEST_SPREAD


def test_the_cost_never_rises(short):
    pixels = short.pixels()
    model, x = short.model(), away(short, by=0.5)
    start = compare(model, x, pixels)
    fit = search(model, x, pixels, start, tolerance=1e-2)
    end = compare(model, fit.parameters, pixels)
    assert end.cost < fit.seen.cost < start.cost
    # what the last step leads to was not looked at, and is what it promised
    assert 0 < fit.promised < 4
    assert end.cost == pytest.approx(fit.cost, abs=0.05)
    assert end.step()[1] < 0.01


def test_the_last_step_is_looked_at_where_steps_converge_slowly(short):
    """As long as no two steps have told how fast they get smaller, and where they hardly do."""
    model, fit = short.model(), short.fit()
    pixels, near = fit.pixels, fit.parameters + 0.02 * std_of(fit)
    seen = compare(model, near, pixels)
    _, gain = seen.step(1e-4)
    assert 0.1 < gain < 2
    once = search(model, near, pixels, seen, tolerance=gain / 2, contraction=0.1)
    assert (once.iterations, once.promised) == (0, pytest.approx(gain))
    twice = search(model, near, pixels, seen, tolerance=gain / 2, contraction=0.9)
    assert twice.iterations == 1
    assert twice.contraction < 0.2


def test_a_ball_never_goes_through_the_camera(short):
    """Two wild pixels pull the path's end towards the camera; the search stays before it."""
    model, x = short.model(), short.truth()
    x[5] = 1.05 * model.ball_radius
    pixels = short.pixels()
    fit = search(model, x, pixels, compare(model, x, pixels), tolerance=1e-2)
    points = fit.model.path.arcs(fit.parameters[:6]).at(torch.tensor([-0.5, 0.5]).double())[0]
    assert (points[:, 2] > model.ball_radius).all()


def test_nothing_to_compare_with_does_not_converge(short):
    frame = short.frame()
    lost = replace(frame, signal=torch.full_like(frame.signal, torch.nan))
    assert not fit_sweep(short.model(), short.truth(), lost).converged


@pytest.mark.parametrize("side", [2, 3])
def test_squares_of_pixels_say_nearly_the_same(streak, side):
    seen = streak(length_widths=2.0)
    fine = seen.fit()
    coarse = fit_sweep(seen.model(), seen.truth(), seen.frame(), side=side, doubt=2.0)
    assert coarse.converged
    gap = (coarse.parameters[:6] - fine.parameters[:6]).abs()
    assert (gap < 1.5 * std_of(coarse)[:6]).all()
    assert len(coarse.pixels) < 1.5 * len(fine.pixels) / side**2


def test_the_outline_holds_the_path_and_the_ball_on_it(streak):
    seen = streak(distance_R=8.0, tilt=0.5, length_widths=2.0)
    points, half_width = outline(seen.model(PARABOLA), seen.truth(PARABOLA))
    camera = seen.scene.camera
    assert torch.allclose(points[[0, -1]], camera.project(seen.points(2)), atol=1e-6)
    depth = seen.points(len(points))[:, 2]
    # a sphere's image is larger than R f / Z, by the cone that touches it
    assert (half_width > camera.fx * seen.scene.ball_radius / depth).all()
    assert (half_width < 1.1 * camera.fx * seen.scene.ball_radius / depth).all()


def test_a_very_large_streak_is_compared_by_squares(streak, monkeypatch):
    seen = streak()
    whole = seen.fit()
    monkeypatch.setattr("toolkit.sweep.fit.MOST_PIXELS", len(whole.pixels) // 3)
    squares = seen.fit()
    assert [group.side for group in squares.pixels.squares] == [2]
    std = whole.covariance.diagonal().sqrt()
    assert ((squares.parameters - whole.parameters).abs()[:6] < std[:6]).all()
    assert (squares.covariance.diagonal().sqrt()[:6] < 1.15 * std[:6]).all()
