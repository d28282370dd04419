from dataclasses import replace

import pytest

from toolkit import Measurement
from toolkit.measurement import (
    Alternative,
    Bound,
    Budget,
    Caution,
    FitSummary,
    ProfileTable,
    Shares,
    Sign,
)
from toolkit.report import summarise


def test_summary_says_what_matters():
    text = summarise(
        Measurement(
            estimator="uniform",
            stage="contours",
            position_m=(0.1, -0.2, 2.0),
            position_std_m=(0.001, 0.002, 0.01),
            direction=(1.0, 0.0, 0.0),
            speed_m_s=12.3456,
            speed_std_m_s=0.0567,
            sign=Sign(
                ambiguous=True,
                probability=0.5,
                alternatives=(
                    Alternative(direction=(-1.0, 0.0, 0.0), velocity_m_s=None, probability=0.5),
                ),
            ),
            profiles=ProfileTable(
                centre_px=((0.0, 0.0),) * 2,
                half_width_px=(12.5, 99.0),
                opacity=(0.25, 0.9),
                flags=(0, 8),
            ),
            budget=Budget(speed=None, depth=Shares(noise=0.25, radius=0.75)),
            warnings=(Caution(code="x", message="mind the [gap]"),),
        )
    )
    assert "x +0.1000 +/- 0.0010, y -0.2000 +/- 0.0020, z +2.000 +/- 0.010 m" in text
    assert "12.346 +/- 0.057 m/s" in text
    assert "open, probability 0.50" in text
    assert "-1.0000 +0.0000 +0.0000, probability 0.50" in text
    assert "1 of 2 used, half width 12.50 px, opacity 0.250 (medians)" in text
    assert "noise 25 %, radius 75 %" in text
    assert "mind the [gap]" in text
    assert text.isascii()
    assert len(text.splitlines()) < 14


def test_unknown_speed_is_said_and_an_upper_limit_given():
    assert "speed      unknown" in summarise(Measurement())
    assert "speed      at most 0.12 m/s (95 %)" in summarise(Measurement(speed_upper_m_s=0.123))
    still = Measurement(speed_m_s=0.05, velocity_m_s=(0.05, 0.0, 0.0), speed_upper_m_s=0.123)
    assert "speed      at most 0.12 m/s (95 %)" in summarise(still)
    assert "velocity" not in summarise(still)


def test_settled_sign_names_its_cue_and_odds():
    sign = Sign(ambiguous=False, probability=0.98, cue="readout")
    assert "settled by readout, odds 49 to 1" in summarise(Measurement(sign=sign))
    for probability in (1.0, 1 - 1e-9):
        sure = replace(sign, probability=probability)
        assert "readout, odds above a million to one" in summarise(Measurement(sign=sure))


def test_sign_that_is_only_likelier_stays_open():
    other = Alternative(direction=(-1.0, 0.0, 0.0), velocity_m_s=None, probability=0.2)
    sign = Sign(ambiguous=True, probability=0.8, cue="readout", alternatives=(other,))
    text = summarise(Measurement(sign=sign))
    assert "open, probability 0.80; readout does not settle it; the others:" in text
    assert "-1.0000 +0.0000 +0.0000, probability 0.20" in text


def test_bound_is_beside_what_was_reached():
    bound = Bound(position_std_m=(0.001, 0.002, 0.03), speed_std_m_s=0.04, efficiency=0.912)
    text = summarise(Measurement(bound=bound))
    assert "bound      at best x 0.001 y 0.002 z 0.03 m, speed 0.04 m/s; efficiency 0.91" in text
    still = replace(bound, speed_std_m_s=None, efficiency=None)
    assert summarise(Measurement(bound=still)).endswith("at best x 0.001 y 0.002 z 0.03 m")


def test_fit_and_time_are_said():
    fit = FitSummary(chi2_per_dof=1.034, pixels=5000, iterations=4)
    text = summarise(Measurement(fit=fit, time_s=0.0125))
    assert text.endswith("chi2 per degree of freedom 1.03 over 5000 samples")
    blurred = summarise(Measurement(fit=replace(fit, blur_px=0.704)))
    assert blurred.endswith("over 5000 samples, lens blur 0.70 px")
    assert "0.0125 s after the first row's exposure began" in text


def test_profiles_alone_say_nothing_of_space():
    table = ProfileTable(centre_px=((1.0, 1.0),), half_width_px=(3.0,), opacity=(0.5,), flags=(8,))
    text = summarise(Measurement(estimator="uniform", stage="profiles", profiles=table))
    assert text.startswith("estimator uniform, stage profiles, pixels of the stored picture")
    assert "speed" not in text
    assert text.endswith("0 of 1 used")


def test_refusal_gives_the_reason():
    assert summarise(Measurement.refused("too dark")).startswith("refused: too dark")


@pytest.mark.parametrize(
    ("speed", "std", "text"),
    [
        (31.7112, 0.2, "31.71 +/- 0.20 m/s"),
        (9.8506, 3.8, "9.9 +/- 3.8 m/s"),
        (120.4, 76.0, "120 +/- 76 m/s"),
        (2.5, 0.0, "2.5 +/- 0 m/s"),
    ],
)
def test_a_value_has_no_more_digits_than_are_known(speed, std, text):
    assert f"speed      {text}\n" in summarise(
        Measurement(speed_m_s=speed, speed_std_m_s=std, time_s=0.01)
    )
