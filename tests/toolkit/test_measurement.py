import json
import math
from dataclasses import fields

import pytest
import torch

from toolkit import ConfigError, Measurement
from toolkit.measurement import (
    Alternative,
    Bound,
    Budget,
    Caution,
    ContourPoints,
    FitSummary,
    InputFile,
    Inputs,
    PathSamples,
    ProfileTable,
    Shares,
    Sign,
    numbers,
)

KEYS = (
    "schema version status reason inputs estimator stage time_s position_m position_std_m "
    "velocity_m_s direction speed_m_s speed_std_m_s speed_upper_m_s state_covariance sign "
    "trajectory contours profiles budget bound fit candidates provenance warnings timing_s"
).split()


def full() -> Measurement:
    return Measurement(
        inputs=Inputs(shot=InputFile(path="a.dng", sha256="00")),
        estimator="uniform",
        stage="contours",
        time_s=0.005,
        position_m=(0.1, -0.2, 2.0),
        position_std_m=(0.001, 0.001, 0.01),
        velocity_m_s=(10.0, 0.0, 1.0),
        direction=(0.995, 0.0, 0.0995),
        speed_m_s=10.05,
        speed_std_m_s=0.05,
        state_covariance=numbers(torch.eye(6, dtype=torch.float64)),
        sign=Sign(
            ambiguous=True,
            probability=0.5,
            alternatives=(
                Alternative(
                    direction=(-0.995, 0.0, -0.0995),
                    velocity_m_s=(-10.0, 0.0, -1.0),
                    probability=0.5,
                ),
            ),
        ),
        trajectory=PathSamples(
            time_s=(0.0, 0.01),
            position_m=((0.05, -0.2, 1.995), (0.15, -0.2, 2.005)),
            velocity_m_s=((10.0, 0.0, 1.0), (10.0, 0.0, 1.0)),
            position_std_m=((0.001, 0.001, 0.01), (0.001, 0.001, 0.01)),
        ),
        contours=ContourPoints(left=((0.0, 1.0), (5.0, 1.0)), right=((0.0, 9.0), (5.0, 9.0))),
        profiles=ProfileTable(
            centre_px=((1.0, 5.0), (2.0, 5.0)),
            half_width_px=(4.0, math.nan),
            opacity=(0.4, 0.4),
            flags=(0, 1),
        ),
        budget=Budget(speed=Shares(noise=0.7, exposure=0.3), depth=Shares(noise=1.0)),
        bound=Bound(position_std_m=(0.001, 0.001, 0.008), speed_std_m_s=0.04, efficiency=0.8),
        fit=FitSummary(chi2_per_dof=1.01, pixels=5000, iterations=9),
        provenance={"exposure": "measured"},
        warnings=(Caution(code="c", message="m"),),
        timing_s={"read": 0.1},
    )


@pytest.mark.parametrize("measurement", [full(), Measurement(), Measurement.refused("too dark")])
def test_no_key_is_ever_missing_and_their_order_is_fixed(measurement):
    assert list(json.loads(measurement.to_json())) == KEYS
    assert KEYS[1:] == [field.name for field in fields(Measurement)]


def test_round_trip_keeps_everything():
    text = full().to_json()
    back = Measurement.from_json(text)
    assert back.to_json() == text
    assert back.sign == full().sign
    assert back.trajectory == full().trajectory
    assert back.budget == full().budget
    assert math.isnan(back.profiles.half_width_px[1])


def test_numbers_that_are_not_finite_become_null():
    plain = json.loads(Measurement(speed_m_s=math.inf, position_m=(math.nan, 1.0, 2.0)).to_json())
    assert plain["speed_m_s"] is None
    assert plain["position_m"] == [None, 1.0, 2.0]


def test_refused_says_why_and_holds_no_number():
    plain = json.loads(Measurement.refused("no streak").to_json())
    assert (plain["status"], plain["reason"]) == ("refused", "no streak")
    assert plain["position_m"] is plain["speed_m_s"] is plain["trajectory"] is None


def test_json_is_one_ascii_line_even_for_odd_file_names():
    name = "caf\udce9\n\u2603.dng"
    text = Measurement(inputs=Inputs(shot=InputFile(path=name, sha256=""))).to_json()
    assert text.isascii()
    assert "\n" not in text
    assert json.loads(text)["inputs"]["shot"]["path"] == name


def changed(key: str, value: object) -> str:
    return json.dumps({**json.loads(full().to_json()), key: value})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ("[]", "schema is None"),
        ('{"schema": "toolkit.measurement/2"}', "schema is 'toolkit.measurement/2'"),
        ('{"schema": "toolkit.measurement/1"}', "key 'version' is missing"),
        (changed("speed", 1), "unknown key 'speed'"),
        (changed("speed_m_s", "fast"), "measurement.speed_m_s: 'fast' is not a float"),
        (changed("speed_m_s", True), "measurement.speed_m_s: True is not a float"),
        (changed("position_m", [1, 2]), "measurement.position_m: 2 entries; 3 are needed"),
        (changed("sign", {"ambiguous": True}), "measurement.sign: key 'probability' is missing"),
        (changed("status", None), "measurement.status: None is not a str"),
    ],
)
def test_from_json_names_what_is_wrong(text, reason):
    with pytest.raises(ConfigError, match=reason):
        Measurement.from_json(text)


def test_numbers_of_tensors():
    assert numbers(torch.tensor(2.0)) == 2.0
    assert numbers(torch.zeros(2, 1, 2)) == (((0.0, 0.0),), ((0.0, 0.0),))
