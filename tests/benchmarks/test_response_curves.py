from pathlib import Path

import numpy as np
import pytest
import response_curves

CURVES = Path(__file__).resolve().parents[2].parent / "shared/data/crf/responses_51.npz"


def test_ours_beats_the_others_on_a_known_curve():
    _, curve = next(response_curves.families())
    ours, debevec, robertson, held, rises, _ = response_curves.judge(
        curve, np.random.default_rng(0)
    )
    assert ours < 2e-4
    assert ours < debevec / 3
    assert ours < robertson / 3
    assert held > 0.8
    assert rises


def test_all_families_run_from_black_to_white():
    light = np.linspace(0, 1, 200)
    names = []
    for name, curve in response_curves.families():
        brightness = curve(light)
        assert brightness[[0, -1]] == pytest.approx([0, 1], abs=1e-12)
        assert (np.diff(brightness) > 0).all()
        names.append(name)
    assert len(set(names)) == 6 * response_curves.FAMILIES


@pytest.mark.shared_data
def test_measured_curves_are_read():
    if not CURVES.is_file():
        pytest.skip("the measured response curves are not beside the project")
    curves = list(response_curves.measured(CURVES))
    assert len(curves) == 51
    for _, curve in curves:
        assert curve(np.array([0.0, 1.0])) == pytest.approx([0, 1], abs=0.02)


def test_residuals_of_a_right_curve_are_none():
    light = 2 ** np.random.default_rng(0).uniform(-6, 0, 3000)
    times = np.array([0.25, 0.5, 1.0])
    values = np.sqrt(light * times[:, None])
    exposure = np.linspace(0, 1, 256) ** 2
    assert response_curves.exposure_residual(values, times, exposure)[0] < 2e-3
    wrong = response_curves.exposure_residual(values, np.array([0.25, 0.6, 1.0]), exposure)
    assert wrong[2] > 0.1
