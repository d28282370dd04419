import math
from dataclasses import dataclass, replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.sweep.choose import Start, finer_shade, most_likely_motion, strays
from toolkit.sweep.paths import PARABOLA, STRAIGHT, BouncePath, SplinePath
from toolkit.sweep.shade import Shaded
from toolkit.synthetic import BallPath, BouncingPath, LambertBall


def chosen(seen, **changes):
    start = seen.start(**changes)
    return most_likely_motion(seen.frame(), seen.model(), start)


def across_error(fit, seen):
    """Distance of the path found from the true one, but for the depth, in ball radii, largest."""
    time = torch.linspace(-0.5, 0.5, 65, dtype=torch.float64)
    found, _ = fit.model.path.arcs(fit.parameters[: fit.model.path.size]).at(time)
    return float((found - seen.points())[:, :2].norm(dim=-1).max()) / seen.scene.ball_radius


def test_a_straight_path_stays_straight(streak):
    seen = streak(length_widths=2.0)
    richer = 0
    for seed in range(6):
        fit = chosen(seen.again(seed), is_close=True)
        assert fit.converged
        richer += fit.model.path != STRAIGHT
    # one in a hundred, by chance
    assert richer <= 1


def test_a_parabola_is_found_from_a_straight_start(streak):
    seen = streak(length_widths=3.0, sagitta_widths=0.25)
    ends = seen.points(2)
    share = torch.linspace(0, 1, 65, dtype=torch.float64)[:, None]
    straight = ends[0] + share * (ends[1] - ends[0])
    fit = chosen(seen, path=straight)
    assert fit.model.path == PARABOLA
    assert across_error(fit, seen) < 0.05


@dataclass(frozen=True, kw_only=True)
class WavyPath(BallPath):
    """A straight path that swings to its side and back."""

    base: BallPath
    side: tuple[float, float, float]
    duration: float

    def position(self, time):
        wave = torch.sin(2 * math.pi * time.double() / self.duration)[:, None]
        return self.base.position(time) + wave * torch.tensor(self.side, dtype=torch.float64)

    def velocity(self, time):
        rate = 2 * math.pi / self.duration
        swing = rate * torch.cos(rate * time.double())[:, None]
        return self.base.velocity(time) + swing * torch.tensor(self.side, dtype=torch.float64)


def wavy(scene):
    size = 0.8 * scene.ball_radius
    side = (-size * math.sin(0.4), size * math.cos(0.4), 0.0)
    return replace(scene, path=WavyPath(base=scene.path, side=side, duration=scene.exposure))


def test_a_spline_is_found_for_a_winding_path(streak):
    seen = streak(change=wavy, length_widths=4.0)
    fit = chosen(seen, is_close=True)
    assert isinstance(fit.model.path, SplinePath)
    assert fit.model.path.pieces >= 2
    assert fit.converged
    assert across_error(fit, seen) < 0.1
    assert float(fit.seen.residual.square().mean()) < 1.1


def bouncing(scene):
    """A bounce at two fifths of the exposure, a little later in the picture's plane."""
    unit = scene.ball_radius / scene.exposure
    middle = scene.path.position(torch.tensor([scene.exposure / 2]))[0]
    start = middle + scene.ball_radius * torch.tensor([-2.0, -2.0, 0.0])
    drop = 2.0 * scene.ball_radius
    fall = drop / (0.4 * scene.exposure)
    path = BouncingPath(
        start=tuple(start.tolist()),
        start_velocity=(4 * unit, fall, 0.0),
        contact_height=float(start[1]) + drop,
        acceleration=(0.0, 0.0, 0.0),
        restitution=0.7,
    )
    return replace(scene, path=path)


def test_a_bounce_and_its_instant_are_found(streak):
    seen = streak(change=bouncing, length_widths=3.0)
    fit = chosen(seen, corner=-0.05)
    assert isinstance(fit.model.path, BouncePath)
    assert fit.converged
    instant = float(fit.parameters[fit.model.path.size - 1])
    std = float(fit.path_covariance.diagonal().sqrt()[-1])
    assert abs(instant + 0.1) < 4 * std < 0.05
    assert across_error(fit, seen) < 0.05


def test_a_rough_start_is_bettered_on_squares_first(streak):
    seen = streak(Uniform(), width_px=40, length_widths=1.5)
    generator = torch.Generator().manual_seed(2)
    off = 0.2 * seen.scene.ball_radius * torch.randn(3, generator=generator).double()
    rough = chosen(seen, path=seen.points() * 0.95 + off, appearance=seen.looks() * 0.9, blur=1.5)
    close = chosen(seen, is_close=True)
    assert rough.converged
    assert rough.model.path == close.model.path == STRAIGHT
    std = close.covariance.diagonal().sqrt()
    apart = (rough.parameters - close.parameters).abs() / std
    # which pixels lie beside the streak hangs on the start, and with them the light's gain
    assert (apart[: STRAIGHT.size] < 0.2).all()
    assert (apart < 0.5).all()


def test_only_a_close_start_can_be_left(streak):
    seen = streak(length_widths=2.0)
    fit = seen.fit()
    start = seen.start(is_close=True)
    assert strays(fit, start) < 0.05
    aside = replace(start, path=start.path + torch.tensor([0.0, 0.5 * seen.scene.ball_radius, 0]))
    assert strays(fit, aside) == pytest.approx(0.5 * math.cos(0.4), abs=0.05)
    assert strays(fit, replace(aside, is_close=False)) == 0


def test_the_start_says_when_the_ball_was_where():
    start = Start(path=torch.zeros(5, 3), appearance=None, span=(-0.25, 0.75))
    assert start.time.tolist() == [-0.25, 0.0, 0.25, 0.5, 0.75]


def shaded(scene):
    red, green, blue = scene.appearance.colour
    lamp = LambertBall(
        colour=(1.1 * red, 1.1 * green, 1.1 * blue), light=(-0.3, -0.5, -0.8), ambient=0.6
    )
    return replace(scene, appearance=lamp)


def test_a_shade_is_laid_over_a_ball_that_has_one_and_no_other(streak):
    plain = streak(Uniform(), length_widths=2.0)
    fit = chosen(plain, is_close=True)
    assert not isinstance(fit.model.estimator, Shaded)
    assert finer_shade(fit, plain.frame()) is None
    lit = streak(change=shaded, estimator=Uniform(), length_widths=2.0)
    fit = most_likely_motion(
        lit.frame(), lit.model(), plain.start(path=lit.points(), is_close=True)
    )
    assert isinstance(fit.model.estimator, Shaded)
    finer = finer_shade(fit, lit.frame())
    assert finer.model.estimator.powers == (3, 4)
    assert across_error(fit, lit) < 0.2
