import json
import shutil
import subprocess
import sys

import pytest

from toolkit.cli.main import main
from toolkit.synthetic import benchmark_scene, render_shot
from toolkit.synthetic.folder import write_shot

SHINY = '''
from dataclasses import dataclass, field
from toolkit import AlphaEstimator

@dataclass(frozen=True, kw_only=True)
class Shiny(AlphaEstimator):
    """A ball that shines.

    Second paragraph.
    Source: nobody.
    """

    colour: tuple[float, float, float]
    """Linear colour of
    the ball."""
    gloss: float = 0.5
    """How much it shines."""
    steps: int = field(default=3, metadata={"help": "How often."})
    table: list = field(default_factory=list)
    def observe(self, image, background, noise): ...
    def foreground(self, chord, appearance): ...

@dataclass(frozen=True, kw_only=True)
class Bare(AlphaEstimator):
    def observe(self, image, background, noise): ...
    def foreground(self, chord, appearance): ...

@dataclass(frozen=True, kw_only=True)
class Child(Shiny):
    """A child."""
    extra: bool = False
    """Its own."""
'''


def run(*words: str) -> int:
    return main(["plugins", *words])


def test_list_shows_name_owner_place_and_problem(declare, capsys):
    module = declare(SHINY, "shiny = :Shiny", "Bad = :Shiny")
    declare("raise SystemExit(3)", "exits = :Any", distribution="rival")
    assert run("list") == 0
    out = capsys.readouterr().out.splitlines()
    assert len(out) == 4
    assert out[0].split()[:3] == ["Bad", "shop", "1.5"]
    assert out[1].strip().startswith("problem: its name does not match")
    assert out[2].split()[:3] == ["exits", "rival", "1.5"]
    assert out[3].endswith(f"{module}.py")
    assert module not in sys.modules


def test_list_can_load_each_and_json_says_the_same(declare, capsys):
    declare(SHINY, "shiny = :Shiny")
    declare("raise SystemExit(3)", "exits = :Any", distribution="rival")
    assert run("list", "--load", "--json") == 0
    exits, shiny = json.loads(capsys.readouterr().out)["estimators"]
    assert "cannot be imported (SystemExit: 3)" in exits["problem"]
    assert (shiny["name"], shiny["distribution"], shiny["version"]) == ("shiny", "shop", "1.5")
    assert shiny["problem"] is None


def test_list_with_nothing_installed(declare, capsys):
    declare("", group="toolkit.commands")
    assert run("list") == 0
    assert capsys.readouterr().out == "no estimator is installed\n"


def test_list_imports_nothing_heavy():
    code = (
        "import sys; from toolkit.cli.main import main; main(['plugins', 'list']); "
        "print(*{n.partition('.')[0] for n in sys.modules}, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "uniform" in done.stdout
    assert not {"torch", "numpy", "cv2", "plugins", "rich"} & set(done.stderr.split())


def test_show_explains_options(declare, capsys):
    declare(SHINY, "shiny = :Shiny")
    assert run("show", "shiny") == 0
    out = capsys.readouterr().out
    assert out.startswith("shiny: A ball that shines.\n\nSecond paragraph.\n\noptions:\n")
    assert "colour: tuple[float, float, float], must be given" in out
    assert "Linear colour of the ball." in out
    assert "given by --ball-colour R,G,B" in out
    assert "gloss: float, default 0.5" in out
    assert "given by --set gloss=VALUE" in out
    assert "How often." in out
    assert "from Python only" in out
    assert (
        "toolkit measure shot.dng --estimator shiny --ball-colour 0.8,0.4,0.1 "
        "--set gloss=0.5 --set steps=3\n" in out
    )


def test_show_json_and_inherited_help(declare, capsys):
    declare(SHINY, "child = :Child", "bare = :Bare")
    assert run("show", "child", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    helps = {option["name"]: option["help"] for option in found["options"]}
    assert helps["gloss"] == "How much it shines."
    assert helps["extra"] == "Its own."
    assert run("show", "bare") == 0
    assert capsys.readouterr().out.startswith("bare: its author wrote no description\n\nno options")


@pytest.mark.parametrize("command", ["show", "check"])
def test_an_unknown_name_is_2(command, declare, capsys):
    declare(SHINY, "shiny = :Shiny")
    assert run(command, "dull") == 2
    assert "no estimator 'dull' is installed; installed are: shiny" in capsys.readouterr().err


def test_a_broken_one_is_one_line(declare, capsys):
    declare("raise SystemExit(3)", "exits = :Any")
    assert run("show", "exits") == 2
    err = capsys.readouterr().err
    assert "estimator 'exits' of shop 1.5 cannot be imported (SystemExit: 3)" in err
    assert err.count("\n") == 1


def test_an_unknown_word_is_answered_with_the_nearest(capsys):
    assert run("lst") == 2
    assert "did you mean 'list'" in capsys.readouterr().err


def test_other_packages_commands_do_not_show_here(capsys):
    assert run("--help") == 0
    out = capsys.readouterr().out
    assert "calibrate" not in out
    assert "check" in out


def test_check_prints_a_table(capsys):
    assert run("check", "uniform", "--ball-colour", "0.2,0.6,0.2") == 0
    out = capsys.readouterr().out
    assert out.endswith("uniform: ran 24 of 24\n")
    assert len(out.splitlines()) == 25


def test_check_renders_the_ball_it_is_told_of(capsys):
    green, behind = "colour=0.1,0.5,0.1", "0.5,0.3,0.3"
    assert run("check", "uniform", "--set", green, "--background-colour", behind, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["ran"], found["failed"], len(found["results"])) == (24, [], 24)
    assert {result["status"] for result in found["results"]} == {"passed"}


def test_a_failing_check_is_5(declare, capsys):
    declare(SHINY, "shiny = :Shiny")
    assert run("check", "shiny") == 5
    out, err = capsys.readouterr()
    assert "shiny: ran 24 of 24, " in out
    assert err.startswith("toolkit: estimator 'shiny' of shop 1.5 fails ")
    assert "observe-shapes, observe-finite" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--set", "gloss"], "--set is 'gloss'; FIELD=VALUE is needed"),
        (["--ball-colour", "red"], "--ball-colour is 'red'"),
        (["--background-colour", "1,2"], "--background-colour is '1,2'"),
        (["--set", "gloss=1"], "has no field 'gloss'"),
    ],
)
def test_wrong_words_of_check_are_2(words, reason, capsys):
    assert run("check", "uniform", *words) == 2
    assert reason in capsys.readouterr().err


BAD = """
import torch
from dataclasses import dataclass, replace
from toolkit import AlphaEstimator, Observation

@dataclass(frozen=True, kw_only=True)
class Bad(AlphaEstimator):
    fault: str = "none"
    def observe(self, image, background, noise):
        variance = noise.variance(image.rgb) + noise.variance(background.rgb)
        if self.fault == "nan":
            variance = variance * torch.nan
        if self.fault == "shape":
            variance = variance[..., 1:]
        if self.fault == "type":
            variance = variance.double()
        if self.fault == "raise":
            raise KeyError("oops")
        return Observation(signal=image.rgb, ground=background.rgb, variance=variance)
    def foreground(self, chord, appearance):
        if self.fault == "late" and chord.offset.numel() > 1:
            raise ValueError("only while fitting")
        return chord.offset.new_tensor((0.9, 0.6, 0.1)).expand(*chord.offset.shape, 3)
"""


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shot")
    write_shot(folder, render_shot(benchmark_scene(width_px=30, length_widths=4)), format="png")
    return folder


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("nan", "its observe gives variances that are negative or no number"),
        ("shape", "its observe gives signal, ground, variance of shapes"),
        ("type", "its observe gives torch.float32, torch.float32, torch.float64"),
        ("raise", "its observe breaks with KeyError: 'oops'"),
        ("late", "only while fitting"),
    ],
)
def test_a_bad_answer_while_measuring_is_5(declare, simulated, tmp_path, capsys, fault, reason):
    declare(BAD, "bad = :Bad")
    shutil.copytree(simulated, tmp_path / "shot")
    overlay = tmp_path / "drawn.png"
    words = ["measure", str(tmp_path / "shot/shot.png"), "--estimator", "bad"]
    words += ["--set", f"fault={fault}", "--json", "--overlay", str(overlay)]
    assert main(words) == 5
    out, err = capsys.readouterr()
    assert err.startswith("toolkit: estimator 'bad' of shop 1.5: its ")
    assert reason in err
    assert "report this to its author" in err
    assert err.count("\n") == 1
    assert json.loads(out)["status"] == "refused"
    assert not overlay.exists()
