from dataclasses import replace

import pytest
import torch

from plugins.known_shading import KnownShading
from plugins.uniform import Uniform
from toolkit.ball import Disc, SharpBall
from toolkit.contours import mark_profiles
from toolkit.light_change import LightGain, light_caution, light_gain
from toolkit.profile_fit import Skew, fit_profiles
from toolkit.profiles import gather_profiles
from toolkit.synthetic import LambertBall, benchmark_scene, render_shot
from toolkit.types import ProfileFlag
from toolkit.view import observe_streak

WIDTH = 40.0
LIT = LambertBall(colour=(0.9, 0.5, 0.2), light=(-0.6, -0.3, -0.7), highlight=0.2)
DISC = Disc(centre=(40.0, 30.0), semi_axes=(20.0, 20.0), angle=0.0, std=0.05)


def sharp(appearance, gain=(1.0, 1.0, 1.0)):
    """The ball from afar, seen by a picture with so many times the light of the shot."""
    places = torch.linspace(-1, 1, 129, dtype=torch.float64)
    y, x = torch.meshgrid(places, places, indexing="ij")
    reach = torch.hypot(x, y).clamp_min(1)
    x, y = x / reach, y / reach
    normal = torch.stack([x, y, -(1 - x * x - y * y).clamp_min(0).sqrt()], dim=-1)
    rgb = appearance(normal.reshape(-1, 3), 0.0).reshape(129, 129, 3).movedim(-1, 0)
    return SharpBall(disc=DISC, rgb=(rgb * torch.tensor(gain)[:, None, None]).float())


@pytest.fixture(scope="module")
def shot():
    scene = benchmark_scene(width_px=WIDTH, length_widths=5, distance_R=200, seed=3)
    return render_shot(replace(scene, appearance=LIT), seed=3, step=0.4)


def fitted(shot, estimator):
    view = observe_streak(shot.image, shot.background, estimator)
    profiles = gather_profiles(
        view.observation, view.clipped, view.streak.axis, 0.75 * WIDTH + 4, corner=view.corner
    )
    skew = Skew(mean=torch.zeros_like(profiles.position), std=1e-3)
    half_width = torch.tensor([WIDTH / 2], dtype=torch.float64)
    fit = fit_profiles(profiles, estimator, half_width=half_width, skew=skew)
    length = float(profiles.position.max())
    is_end = (profiles.position - length / 2).abs() > 1.2 * WIDTH
    return profiles, mark_profiles(fit, ProfileFlag.END, is_end)


def test_in_the_same_light_all_gains_are_one(shot):
    estimator = KnownShading(ball=sharp(LIT))
    profiles, fit = fitted(shot, estimator)
    found = light_gain(profiles, fit, estimator)
    assert found.gain.shape == found.std.shape == (3,)
    assert torch.allclose(found.gain, torch.ones(3).double(), atol=0.03)
    assert 0.8 < found.misfit < 1.1
    assert not found.is_other_light
    assert light_caution(profiles, fit, estimator) is None


@pytest.mark.parametrize("gain", [(0.8, 0.8, 0.8), (1.25, 1.25, 1.25), (1.3, 1.0, 0.8)])
def test_other_light_is_told_with_its_gains(shot, gain):
    estimator = KnownShading(ball=sharp(LIT, tuple(1 / g for g in gain)))
    profiles, fit = fitted(shot, estimator)
    found = light_gain(profiles, fit, estimator)
    assert found.is_other_light
    assert found.is_plausible
    assert torch.allclose(found.gain, torch.tensor(gain).double(), atol=0.06)
    caution = light_caution(profiles, fit, estimator)
    assert caution.code == "other-light"
    assert "times the light (R, G, B) it was known by" in caution.message
    assert f"{float(found.gain[0]):.2f} +- " in caution.message


def test_a_lamp_on_the_other_side_is_told(shot):
    estimator = KnownShading(ball=sharp(replace(LIT, light=(0.8, 0.5, -0.4))))
    profiles, fit = fitted(shot, estimator)
    caution = light_caution(profiles, fit, estimator)
    assert caution.code == "other-light"


def test_a_ball_shaded_otherwise_is_not_said_to_be_in_other_light(shot):
    estimator = Uniform(colour=(0.9, 0.5, 0.2))
    profiles, fit = fitted(shot, estimator)
    assert not light_gain(profiles, fit, estimator).is_plausible
    message = light_caution(profiles, fit, estimator).message
    assert "coloured, lit or shaded otherwise than this estimator knows it" in message
    assert "other light" not in message


def test_implausible_gains_are_not_quoted():
    """A channel cannot send less than no light."""
    covariance = 1e-4 * torch.eye(3, dtype=torch.float64)
    wild = LightGain(
        gain=torch.tensor([1.9, 1.4, -0.5]).double(), covariance=covariance, misfit=1.0
    )
    assert wild.is_other_light
    assert not wild.is_plausible


def test_small_or_uncertain_changes_are_passed_over():
    small = LightGain(
        gain=torch.tensor([1.03, 1.03, 1.03]).double(),
        covariance=1e-6 * torch.eye(3, dtype=torch.float64),
        misfit=1.0,
    )
    uncertain = replace(small, gain=1 + 5 * (small.gain - 1), covariance=1e4 * small.covariance)
    assert not small.is_other_light
    assert not uncertain.is_other_light


def test_it_holds_for_a_ball_of_one_colour_too(shot):
    plain = replace(shot.scene, appearance=replace(LIT, ambient=1.0, highlight=0.0))
    even = render_shot(plain, seed=4, step=0.4)
    estimator = Uniform(colour=(0.9 / 1.2, 0.5 / 1.2, 0.2 / 1.2))
    profiles, fit = fitted(even, estimator)
    found = light_gain(profiles, fit, estimator)
    assert torch.allclose(found.gain, torch.full((3,), 1.2).double(), atol=0.06)


def test_without_a_good_profile_nothing_is_told(shot):
    estimator = KnownShading(ball=sharp(LIT))
    profiles, fit = fitted(shot, estimator)
    nowhere = replace(fit, flags=fit.flags | int(ProfileFlag.END))
    assert light_gain(profiles, nowhere, estimator) is None
    assert light_caution(profiles, nowhere, estimator) is None


def test_the_caution_does_not_depend_on_profiles_left_out(shot):
    estimator = KnownShading(ball=sharp(LIT, (1.2, 1.0, 1.0)))
    profiles, fit = fitted(shot, estimator)
    found = light_gain(profiles, fit, estimator)
    spoilt = torch.where(fit.good[..., None, None], profiles.signal, 9.0)
    again = light_gain(replace(profiles, signal=spoilt), fit, estimator)
    assert torch.equal(found.gain, again.gain)
