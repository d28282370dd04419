"""What a measurement reports that stops at the profiles."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit import Measurement
from toolkit.contours import smooth_contours
from toolkit.report import draw_overlay, summarise
from toolkit.result import describe_profiles
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import benchmark_scene, render_shot
from toolkit.view import observe_streak

WIDTH = 30.0


@pytest.fixture(scope="module")
def shot():
    return render_shot(benchmark_scene(width_px=WIDTH, length_widths=4, heading=0.3, seed=2))


@pytest.fixture(scope="module")
def found(shot):
    estimator = Uniform(colour=shot.scene.appearance.colour)
    fit, _ = fit_streak(observe_streak(shot.image, shot.background, estimator, None), estimator)
    return smooth_contours(fit)


def test_profiles_and_contours_are_those_of_the_picture(found):
    contours, fit = found
    result = describe_profiles(fit, contours)
    assert (result.status, result.stage, result.warnings) == ("ok", "profiles", ())
    good = np.array(result.profiles.flags) == 0
    assert good.sum() > 20
    assert np.median(np.array(result.profiles.half_width_px)[good]) == pytest.approx(
        WIDTH / 2, abs=0.3
    )
    gap = np.linalg.norm(np.subtract(result.contours.left, result.contours.right), axis=-1)
    assert np.median(gap) == pytest.approx(WIDTH, abs=0.5)
    assert result.fit.chi2_per_dof == pytest.approx(1, abs=0.2)


def test_nothing_is_said_of_what_needs_a_camera(found):
    contours, fit = found
    result = describe_profiles(fit, contours)
    for name in ("position_m", "direction", "speed_m_s", "sign", "trajectory", "budget", "time_s"):
        assert getattr(result, name) is None
    assert Measurement.from_json(result.to_json()).stage == "profiles"


def test_cautions_are_those_of_profiles_and_light(found):
    contours, fit = found
    noisy = replace(fit, chi2_per_dof=3 * fit.chi2_per_dof, common_misfit=50.0)
    drift = torch.tensor([1.0, 1.02, 1.0])
    result = describe_profiles(noisy, contours, drift=drift)
    codes = [caution.code for caution in result.warnings]
    assert codes == ["profiles-misfit", "profiles-misshapen", "background-brightness"]
    assert "2.0 %" in result.warnings[-1].message


def test_it_is_printed_and_drawn(shot, found):
    contours, fit = found
    result = describe_profiles(fit, contours)
    text = summarise(replace(result, estimator="uniform"))
    assert text.startswith("estimator uniform, stage profiles, pixels of the stored")
    assert "speed" not in text
    assert "half width 15." in text
    plain = draw_overlay(shot.image, Measurement())
    assert (draw_overlay(shot.image, result) != plain).any()
