import numpy as np
import pytest

from calibration.curve_fit import fit_curve
from calibration.monotone_curve import MonotoneCurve
from calibration.response_curve import sampled_curve

CODES = np.arange(12, 244) / 255
TIMES = 2.0 ** np.arange(-3, 4)


def srgb(x):
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


CURVES = {
    "power": lambda x: x ** (1 / 2.2),
    "linear": lambda x: x,
    "film": lambda x: x**1.3 / (x**1.3 + 0.06) * 1.06,
    # a camera's knee: brightness rises a fifth as fast above 0.8
    "knee": lambda x: srgb(x) - 0.8 * 0.03 * np.logaddexp(0, (srgb(x) - 0.8) / 0.03),
}


def bracket(curve, *, times=TIMES, pixels=20_000, noise=1 / 255, seed=0):
    rng = np.random.default_rng(seed)
    light = 2 ** rng.normal(-3, 2.7, pixels)
    white = curve(np.ones(1))[0]
    exact = np.stack([curve(np.minimum(light * t, 1)) / white for t in times])
    return np.clip(np.rint(255 * (exact + noise * rng.normal(size=exact.shape))), 0, 255) / 255


def inverse(curve, brightness):
    light = np.append(0, np.logspace(-7, 0, 20_000))
    return np.interp(brightness, curve(light) / curve(np.ones(1))[0], light)


def error(found, true):
    factor = (found * true).sum() / (found * found).sum()
    return factor * found - true


@pytest.mark.parametrize("name", CURVES)
def test_curves_come_back(name):
    fit = fit_curve(bracket(CURVES[name]), TIMES, 1 / 255)
    off = error(2 ** fit.curve.inverse(CODES), inverse(CURVES[name], CODES))
    assert np.sqrt((off**2).mean()) < 4e-4
    assert (np.diff(fit.curve.brightness) > 0).all()


def test_noise_free_pictures_and_deep_ones_do_too():
    values = bracket(CURVES["power"], noise=0)
    fit = fit_curve(values, TIMES, 1 / 255)
    off = error(2 ** fit.curve.inverse(CODES), inverse(CURVES["power"], CODES))
    assert np.sqrt((off**2).mean()) < 6e-4


def test_the_stated_deviation_holds_the_truth():
    held = []
    for seed, name in enumerate(("power", "film", "knee", "film")):
        curve, seen = sampled_curve(
            fit_curve(bracket(CURVES[name], pixels=4000, seed=seed), TIMES, 1 / 255)
        )
        inside = (curve.brightness > seen[0]) & (curve.brightness < seen[1])
        off = error(curve.exposure[inside], inverse(CURVES[name], curve.brightness[inside]))
        held.append(np.mean(np.abs(off) < 1.96 * curve.std[inside]))
        assert (np.diff(curve.exposure) > 0).all()
        np.testing.assert_allclose(curve.changes.shape[1], len(curve.std))
    assert np.mean(held) > 0.8


def test_modes_make_up_the_deviation():
    curve, _ = sampled_curve(fit_curve(bracket(CURVES["film"], pixels=4000), TIMES, 1 / 255))
    inside = slice(30, 240)
    told = np.sqrt((curve.modes**2).sum(0))[inside]
    assert (told <= curve.std[inside] * (1 + 1e-9)).all()
    assert (told**2).sum() > 0.8 * (curve.std[inside] ** 2).sum()


def test_the_slope_of_the_table_is_its_derivative():
    curve = MonotoneCurve.through(np.linspace(-6, 0, 40), np.linspace(0, 1, 40), -7, 0.5)
    rng = np.random.default_rng(1)
    change = 1e-6 * rng.normal(size=len(curve.coefficients))
    moved = curve.moved(change, 2e-6)
    expected = curve.J_brightness() @ np.append(change, 2e-6)
    np.testing.assert_allclose(moved.brightness - curve.brightness, expected, atol=1e-10)
    value, slope = curve.at(np.array([-3.3, -1.1]))
    assert curve.inverse(value) == pytest.approx([-3.3, -1.1])
    assert (slope > 0).all()
