import json
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time

import pytest

from calibration.cli.wizard import spread
from toolkit.cli.main import main
from toolkit.rig import read_rig

# a session leader that opens a terminal gets it as its own: then Ctrl-C reaches it, unless whoever
# runs the tests in the background had it ignored
CHILD = (
    "import os, signal, sys; os.close(os.open(os.ttyname(0), os.O_RDWR));"
    "signal.signal(signal.SIGINT, signal.default_int_handler);"
    "from toolkit.cli.main import main; sys.exit(main(sys.argv[1:]))"
)
PATIENCE = 120
"""Seconds after which a child that says nothing more has failed; no test waits that long."""


class Conversation:
    """`toolkit` in a pseudo-terminal, spoken with as a person would."""

    def __init__(self, *words, cwd):
        self.master, slave = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD, *words],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd=cwd,
            start_new_session=True,
        )
        os.close(slave)
        self.heard = ""
        self.place = 0

    def wait_for(self, text):
        """Read until a text appears behind the last one that was waited for."""
        deadline = time.monotonic() + PATIENCE
        while text not in self.heard[self.place :]:
            if not self._read(deadline):
                raise AssertionError(f"'{text}' never came; heard: {self.heard[self.place :]}")
        self.place = self.heard.index(text, self.place) + len(text)

    def answer(self, question, line):
        """Wait for a question, and type a line."""
        self.wait_for(question)
        os.write(self.master, line.encode() + b"\n")

    def press_ctrl_c(self):
        os.write(self.master, b"\x03")

    def end(self):
        """Read to the end, and give the exit code."""
        deadline = time.monotonic() + PATIENCE
        while self._read(deadline):
            pass
        return self.process.wait(timeout=PATIENCE)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.master)

    def _read(self, deadline):
        ready, _, _ = select.select([self.master], [], [], max(deadline - time.monotonic(), 0))
        try:
            chunk = os.read(self.master, 65536) if ready else b""
        except OSError:  # how Linux says that the other end was closed
            chunk = b""
        text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", chunk.decode("utf-8", "replace"))
        self.heard += text.replace("\r\n", "\n")
        return bool(chunk)


@pytest.fixture
def talk():
    open_ones = []

    def start(*words, cwd):
        open_ones.append(Conversation(*words, cwd=cwd))
        return open_ones[-1]

    yield start
    for one in open_ones:
        one.close()


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wizard") / "sim"
    words = ["--boards", "6", "--size", "480x360", "--quiet"]
    assert main(["simulate", "--out", str(folder), *words]) == 0
    return folder


@pytest.fixture
def scene(simulated, tmp_path):
    """An own copy of the pictures, without any file that a rig needs."""
    own = tmp_path / "scene"
    own.mkdir()
    shutil.copytree(simulated / "boards", own / "my boards")
    for name in ("background.dng", "shot.dng"):
        shutil.copy(simulated / name, own / name)
    return own


def test_a_newcomer_gets_from_an_empty_folder_to_a_measurement(scene, talk, capsys, monkeypatch):
    person = talk("wizard", cwd=scene)
    person.wait_for("[1/8] A board to photograph")
    person.answer("Write a board to print?", "perhaps")
    person.wait_for("! 'perhaps' is neither yes nor no")
    person.answer("Write a board to print?", "")
    person.wait_for("[2/8] Photos of the board")
    person.wait_for("Take 10 to 20 photos")
    person.answer("Photos of the board (a folder", "my bords")
    person.wait_for("my does not exist")  # two words, as a shell reads them
    person.answer("Photos of the board (a folder", "'my bords'")
    person.wait_for("! my bords does not exist; did you mean my boards?")
    person.answer("Photos of the board (a folder", "my boards")
    person.wait_for("[3/8] The camera's lens")
    person.wait_for("6 of 6 photos used")
    person.answer("Go on with this camera?", "yes")
    person.wait_for("response: linear")
    person.answer("Pictures without the ball", "background.dng")
    person.answer("Rolling shutter", "")
    person.answer("The ball's radius", "")
    person.wait_for("! an answer is needed; Ctrl-C stops")
    person.answer("The ball's radius", "0,05")
    person.answer("How sure is that", "0,2 mm")
    person.answer("Sharp pictures of the resting ball", "none")
    person.wait_for("ball: radius 50 mm +/- 0.2 mm")
    person.wait_for("wrote rig.toml")
    person.answer("A shot with a streak", "shot.dng")
    person.wait_for("speed")
    person.wait_for("next: toolkit measure")
    assert person.end() == 0
    rig = read_rig(scene / "rig.toml")
    assert (rig.ball_radius, rig.ball_radius_std) == (0.05, 0.0002)

    files = {path: path.read_bytes() for path in scene.glob("*.toml")}
    again = talk("wizard", cwd=scene)
    assert again.end() == 0
    assert again.heard.count("(done before, unchanged)") == 7
    assert "?" not in again.heard  # nothing is asked
    assert {path: path.read_bytes() for path in scene.glob("*.toml")} == files

    monkeypatch.chdir(scene)
    capsys.readouterr()
    assert main(["measure", "shot.dng", "--stage", "contours"]) == 0  # with the rig alone
    assert "speed" in capsys.readouterr().out


def test_ctrl_c_keeps_what_is_done(scene, talk, capsys, monkeypatch):
    person = talk("wizard", "--images", "my boards", cwd=scene)
    person.answer("Go on with this camera?", "yes")
    person.wait_for("Pictures without the ball")
    person.press_ctrl_c()
    assert person.end() == 130
    assert "kept: photos, lens, response; `toolkit wizard` goes on from here" in person.heard
    assert "toolkit: interrupted" in person.heard
    camera = (scene / "camera.toml").read_bytes()
    assert not (scene / "rig.toml").exists()

    monkeypatch.chdir(scene)
    capsys.readouterr()
    assert main(["wizard", "--background", "background.dng", "--radius", "5 cm"]) == 0
    assert "lens: 6 of 6 photos used" in capsys.readouterr().out
    assert (scene / "camera.toml").read_bytes() == camera
    assert read_rig(scene / "rig.toml").ball_radius == 0.05


def test_a_names_control_characters_do_not_reach_the_terminal(tmp_path, talk):
    (tmp_path / "a\x1b[31m.jpg").touch()
    person = talk("wizard", "--no-make-board", cwd=tmp_path)
    person.answer("Photos of the board (a folder", "gone.jpg")
    person.wait_for("holds a?[31m.jpg")
    person.press_ctrl_c()
    assert person.end() == 130


def test_without_a_terminal_nothing_waits_and_every_missing_flag_is_named(tmp_path, capsys):
    assert main(["wizard", "--folder", str(tmp_path)]) == 2
    text = capsys.readouterr()
    assert text.out == ""
    assert text.err.count("\n") == 1
    for flag in ("--images PHOTO...", "--camera F", "--background F", "--radius METRES"):
        assert flag in text.err
    assert list(tmp_path.iterdir()) == []


def test_flags_alone_do_it_and_json_tells_what_was_done(scene, capsys, monkeypatch):
    monkeypatch.chdir(scene)
    photos = sorted(map(str, (scene / "my boards").iterdir()))
    words = ["--radius", "5 cm", "--background", "background.dng", "--json", "--images", *photos]
    assert main(["wizard", *words]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema"] == "toolkit.wizard-run/1"
    assert told["rig"] == "rig.toml"
    steps = {step["name"]: step["status"] for step in told["steps"]}
    assert steps["lens"] == steps["rig"] == "done"
    assert steps["check"] == "skipped"
    assert main(["wizard", "--json", "--redo", "ball", "--radius", "4 cm"]) == 0
    steps = {s["name"]: s["status"] for s in json.loads(capsys.readouterr().out)["steps"]}
    assert {name for name, status in steps.items() if status == "done"} == {"ball", "rig"}


def test_a_refusal_is_exit_5_and_one_json_object(scene, capsys, monkeypatch):
    monkeypatch.chdir(scene)
    words = ["--images", "my boards/board_00.dng", "shot.dng", "background.dng", "--json"]
    assert main(["wizard", *words, "--background", "background.dng", "--radius", "5 cm"]) == 5
    text = capsys.readouterr()
    told = json.loads(text.out)
    assert told["status"] == "refused"
    assert told["reason"] in text.err
    assert told["rig"] is None
    assert [step["name"] for step in told["steps"]] == ["board", "photos"]
    assert not (scene / "camera.toml").exists()


def test_options_of_pictures_take_what_a_shell_makes_of_a_pattern():
    words = ["--images", "a", "b", "--radius", "5 cm", "--background", "c", "d", "--json"]
    assert spread(words) == [
        *["--images", "a", "--images", "b", "--radius", "5 cm"],
        *["--background", "c", "--background", "d", "--json"],
    ]
    assert spread(["x", "--images", "--json", "y"]) == ["x", "--images", "--json", "y"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--images", "a", "--camera", "b"], "--images and --camera are both given"),
        (["--redo", "walls"], "--redo walls is no step; there are board, photos"),
        (["--folder", "gone"], "--folder gone is no folder"),
        (["--bracket", "a", "--response", "srgb"], "--bracket and --response are both given"),
        (["a.jpg"], "Got unexpected extra argument"),
        (["--radius", "36"], "--radius: '36' would be 36 metres"),
        (["--shot", "gone.dng"], "--shot: gone.dng does not exist"),
    ],
)
def test_wrong_usage_is_exit_2(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    assert main(["wizard", *words]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_help_is_light():
    code = (
        "import sys; import calibration.cli.wizard;"
        "print([m for m in ('torch', 'cv2', 'numpy', 'rich.progress') if m in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"
