import errno
import logging
import os
import subprocess
import sys

import pytest

from toolkit.about import installed_version
from toolkit.cli.main import main

RAISE = "def run():\n    '''Raise it.'''\n    {}\n"


def run(*words: str) -> int:
    return main(list(words))


def declare_command(declare, body: str) -> str:
    return declare(RAISE.format(body), "run = :run", group="toolkit.commands")


@pytest.mark.parametrize("words", [[], ["--help"]])
def test_help_lists_every_command_with_its_first_line(words, capsys):
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "measure" in out
    assert "Measure the ball of one shot" in out


def test_help_of_a_stranger_runs_none_of_its_code(declare, capsys):
    module = declare(
        "raise SystemExit('imported')\ndef run():\n    '''Do a thing.\n\n    More.'''\n",
        "run = :run",
        group="toolkit.commands",
    )
    assert run("--help") == 0
    out, _ = capsys.readouterr()
    assert "Do a thing." in out
    assert "More." not in out
    assert module not in sys.modules


def test_help_survives_a_stranger_without_source(declare, capsys):
    declare("def run(:", "run = :run", "gone = nowhere.at.all:gone", group="toolkit.commands")
    assert run("--help") == 0
    out, _ = capsys.readouterr()
    assert "broken" in out
    assert "measure" in out


def test_version(capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out == f"toolkit {installed_version()}\n"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["mesure"], "toolkit: no command 'mesure'; did you mean 'measure'?\n"),
        (["zzz"], "toolkit: no command 'zzz'; there are: measure, "),
        (["measure"], "toolkit: Missing argument 'SHOT'; see toolkit measure --help\n"),
        (["measure", "a", "--colour", "1"], "toolkit: No such option: --colour"),
        (["measure", "a", "--radius", "x"], "toolkit: Invalid value for '--radius'"),
        (["--nonsense"], "toolkit: No such option: --nonsense; see toolkit --help\n"),
    ],
)
def test_usage_error_is_one_line_and_2(words, text, capsys):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(text)
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("body", "code", "text"),
    [
        ("from toolkit import ConfigError; raise ConfigError('a\\nb')", 2, "toolkit: a b\n"),
        ("from toolkit import PluginError; raise PluginError('a')", 2, "toolkit: a\n"),
        ("from toolkit import ImageError; raise ImageError('a')", 3, "toolkit: a\n"),
        ("from toolkit import MismatchError; raise MismatchError('a')", 4, "toolkit: a\n"),
        ("from toolkit import StreakError; raise StreakError('a')", 5, "toolkit: a\n"),
        ("from toolkit import CalibrationError; raise CalibrationError('a')", 5, "toolkit: a\n"),
        ("from toolkit import EnvironmentFault; raise EnvironmentFault('a')", 7, "toolkit: a\n"),
        (f"raise OSError({errno.ENOSPC}, 'No space', 'x.png')", 7, "toolkit: x.png: No space; "),
        ("raise MemoryError", 7, "toolkit: not enough memory"),
        (
            "from toolkit import ShapeError; raise ShapeError('a')",
            70,
            "toolkit: bug: ShapeError: a",
        ),
        ("1 / 0", 70, "toolkit: bug: ZeroDivisionError: division by zero; run with --debug"),
        ("raise FileNotFoundError(2, 'None', 'x')", 70, "toolkit: bug: FileNotFoundError"),
        ("raise SystemExit('a')", 70, "toolkit: bug: SystemExit: a"),
        ("raise KeyboardInterrupt", 130, "toolkit: interrupted\n"),
        ("raise EOFError", 130, "toolkit: interrupted\n"),
        ("import typer; raise typer.Exit(6)", 6, ""),
    ],
)
def test_each_error_has_its_code_and_one_line(declare, body, code, text, capsys):
    declare_command(declare, body)
    assert run("run") == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(text)
    assert err.count("\n") == (1 if text else 0)


@pytest.mark.parametrize("words", [["--debug", "run"], ["run", "--debug"]])
def test_debug_adds_the_traceback(declare, words, capsys):
    declare_command(declare, "1 / 0")
    assert main(words) == 70
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert err.splitlines()[-1].startswith("toolkit: bug: ZeroDivisionError")


@pytest.mark.parametrize(("words", "heard"), [(["run"], True), (["run", "--quiet"], False)])
def test_log_goes_to_stderr_unless_quiet(declare, words, heard, capsys):
    declare_command(
        declare, "import logging; logging.getLogger('toolkit.x').warning('hm'); print('result')"
    )
    before = logging.getLogger("toolkit").handlers[:]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert out == "result\n"
    assert err == ("toolkit: WARNING: hm\n" if heard else "")
    assert logging.getLogger("toolkit").handlers == before


def test_words_after_a_double_dash_are_not_flags(declare, capsys):
    declare(
        "def run(name: str):\n    '''Echo.'''\n    print(name)\n",
        "run = :run",
        group="toolkit.commands",
    )
    assert run("run", "--", "--quiet") == 0
    assert capsys.readouterr().out == "--quiet\n"


def test_app_with_subcommands_can_be_declared(declare, capsys):
    declare(
        "'''Many things.'''\nimport typer\napp = typer.Typer()\n"
        "@app.command()\ndef one(): print(1)\n@app.command()\ndef two(): print(2)\n",
        "many = :app",
        group="toolkit.commands",
    )
    assert run("many", "two") == 0
    assert capsys.readouterr().out == "2\n"
    assert run("--help") == 0
    assert "Many things." in capsys.readouterr().out


def test_command_that_cannot_be_loaded_is_the_strangers_fault(declare, capsys):
    declare("import nonexistent_package_x", "run = :run", group="toolkit.commands")
    assert run("run") == 2
    assert "command 'run' (throwaway" in capsys.readouterr().err


def test_command_claimed_twice_names_both(declare, capsys):
    declare(RAISE.format("pass"), "run = :run", group="toolkit.commands")
    declare(RAISE.format("pass"), "run = :run", group="toolkit.commands", distribution="rival")
    assert run("run") == 2
    err = capsys.readouterr().err
    assert "shop 1.5" in err
    assert "rival 1.5" in err


def test_own_command_cannot_be_taken_over(declare, capsys):
    declare(RAISE.format("print('stolen')"), "measure = :run", group="toolkit.commands")
    assert run("measure") == 2
    assert "stolen" not in capsys.readouterr().out


def test_reader_that_leaves_early_makes_no_noise():
    code = "import sys; from toolkit.cli.main import main; sys.exit(main(['--help']))"
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, check=False
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full on this system")
def test_full_disk_behind_stdout_is_7():
    code = "import sys; from toolkit.cli.main import main; sys.exit(main(['--help']))"
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 7
    assert done.stderr.startswith("toolkit: No space left")


@pytest.mark.parametrize(("said", "expected"), [(None, "1"), ("3", "3")])
def test_one_thread_works_unless_told(monkeypatch, said, expected):
    monkeypatch.setenv("OMP_NUM_THREADS", said or "")
    if said is None:
        monkeypatch.delenv("OMP_NUM_THREADS")
    main(["--version"])
    assert os.environ["OMP_NUM_THREADS"] == expected
