import math

import numpy as np
import pytest
from sweep_scenes import sweep_shot
from sweep_score import (
    compare,
    in_processes,
    is_wide,
    load_rows,
    rms,
    save_rows,
    score,
    summary,
)

from plugins.uniform import Uniform
from toolkit import Measurement
from toolkit.measurement import Bound, FitSummary, Sign


@pytest.fixture(scope="module")
def shot():
    return sweep_shot(5)


def result_with(shot, *, sign=1.0, errors=(0.01, 0.0, -0.02, 0.0, 0.0, 0.0), **changes):
    """A measurement that errs by so many metres and m/s, each known to a hundredth."""
    velocity = sign * (shot.velocity.numpy() + errors[3:])
    values = {
        "time_s": shot.scene.exposure / 2,
        "position_m": tuple(shot.position.numpy() + errors[:3]),
        "position_std_m": (0.01, 0.01, 0.01),
        "velocity_m_s": tuple(velocity),
        "speed_m_s": float(np.linalg.norm(velocity)),
        "speed_std_m_s": 0.01,
        "state_covariance": tuple(map(tuple, np.diag([1e-4] * 6))),
        "sign": Sign(ambiguous=True, probability=0.5),
        "fit": FitSummary(chi2_per_dof=1.0, pixels=1, iterations=1),
        "stage": "sweep",
    }
    return Measurement(**(values | changes))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_errors_are_those_of_the_branch_nearest_the_truth(shot, sign):
    row = compare(shot, result_with(shot, sign=sign))
    assert row["error"] == pytest.approx([0.01, 0, -0.02, 0], abs=1e-12)
    assert row["nees"] == pytest.approx(1 + 4)
    assert row["is_true_sign"] == (sign > 0)


def test_the_reverse_motion_turns_the_covariance_too(shot):
    covariance = np.diag([1e-4] * 6)
    covariance[0, 3] = covariance[3, 0] = 0.9e-4
    told = tuple(map(tuple, covariance))
    errors = (0.01, 0, 0, 0.01, 0, 0)
    same = compare(shot, result_with(shot, errors=errors, state_covariance=told))
    turned = compare(shot, result_with(shot, errors=errors, sign=-1.0, state_covariance=told))
    assert same["nees"] == pytest.approx(2 / 1.9)
    assert turned["nees"] == pytest.approx(2 / 0.1)


def test_shots_whose_speed_cannot_be_known_count_apart(shot):
    speed = float(shot.velocity.norm())
    position = (0.01, 0.01, 0.01)

    def row(bound):
        told = Bound(position_std_m=position, speed_std_m_s=bound, efficiency=None)
        return compare(shot, result_with(shot, bound=told))

    assert not is_wide(row(0.09 * speed))
    assert is_wide(row(0.11 * speed))
    still = compare(shot, result_with(shot, speed_std_m_s=None, speed_upper_m_s=2 * speed))
    assert is_wide(still)
    assert still["nees"] is None
    rows = [r | {"seed": 1, "seconds": 1.0} for r in (row(0.11 * speed), still)]
    assert "2 with a speed that cannot be known so well, 1 of them" in summary(rows)


def test_a_summary_tells_bounds_cautions_and_refusals(shot):
    told = Bound(position_std_m=(0.01, 0.01, 0.01), speed_std_m_s=0.02, efficiency=None)
    rows = [
        compare(shot, result_with(shot, bound=told, errors=(e, 0, 0, 0, 0, 0)))
        | {"seed": seed, "seconds": 1.0}
        for seed, e in ((1, 0.03), (2, -0.01))
    ]
    rows += [{"seed": n, "refused": f"too short by {n} px"} for n in (3, 4)]
    text = summary(rows)
    assert "4 shots: 2 measured" in text
    assert f"rms error / bound{'':15}{math.sqrt(5):9.3f}" in text
    assert "2 x too short by # px" in text
    assert "of seeds: 1 (3.0), 2 (1.0)" in text
    without = [r | {"bound": None} for r in rows if r["refused"] is None]
    assert f"rms error / bound{'':15}{'-':>9}" in summary(without)


def test_rows_come_back_from_a_file(shot, tmp_path):
    rows = [compare(shot, result_with(shot)), {"refused": "no"}]
    save_rows(tmp_path / "rows", rows)
    assert load_rows(tmp_path / "rows") == rows


def test_a_real_measurement_is_scored(shot):
    row = score(shot, Uniform(colour=shot.scene.appearance.colour), stage="contours")
    assert row["refused"] is None
    assert abs(row["error"][2]) < 6 * row["std"][2]
    assert row["seconds"] > 0
    refused = score(shot, Uniform(), roi=(0, 0, 12, 12), stage="contours")
    assert refused["refused"]


def test_a_crash_is_counted(shot):
    assert score(shot, Uniform(), image="no picture")["refused"].startswith("CRASH ")


def test_tasks_are_done_in_their_order():
    assert list(in_processes(abs, [-3, 2, -1], workers=1)) == [3, 2, 1]
    assert list(in_processes(abs, [-3, 2, -1], workers=2)) == [3, 2, 1]


def test_rms_leaves_out_what_is_not_known():
    assert rms(np.array([[3.0, 1.0], [4.0, np.nan]])).tolist() == [math.sqrt(12.5), 1]
