import pytest

from toolkit import Measurement
from toolkit.measurement import Alternative, Budget, Caution, ProfileTable, Shares, Sign
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
                half_width_px=(1.0,) * 2,
                opacity=(0.1,) * 2,
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
    assert "1 of 2 used" in text
    assert "noise 25 %, radius 75 %" in text
    assert "mind the [gap]" in text
    assert text.isascii()
    assert len(text.splitlines()) < 14


def test_unknown_speed_is_said_and_an_upper_limit_given():
    assert "speed      unknown" in summarise(Measurement())
    assert "speed      below 0.3 m/s" in summarise(Measurement(speed_upper_m_s=0.3))


def test_settled_sign_names_its_cue():
    sign = Sign(ambiguous=False, probability=0.98, cue="rolling shutter")
    assert "settled by rolling shutter, probability 0.98" in summarise(Measurement(sign=sign))


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
