from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.wizard.memory import read_memory
from calibration.wizard.run import NAMES, run_wizard
from toolkit.ball_file import read_ball
from toolkit.camera_file import read_camera
from toolkit.cli.main import main
from toolkit.errors import CalibrationError, ConfigError, ImageError, MismatchError, StreakError
from toolkit.imaging import write_png16
from toolkit.response import load_response
from toolkit.rig import read_rig

GIVEN = {
    "images": ("boards",),
    "background": ("background.dng",),
    "radius": ("50 mm",),
}


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.toml")}


def statuses(outcomes):
    return {name: outcome.status for name, outcome in outcomes.items()}


@pytest.fixture(scope="module")
def outcomes(finished):
    """How the steps of the run ended that made `finished`."""
    return finished[1]


def test_flags_alone_make_a_rig(done, outcomes):
    scene = done
    rig = read_rig(scene / "rig.toml")
    assert read_camera(rig.camera).width == 480
    assert rig.ball_radius == 0.05
    assert rig.response == "linear"  # the photos are RAW
    assert [path.resolve() for path in rig.background] == [scene / "background.dng"]
    assert rig.exposure is None  # the files tell it
    assert statuses(outcomes)["lens"] == "done"
    assert statuses(outcomes)["check"] == "skipped"
    assert "6 of 6 photos used" in outcomes["lens"].told[0]


def test_a_second_run_changes_nothing_and_needs_no_flag(done, make_desk):
    scene = done
    before = contents(scene)
    stamps = {path: path.stat().st_mtime_ns for path in scene.glob("*.toml")}
    outcomes = run_wizard(make_desk(scene, alone=True))
    assert set(statuses(outcomes).values()) == {"kept", "skipped"}
    assert contents(scene) == before
    assert {path: path.stat().st_mtime_ns for path in scene.glob("*.toml")} == stamps


def test_only_what_changed_is_done_again(done, make_desk):
    scene = done
    (scene / "boards" / "board_05.dng").unlink()
    ended = statuses(run_wizard(make_desk(scene, given={"radius": ("0,04",)}, alone=True)))
    assert {name for name, status in ended.items() if status == "done"} == {
        "photos",
        "lens",
        "background",
        "ball",
        "rig",
    }
    assert read_rig(scene / "rig.toml").ball_radius == 0.04


def test_a_renamed_photo_is_the_same_photo(done, make_desk):
    scene = done
    (scene / "boards" / "board_05.dng").rename(scene / "boards" / "board_05b.dng")
    assert statuses(run_wizard(make_desk(scene, alone=True)))["lens"] == "kept"


def test_all_missing_flags_are_named_in_one_line(tmp_path, make_desk):
    with pytest.raises(ConfigError) as caught:
        run_wizard(make_desk(tmp_path, alone=True))
    for flag in ("--images PHOTO...", "--camera F", "--background F", "--radius METRES"):
        assert flag in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_newcomers_mistakes_are_explained_and_asked_again(scene, make_desk):
    (scene / "holiday").mkdir()
    for number in range(3):  # pictures without a board, all different
        sky = np.tile(np.linspace(0, 0.2 + 0.1 * number, 160), (3, 120, 1))
        write_png16(scene / "holiday" / f"{number}.png", sky)
    desk = make_desk(
        scene,
        "no",  # there is a board
        "board",  # a wrong path
        "holiday",  # no boards in it
        "boards",
        "9x6",  # the size, asked because none was found
        "yes",  # go on with few views
        "background.dng",
        "",  # no rolling shutter
        "50",  # a unit left out
        "0,05",
        "",  # how sure
        "",  # no sharp picture
        "none",
    )
    outcomes = run_wizard(desk)
    heard = "\n".join(desk.asker.person.heard)
    assert "board does not exist; did you mean boards?" in heard
    assert "! 0 different usable views of a board among 3 photos" in heard
    assert "Answer again, or stop with Ctrl-C: what is done is kept." in heard
    assert "write the unit, as in '50 mm'" in heard
    assert desk.asker.person.lines == []
    assert statuses(outcomes)["rig"] == "done"
    assert read_rig(scene / "rig.toml").ball_radius == 0.05


def test_what_is_done_is_kept_when_the_person_stops(scene, make_desk):
    with pytest.raises(EOFError, match="Pictures without the ball"):
        run_wizard(make_desk(scene, "no", "boards", "yes"))
    camera = (scene / "camera.toml").read_bytes()
    desk = make_desk(scene, "background.dng", "", "5 cm", "", "", "none")
    assert statuses(run_wizard(desk))["lens"] == "kept"
    assert (scene / "camera.toml").read_bytes() == camera


def test_the_person_may_add_photos_to_a_weak_camera(scene, make_desk):
    given = {name: words for name, words in GIVEN.items() if name != "images"}
    lines = ["no", "'boards/board_0[0-4].dng'", "no", "boards", "yes", "", "", "", ""]
    desk = make_desk(scene, *lines, given=given)
    outcomes = run_wizard(desk)
    assert "6 of 6 photos used" in outcomes["lens"].told[0]


def test_a_doubtful_camera_can_be_accepted_beforehand(scene, make_desk):
    given = GIVEN | {"readout": ("0",), "radius_std": ("none",), "ball_image": ("none",)}
    desk = make_desk(scene, given=given | {"shot": ("none",)}, takes_doubtful=True)
    outcomes = run_wizard(desk)  # with somebody there who is asked nothing
    assert any(line.startswith("caution: ") for line in outcomes["lens"].told)
    assert desk.asker.person.heard == []


def test_a_camera_file_takes_the_place_of_photos(done, tmp_path, make_desk):
    scene = done
    other = tmp_path / "other"
    other.mkdir()
    given = {
        "camera": ("camera.toml",),
        "background": ("background.dng",),
        "radius": ("0.05",),
        "response": ("srgb",),
    }
    outcomes = run_wizard(make_desk(other, given=given, alone=True))
    assert statuses(outcomes)["photos"] == statuses(outcomes)["lens"] == "skipped"
    rig = read_rig(other / "rig.toml")
    assert rig.camera.resolve() == (scene / "camera.toml").resolve()
    assert rig.response == "srgb"


def test_files_of_somebody_else_are_not_replaced_unasked(done, make_desk):
    scene = done
    with (scene / "camera.toml").open("a") as file:
        file.write("# by hand\n")
    before = contents(scene)
    given = {"images": ("boards/board_0[0-4].dng",)}
    with pytest.raises(ConfigError, match=r"camera.toml is there already.*--replace, or use it"):
        run_wizard(make_desk(scene, given=given, alone=True))
    assert (scene / "camera.toml").read_bytes() == before["camera.toml"]
    run_wizard(make_desk(scene, given=given, alone=True, may_replace=True))
    assert b"# by hand" not in (scene / "camera.toml").read_bytes()


def test_a_rig_keeps_what_the_wizard_does_not_ask(done, make_desk):
    scene = done
    rig = scene / "rig.toml"
    rig.write_text(
        rig.read_text() + '\n[measure]\nestimator = "uniform"\ncolour = [0.1, 0.2, 0.3]\n'
    )
    run_wizard(make_desk(scene, given={"radius": ("4 cm",)}, alone=True, may_replace=True))
    settings = read_rig(rig)
    assert settings.ball_radius == 0.04
    assert settings.estimator == "uniform"
    assert settings.options == {"colour": "0.1,0.2,0.3"}


def test_a_step_can_be_answered_anew(done, make_desk):
    scene = done
    desk = make_desk(scene, "6 cm", "", "")
    desk.memory.forget("ball")
    desk.asker.refuse("radius", "radius_std", "ball_image")
    assert statuses(run_wizard(desk))["ball"] == "done"
    assert read_rig(scene / "rig.toml").ball_radius == 0.06


@pytest.mark.parametrize(
    ("answers", "error", "message"),
    [
        ({"images": ("background.dng", "shot.dng")}, CalibrationError, "2 different photos"),
        ({"images": ("text.txt",)}, ImageError, "none of 1 files is a photo: text.txt is a text"),
        ({"images": ("gone",)}, ConfigError, "^--images: gone does not exist"),
        ({"response": ("srgbb",)}, ConfigError, "^--response: .*did you mean"),
        ({"radius": ("36",)}, ConfigError, "^--radius: .*'36 mm'"),
        ({"radius_std": ("6 cm",)}, ConfigError, "cannot be unsure by 0.06 m"),
    ],
)
def test_alone_each_mistake_ends_the_run_with_its_own_error(
    scene, make_desk, answers, error, message
):
    (scene / "text.txt").write_text("no picture")
    given = GIVEN | answers
    with pytest.raises(error, match=message):
        run_wizard(make_desk(scene, given=given, alone=True))
    assert not (scene / "rig.toml").exists()


def test_a_background_of_another_size_is_named(done, make_desk):
    write_png16(done / "small.png", np.random.default_rng(0).uniform(0, 1, (3, 48, 64)))
    given = {"background": ("small.png",)}
    with pytest.raises(MismatchError, match=r"small.png does not fit .*camera.toml"):
        run_wizard(make_desk(done, given=given, alone=True))


@pytest.mark.parametrize(("kind", "name"), [("checker", "9x6 inner"), ("charuco", "ChArUco")])
def test_a_board_is_written_where_there_is_none(tmp_path, make_desk, kind, name):
    desk = make_desk(tmp_path, "yes", kind[:3], "letter")
    with pytest.raises(EOFError, match="Photos of the board"):  # they are to be taken now
        run_wizard(desk)
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    (line, *_) = desk.memory.steps["board"].told
    assert name in line
    assert "on letter" in line
    before = (tmp_path / "board.pdf").stat().st_mtime_ns
    with pytest.raises(EOFError, match="Photos of the board"):
        run_wizard(make_desk(tmp_path))
    assert (tmp_path / "board.pdf").stat().st_mtime_ns == before


def test_a_report_of_the_camera_is_written(done):
    assert "<h1>Calibration report</h1>" in (done / "calibration.html").read_text()


def test_a_check_shot_that_fails_is_explained_and_another_one_asked_for(done, make_desk):
    desk = make_desk(done, "shot.dng", given={"shot": ("background.dng",)})
    outcomes = run_wizard(desk)
    heard = "\n".join(desk.asker.person.heard)
    assert "Answer again, or stop with Ctrl-C" in heard
    assert any("speed" in line for line in outcomes["check"].told)
    with pytest.raises(StreakError):
        run_wizard(make_desk(done, given={"shot": ("background.dng",)}, alone=True))
    assert statuses(run_wizard(make_desk(done, alone=True)))["check"] == "kept"


def test_every_step_is_remembered_under_its_name(done):
    scene = done
    assert set(read_memory(scene, NAMES).steps) <= set(NAMES)
    assert Path("rig.toml").exists()


@pytest.fixture(scope="module")
def shaded(tmp_path_factory):
    """A simulated folder with a shaded ball, seen sharply, and its true camera."""
    folder = tmp_path_factory.mktemp("shaded") / "sim"
    words = ["--preset", "shaded", "--size", "640x480", "--format", "png", "--quiet"]
    assert main(["simulate", "--out", str(folder), *words]) == 0
    (folder / "rig.toml").unlink()
    (folder / "ball.toml").unlink()
    return folder


def test_a_sharp_picture_teaches_the_balls_looks(shaded, make_desk, monkeypatch):
    monkeypatch.chdir(shaded)
    given = {
        "camera": ("camera.toml",),
        "background": ("background.png",),
        "response": ("linear",),
        "radius": ("50 mm",),
        "ball_image": ("ball.png",),
        "kind_of_ball": ("shaded",),
    }
    with pytest.raises(ConfigError, match=r"its pictures show one .*--kind-of-ball"):
        run_wizard(make_desk(shaded, given=given | {"kind_of_ball": ("two",)}, alone=True))
    assert not (shaded / "ball.toml").exists()
    outcomes = run_wizard(make_desk(shaded, given=given, alone=True))
    assert "found in 1 sharp picture, " in outcomes["ball"].told[1]
    rig = read_rig(shaded / "rig.toml")
    assert rig.estimator == "known-shading"
    assert read_ball(rig.ball).sharp.image.resolve() == shaded / "ball.png"
    assert set(statuses(run_wizard(make_desk(shaded, alone=True))).values()) == {"kept", "skipped"}


def write_bracket(folder, times):
    """8-bit photos of one scene by a camera that stores light to the power of 1/2.2."""
    folder.mkdir()
    generator = np.random.default_rng(1)
    stops = cv2.resize(generator.uniform(-9, 0, (9, 12)), (160, 120), interpolation=cv2.INTER_CUBIC)
    for number, seconds in enumerate(times):
        bright = np.clip(seconds * 2.0**stops, 0, 1) ** (1 / 2.2)
        noisy = 255 * np.clip(bright + generator.normal(0, 1 / 255, bright.shape), 0, 1)
        grey = np.rint(noisy).astype(np.uint8)
        cv2.imwrite(str(folder / f"{number}.png"), np.stack([grey] * 3, axis=-1))


def test_the_response_is_measured_from_a_bracket(done, make_desk):
    times = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0]
    write_bracket(done / "bracket", times)
    desk = make_desk(
        done,
        "bracket",  # the files tell no times
        *["", "", "1/4,1/2,1,2,4"],  # one is missing
        *["", "", ",".join(map(str, times))],
        given={"response": ("bracket",)},
    )
    outcomes = run_wizard(desk)
    heard = "\n".join(desk.asker.person.heard)
    assert heard.count("Their exposure times in seconds") == 2
    assert desk.asker.person.lines == []
    assert "measured from 6 photos, 0.25 to 8 s" in outcomes["response"].told[0]
    rig = read_rig(done / "rig.toml")
    light = load_response(rig.response).light(np.array([0.5]), 1)
    assert light == pytest.approx(0.5**2.2, rel=0.02)
    assert set(statuses(run_wizard(make_desk(done, alone=True))).values()) == {"kept", "skipped"}


def test_a_bracket_that_tells_nothing_is_refused_and_changes_nothing(done, make_desk):
    write_bracket(done / "dark", [1e-5, 2e-5])
    before = contents(done)
    given = {"bracket": ("dark",), "times": ("1,2",)}
    with pytest.raises(CalibrationError):
        run_wizard(make_desk(done, given=given, alone=True))
    assert contents(done) == before
