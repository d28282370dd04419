from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.sweep.fit import fit_sweep
from toolkit.sweep.linearity import (
    ASSUMED_STD,
    CERTAIN,
    NAMED_STD,
    Linearity,
    judge_linearity,
    response_change,
)
from toolkit.view import observe_streak


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


def judged(seen, factor=1.0):
    view = observe_streak(seen.shot.image, seen.shot.background, seen.estimator)
    frame = seen.frame()
    view = replace(view, corner=(0, 0), smooth_ground=seen.shot.clean_background[None])
    fit = fit_sweep(seen.model(), seen.truth(), frame, doubt=1.0)
    return judge_linearity(view, frame, fit, factor)


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
    assert other.found == one.found
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
    fit = seen.fit()
    assert response_change(view, seen.estimator, seen.frame(), fit, 0.0) is None
