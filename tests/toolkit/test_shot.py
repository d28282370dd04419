import hashlib
from dataclasses import replace
from inspect import signature
from pathlib import Path

import cv2
import numpy as np
import pytest

import toolkit.shot
from toolkit import ConfigError, ImageError, MismatchError, PluginError, StreakError, measure
from toolkit.imaging import write_png16
from toolkit.measurement import Caution, Measurement
from toolkit.shot import load_shot, measure_shot, refuse_shot

COLOUR = (0.5, 0.6, 0.7)


def load(folder: Path, **changes: object) -> toolkit.shot.ShotInputs:
    given = {
        "background": [folder / "empty.png"],
        "ball_radius": 0.036,
        "ball_colours": [COLOUR],
    }
    return load_shot(folder / "shot.png", **{**given, **changes})


def write_rig(folder: Path, text: str, name: str = "rig.toml") -> Path:
    path = folder / name
    path.write_text(f'schema = "toolkit.rig/1"\n{text}')
    return path


RIG = """
[ball]
radius_m = 0.02
radius_std_m = 0.001
colours = [[0.1, 0.2, 0.3]]
[exposure]
time_s = 0.5
time_std_s = 0.01
readout_s = 0.03
[background]
images = ["empty.png"]
"""


def test_flags_alone(folder):
    shot = load(folder)
    assert shot.ball_radius == 0.036
    assert shot.exposure == pytest.approx(0.01)
    assert shot.estimator.colour == COLOUR
    assert shot.estimator_name == "uniform"
    assert shot.camera.fx == 50
    assert (shot.image.width, shot.background.width) == (40, 40)
    assert shot.provenance["exposure"] == "measured"
    assert shot.provenance["ball_radius_std"] == "assumed"
    assert shot.provenance["response"] == "measured"
    assert (shot.readout, shot.provenance["readout"]) == (0.0, "assumed")


def test_inputs_carry_their_hashes(folder):
    inputs = load(folder).inputs
    expected = hashlib.sha256((folder / "shot.png").read_bytes()).hexdigest()
    assert (inputs.shot.path, inputs.shot.sha256) == (str(folder / "shot.png"), expected)
    assert [item.path for item in inputs.background] == [str(folder / "empty.png")]
    assert inputs.camera.path == str(folder / "camera.toml")


def test_rig_in_the_folder_is_enough(folder):
    write_rig(folder, RIG)
    shot = load_shot(folder / "shot.png")
    assert (shot.ball_radius, shot.ball_radius_std) == (0.02, 0.001)
    assert (shot.exposure, shot.exposure_std) == (0.5, 0.01)
    assert shot.estimator.colour == (0.1, 0.2, 0.3)
    assert shot.readout == 0.03
    assert shot.provenance["exposure_std"] == shot.provenance["readout"] == "measured"


def test_flags_beat_the_rig_and_the_rig_the_file(folder):
    write_rig(folder, RIG)
    shot = load(folder, exposure=0.25)
    assert (shot.ball_radius, shot.exposure, shot.exposure_std) == (0.036, 0.25, 0.0)
    assert (shot.readout, load(folder, readout=0.0).readout) == (0.03, 0.0)
    assert shot.estimator.colour == COLOUR


def test_named_rig_replaces_the_one_in_the_folder(folder):
    write_rig(folder, RIG)
    other = write_rig(folder, RIG.replace("0.02\n", "0.04\n"), "other.toml")
    assert load_shot(folder / "shot.png", rig=other).ball_radius == 0.04


def test_option_by_set_beats_the_colour(folder):
    assert load(folder, options={"colour": "1,1,1"}).estimator.colour == (1.0, 1.0, 1.0)


def test_everything_missing_is_named_at_once(folder):
    (folder / "camera.toml").unlink()
    with pytest.raises(ConfigError) as caught:
        load_shot(folder / "shot.png")
    text = str(caught.value)
    for flag in ("--camera F", "--background F", "--radius METRES"):
        assert flag in text
    assert "\n" not in text


def test_exposure_may_be_unknown(folder):
    write_png16(folder / "shot.png", np.linspace(0.2, 0.4, 3600).reshape(3, 30, 40))
    shot = load(folder)
    assert shot.exposure is None
    assert not {"exposure", "readout"} & set(shot.provenance)
    with pytest.raises(ConfigError, match=r"a readout of 0\.02 s says nothing without"):
        load(folder, readout=0.02)
    assert load(folder, readout=0.02, exposure=0.1).readout == 0.02


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"ball_radius": 0.0},
            "the ball's radius is 0 m; a number from 1e-06 to 10000 m is needed",
        ),
        ({"ball_radius": float("nan")}, "the ball's radius is nan"),
        ({"ball_radius_std": -1.0}, "deviation of the ball's radius is -1 m; zero or a positive"),
        ({"exposure": -0.1}, "the exposure time is -0.1 s; a number from"),
        ({"exposure": float("inf")}, "the exposure time is inf"),
        ({"readout": -0.1}, "the readout time is -0.1 s; a number from 0 to"),
        ({"stage": "edges"}, "stage 'edges' is unknown; use one of profiles, contours, sweep"),
        ({"roi": (0, 0, 41, 30)}, r"roi 0,0,41,30 .* is not inside the picture of 40x30"),
        ({"roi": (-1, 0, 4, 4)}, "roi -1,0,4,4"),
        ({"roi": (1, 1, 0, 4)}, "roi 1,1,0,4"),
        ({"options": {"gloss": "1"}}, "has no field 'gloss'"),
        ({"ball_colours": [COLOUR, COLOUR]}, "2 ball colours are given"),
        ({"camera": "none.toml"}, "none.toml does not exist"),
        ({"rig": "none.toml"}, "none.toml does not exist"),
        ({"response": "nonsense"}, "nonsense"),
    ],
)
def test_impossible_value_is_a_config_error(folder, changes, reason):
    with pytest.raises(ConfigError, match=reason):
        load(folder, **changes)


def test_roi_that_just_fits_is_kept(folder):
    assert load(folder, roi=(0, 0, 40, 30)).roi == (0, 0, 40, 30)


def test_shot_that_is_not_there_comes_first(tmp_path):
    with pytest.raises(ImageError, match=r"no\.png does not exist"):
        load_shot(tmp_path / "no.png")


def test_unknown_estimator(folder):
    with pytest.raises(PluginError, match="no estimator 'shiny' is installed"):
        load(folder, estimator="shiny")


def test_background_of_another_size(folder):
    write_png16(folder / "empty.png", np.linspace(0.2, 0.4, 2400).reshape(3, 20, 40))
    with pytest.raises(MismatchError, match=r"shot.png has 40x30 .*empty.png has 40x20"):
        load(folder)


def test_stage_and_readout_reach_the_measurement(folder, monkeypatch):
    seen: dict[str, object] = {}

    def keep(image, background, **rest):
        seen.update(rest)
        return Measurement()

    monkeypatch.setattr(toolkit.shot, "measure", keep)
    measure_shot(load(folder, stage="profiles", readout=0.02))
    assert (seen["stage"], seen["readout"]) == ("profiles", 0.02)
    measure_shot(load(folder))
    defaults = signature(measure).parameters
    assert all(seen[name] == defaults[name].default for name in ("stage", "readout"))


def stand_in(**wanted: object) -> Measurement:
    """What a pipeline that measures nothing would hand back."""
    assert wanted["ball_radius"] == 0.036
    return Measurement(
        stage="contours",
        provenance={"axis": "inferred"},
        warnings=(Caution(code="own", message="own"),),
        timing_s={"fit": 1.0},
    )


def test_measurement_gets_inputs_provenance_and_times(folder, monkeypatch):
    monkeypatch.setattr(toolkit.shot, "measure", lambda image, background, **rest: stand_in(**rest))
    shot = load(folder)
    measurement = measure_shot(shot)
    assert measurement.inputs == shot.inputs
    assert measurement.estimator == "uniform"
    assert measurement.provenance == {"axis": "inferred", **shot.provenance}
    assert [caution.code for caution in measurement.warnings] == ["own"]
    assert set(measurement.timing_s) == {"fit", "read", "measure"}
    assert measurement.timing_s["read"] > 0


def test_assumed_response_is_a_caution(folder, monkeypatch):
    monkeypatch.setattr(toolkit.shot, "measure", lambda image, background, **rest: stand_in(**rest))
    for name in ("shot.png", "empty.png"):
        cv2.imwrite(str(folder / name), np.arange(3600).reshape(30, 40, 3).astype(np.uint8))
    assumed = measure_shot(load(folder))
    assert assumed.warnings[0].code == "response_assumed"
    assert "--response" in assumed.warnings[0].message
    assert assumed.provenance["response"] == "assumed"
    named = measure_shot(load(folder, response="srgb"))
    assert [caution.code for caution in named.warnings] == ["own"]


def test_refusal_keeps_what_was_read(folder):
    shot = load(folder)
    refused = refuse_shot(shot, "no streak")
    assert (refused.status, refused.reason) == ("refused", "no streak")
    assert refused.inputs == shot.inputs
    assert refused.provenance == shot.provenance
    assert refused.position_m is None


def test_shot_that_shows_no_streak_is_refused(folder):
    shot = load(folder)
    still = replace(shot, image=replace(shot.image, rgb=shot.background.rgb.clone()))
    with pytest.raises(StreakError):
        measure_shot(still)


def test_auto_lists_what_the_others_need_where_none_will_do(folder):
    shot = load(folder, estimator="auto")
    with pytest.raises(StreakError, match=r"none of the estimators .* not tried: .*two pigments"):
        measure_shot(shot)
