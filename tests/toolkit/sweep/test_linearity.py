from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit.background import estimate_noise
from toolkit.box_filter import ring_mean
from toolkit.response import CurveDoubt
from toolkit.sweep.doubt import motion_of, sweep_uncertainty
from toolkit.sweep.fit import fit_sweep
from toolkit.sweep.linearity import (
    ASSUMED_STD,
    CERTAIN,
    NAMED_STD,
    Linearity,
    judge_linearity,
    response_changes,
)
from toolkit.view import observe_streak

KEPT = [0, 1, 2, 3, 4, 6]
"""Of the state: all but the velocity in depth, which a path across the view hardly tells."""


@pytest.fixture(scope="module")
def seen(streak):
    return streak(Uniform(), width_px=60, length_widths=1.2)


def decoded(seen, exponent, **response):
    """The same pictures, decoded with another exponent."""
    image, background = (
        replace(picture, rgb=picture.rgb.clamp_min(0) ** exponent, **response)
        for picture in (seen.shot.image, seen.shot.background)
    )
    return replace(seen, shot=replace(seen.shot, image=image, background=background))


def observed(seen):
    """All of the picture."""
    noise = estimate_noise(seen.shot.image, seen.shot.background)
    whole = seen.estimator.observe(seen.shot.image, seen.shot.background, noise)
    return {"observation": whole, "smooth_ground": ring_mean(whole.ground)}


def judged(seen, factor=1.0):
    view = observe_streak(seen.shot.image, seen.shot.background, seen.estimator)
    frame = seen.frame()
    view = replace(view, corner=(0, 0), **observed(seen))
    fit = fit_sweep(seen.model(), seen.truth(), frame, doubt=1.0)
    return judge_linearity(view, fit, factor)


@pytest.mark.parametrize("exponent", [0.93, 1.07])
def test_a_wrong_exponent_is_found_whatever_the_colour(seen, exponent):
    found = judged(decoded(seen, exponent))
    # nearly: what shifts the motion as well is told by its derivatives at the shifted place
    assert found.found == pytest.approx(exponent - 1, abs=4 * found.found_std + 0.01)
    assert abs(found.found) > CERTAIN * found.found_std
    assert found.is_doubted
    assert found.std == abs(found.found)


def test_linear_light_is_not_doubted(seen):
    found = torch.tensor(
        [
            (one.found / one.found_std, one.is_doubted)
            for one in (judged(seen.again(seed)) for seed in range(12))
        ]
    )
    sigmas, doubted = found.mT
    assert not doubted.any()
    assert 0.4 < float(sigmas.std()) < 1.6
    assert abs(float(sigmas.mean())) < 1.2


def test_more_than_noise_makes_the_exponent_less_certain(seen):
    one, other = judged(seen), judged(seen, factor=4.0)
    assert other.found == pytest.approx(one.found)
    assert other.found_std == pytest.approx(2 * one.found_std)


def test_what_is_granted_anyway_is_not_doubted(seen):
    """Five per cent are nothing strange where the response was but assumed."""
    found = judged(decoded(seen, 1.05, response="srgb", response_is_assumed=True))
    assert found.known == ASSUMED_STD
    assert not found.is_doubted
    assert found.std == ASSUMED_STD


def test_a_signal_that_is_no_light_has_no_exponent():
    assert not Linearity(known=NAMED_STD).is_doubted
    assert Linearity(known=NAMED_STD).std == NAMED_STD


def test_a_known_response_changes_nothing(seen):
    view = observe_streak(seen.shot.image, seen.shot.background, seen.estimator)
    known = Linearity(known=0.0)
    assert len(response_changes(view, seen.estimator, seen.frame(), seen.fit(), known)) == 0


@pytest.fixture(scope="module")
def doubt():
    """Errors of measured curves: an exponent in green, a bend in the middle of blue."""
    light = torch.linspace(0, 1, 101, dtype=torch.float64).numpy()
    changes = np.zeros((2, 3, 101))
    changes[0, 1] = 0.05 * light * np.log(np.maximum(light, 1e-3))
    changes[1, 2] = 0.02 * np.sin(np.pi * light)
    return CurveDoubt(light=np.stack([light] * 3), changes=changes)


def test_a_measured_curve_errs_in_its_own_ways(seen, doubt):
    """Each shifts the answer as a picture does whose light was changed by it."""
    image, background = (
        replace(picture, curve_doubt=doubt, response="response.toml")
        for picture in (seen.shot.image, seen.shot.background)
    )
    view = observe_streak(image, background, seen.estimator)
    view = replace(view, corner=(0, 0), shot=image, background=background)
    frame, fit = seen.frame(), seen.fit()
    known = judge_linearity(replace(view, **observed(seen)), fit, 1.0).known
    assert known == pytest.approx(doubt.exponent_std())
    changes = response_changes(view, seen.estimator, frame, fit, Linearity(known=known))
    assert len(changes) == 2
    assert (changes[0, [0, 2]].abs() < 1e-7).all()
    quiet = SimpleNamespace(factor=1.0)
    for mode, change in enumerate(changes):
        signal, ground = (light.clone() for light in (frame.signal, frame.ground))
        for light in (signal, ground):
            for channel in range(3):
                by = doubt.change(light[channel].numpy(), mode, channel)
                light[channel] += torch.from_numpy(by).to(light)
        other = replace(frame, signal=signal, ground=ground)
        refitted = fit_sweep(seen.model(), fit.parameters, other, doubt=1.0)
        expected = (motion_of(refitted).state() - motion_of(fit).state())[KEPT]
        told = sweep_uncertainty(
            fit,
            quiet,
            others=(),
            ball_radius_std=0.0,
            exposure_std_share=0.0,
            response_changes=change[None],
        ).brightness.diagonal()[KEPT]
        close = 0.15 * float(expected.abs().max())
        assert torch.allclose(told.sqrt(), expected.abs(), rtol=0.2, atol=close)


def test_a_streak_that_doubts_a_measured_curve_adds_the_exponent(seen, doubt):
    image = replace(seen.shot.image, curve_doubt=doubt)
    view = replace(
        observe_streak(image, seen.shot.background, seen.estimator), corner=(0, 0), shot=image
    )
    doubted = Linearity(known=0.01, found=0.2, found_std=0.01)
    changes = response_changes(view, seen.estimator, seen.frame(), seen.fit(), doubted)
    assert len(changes) == 3
