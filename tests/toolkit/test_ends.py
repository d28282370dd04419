import functools
from dataclasses import dataclass

import pytest
import torch

from toolkit.alpha import AlphaEstimator
from toolkit.axis_curve import nearest_parameter
from toolkit.camera import Camera
from toolkit.ends import Surroundings, covering_interval, locate_ends, rough_ends
from toolkit.errors import StreakError
from toolkit.motion import Pace, make_clock
from toolkit.splines import SplineBasis
from toolkit.synthetic import PlainBall, Scene, StraightPath, flat_background, render_shot
from toolkit.synthetic.truth import true_axis
from toolkit.types import ProfileFit

BALL_RADIUS = 0.05
EXPOSURE = 0.01
LENGTH = 130.0
"""Of the streak along s, px."""
CAMERA = Camera(width=220, height=120, fx=400.0, fy=400.0, cx=110.0, cy=60.0)
PATHS = {
    "across the view": StraightPath(start=(-0.16, 0.0, 1.0), start_velocity=(32.0, 0.0, 0.0)),
    "tilted": StraightPath(start=(-0.15, 0.02, 0.9), start_velocity=(31.0, -5.0, 18.0)),
}


def exact_curve(path):
    return true_axis(path, EXPOSURE, LENGTH)


def exact_clock(path, curve):
    speed = float(path.velocity(torch.zeros(1)).norm())
    pace = Pace(
        basis=SplineBasis(start=0.0, stop=LENGTH, size=1),
        coefficients=torch.tensor([1 / (speed * EXPOSURE)], dtype=torch.float64),
        inverse=torch.zeros(1, 1, dtype=torch.float64),
        weight=torch.ones(1, dtype=torch.float64),
    )
    return make_clock(curve, pace, -80.0, LENGTH + 80)


@dataclass(frozen=True, kw_only=True)
class Matte(AlphaEstimator):
    """The signal is the opacity."""

    def observe(self, image, background, noise):
        raise NotImplementedError

    def foreground(self, chord, appearance):
        return torch.ones_like(chord.offset)[..., None]


def matte(alpha, variance, corner=(0, 0)):
    return Surroundings(
        estimator=Matte(),
        signal=alpha[None],
        ground=torch.zeros_like(alpha)[None],
        variance=variance[None],
        corner=corner,
    )


@functools.cache
def rendered(path):
    scene = Scene(
        camera=CAMERA,
        path=path,
        ball_radius=BALL_RADIUS,
        exposure=EXPOSURE,
        appearance=PlainBall(colour=(1.0, 1.0, 1.0)),
        background=flat_background(220, 120, (0.0, 0.0, 0.0)),
        blur=0.7,
    )
    # a white ball before black: the picture is the opacity
    return render_shot(scene, supersampling=3).clean_image[0].double()


def located(path, alpha, std, rough=(6.0, LENGTH - 5)):
    curve = exact_curve(path)
    pixels = matte(alpha, torch.full_like(alpha, std**2))
    return locate_ends(rough, curve, *exact_clock(path, curve), pixels, CAMERA, BALL_RADIUS)


def radius_in_s(path):
    """Ball radii per unit of s at either end."""
    curve = exact_curve(path)
    return curve.tangent(torch.tensor([0.0, LENGTH]).double()).norm(dim=-1) / BALL_RADIUS


@pytest.mark.parametrize("name", PATHS)
def test_the_ends_of_a_clean_streak(name):
    path = PATHS[name]
    ends = located(path, rendered(path), 1e-3)
    error = (ends.s - torch.tensor([0.0, LENGTH])) * radius_in_s(path)
    assert ends.s.shape == ends.std.shape == (2,)
    assert error.abs().max() < 0.005


def test_a_rough_guess_may_be_off_by_half_a_ball():
    path = PATHS["tilted"]
    alpha = rendered(path)
    near = located(path, alpha, 1e-3, (1.0, LENGTH - 1))
    far = located(path, alpha, 1e-3, (-9.0, LENGTH + 9))
    assert torch.allclose(near.s, far.s, atol=0.1)


@pytest.mark.parametrize("name", PATHS)
def test_noise_spreads_the_ends_as_they_say(name):
    path, std = PATHS[name], 0.03
    alpha = rendered(path)
    generator = torch.Generator().manual_seed(1)
    clean = located(path, alpha, std)
    z, errors = [], []
    for _ in range(12):
        noise = std * torch.randn(alpha.shape, generator=generator, dtype=torch.float64)
        ends = located(path, alpha + noise, std)
        z.append((ends.s - clean.s) / ends.std)
        errors.append((ends.s - torch.tensor([0.0, LENGTH])) * radius_in_s(path))
        assert ends.chi2_per_dof == pytest.approx(1, abs=0.25)
    assert torch.stack(errors).abs().max() < 0.1  # R
    assert 0.65 < float(torch.stack(z).pow(2).mean().sqrt()) < 1.4


def test_a_window_of_the_picture_gives_the_same():
    path = PATHS["tilted"]
    alpha = rendered(path)
    curve = exact_curve(path)
    left, top = 8, 11
    cut = alpha[top:, left:]
    pixels = matte(cut, torch.full_like(cut, 1e-6), corner=(left, top))
    ends = locate_ends(
        (6.0, LENGTH - 5), curve, *exact_clock(path, curve), pixels, CAMERA, BALL_RADIUS
    )
    assert torch.allclose(ends.s, located(path, alpha, 1e-3).s, atol=0.02)


@pytest.mark.parametrize("name", PATHS)
def test_the_ball_covers_a_ray_between_the_bounds(name):
    path = PATHS[name]
    curve = exact_curve(path)
    middle = CAMERA.project(path.position(torch.tensor([0.3 * EXPOSURE])))[0]
    y, x = torch.meshgrid(torch.arange(-22.0, 23, 3), torch.arange(-30.0, 31, 5), indexing="ij")
    rays = CAMERA.unproject(middle + torch.stack([x, y], -1).reshape(-1, 2).double())
    nearest = nearest_parameter(curve, torch.tensor(0.3 * LENGTH).double().expand(len(rays)), rays)
    enter, leave, is_covered = covering_interval(curve, nearest, rays, BALL_RADIUS)
    s = torch.linspace(-60, LENGTH + 60, 20_001, dtype=torch.float64)
    covers = torch.linalg.cross(curve(s)[:, None], rays[None]).norm(dim=-1) <= BALL_RADIUS
    assert torch.equal(is_covered, covers.any(0))
    assert 20 < int(is_covered.sum()) < len(is_covered)
    first = s[covers.int().argmax(0)]
    last = s[len(s) - 1 - covers.flip(0).int().argmax(0)]
    chosen = is_covered & (last - first > 4)  # bounds close together are not met that exactly
    assert torch.allclose(enter[chosen], first[chosen], atol=0.03)
    assert torch.allclose(leave[chosen], last[chosen], atol=0.03)


def fit_with_opacity(opacity, half_width=10.0):
    """A straight streak's profiles with a given opacity, one a px."""
    count = len(opacity)
    position = torch.arange(float(count)).double()[None]
    zero = torch.zeros_like(position)
    return ProfileFit(
        origin=torch.stack([position, zero], -1),
        normal=torch.tensor([0.0, 1.0]).double().expand(1, count, 2),
        position=position,
        centre=zero,
        half_width=zero + half_width,
        opacity=opacity[None],
        skew=zero,
        covariance=1e-4 * torch.eye(3).double().expand(1, count, 3, 3),
        chi2_per_dof=zero + 1,
        flags=torch.zeros(1, count, dtype=torch.int64),
        blur=torch.tensor([0.7]).double(),
        samples=torch.full((1, count), 90),
        iterations=1,
    )


def opacity_along(first, last, count=120, half_width=10.0, opacity=0.25):
    """On the axis it rises evenly while the ball's first image gives way, over its diameter."""
    x = torch.arange(float(count)).double()
    rise = ((x - first + half_width) / (2 * half_width)).clamp(0, 1)
    fall = ((last + half_width - x) / (2 * half_width)).clamp(0, 1)
    return opacity * torch.minimum(rise, fall)


def test_the_opacity_has_half_risen_where_the_ball_first_stood():
    first, last = rough_ends(fit_with_opacity(opacity_along(20, 95)))
    assert first == pytest.approx(20, abs=1.5)
    assert last == pytest.approx(95, abs=1.5)


def test_rough_ends_bear_noise_and_stray_profiles():
    opacity = opacity_along(25, 95)
    generator = torch.Generator().manual_seed(0)
    opacity = opacity + 0.01 * torch.randn(120, generator=generator).double()
    opacity[3:5] = 0.9
    first, last = rough_ends(fit_with_opacity(opacity))
    assert first == pytest.approx(25, abs=3)
    assert last == pytest.approx(95, abs=3)


def test_rough_ends_follow_an_opacity_that_changes():
    opacity = opacity_along(20, 95) * torch.linspace(1, 2, 120).double()
    first, last = rough_ends(fit_with_opacity(opacity))
    assert first == pytest.approx(20, abs=3)
    assert last == pytest.approx(95, abs=3)


def test_ends_outside_the_window_are_refused():
    path = PATHS["tilted"]
    alpha = torch.zeros(8, 8, dtype=torch.float64)
    curve = exact_curve(path)
    pixels = matte(alpha, alpha + 1)
    with pytest.raises(StreakError, match="ends cannot be located"):
        locate_ends((0.0, LENGTH), curve, *exact_clock(path, curve), pixels, CAMERA, BALL_RADIUS)
