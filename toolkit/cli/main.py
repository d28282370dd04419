"""The `toolkit` command: runs one command and turns every error into one line and an exit code."""

import errno
import logging
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from toolkit.cli.lazy import LazyGroup
from toolkit.errors import EnvironmentFault, ToolkitError

BUG = 70
USAGE = 2
INTERRUPTED = 130
BROKEN_PIPE = 141  # what a shell reports for SIGPIPE

# what a machine refuses; any other OSError that nobody handled is a bug
MACHINE = {
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.EIO,
    errno.EMFILE,
    errno.ENFILE,
    errno.EBUSY,
    errno.ENOMEM,
}


class Commands(LazyGroup):
    """The toolkit's own commands; every other comes from an entry point."""

    built_in = {  # noqa: RUF012  (declared a ClassVar in the base)
        "measure": "toolkit.cli.measure:measure",
        "ball": "toolkit.cli.ball:ball",
        "simulate": "toolkit.cli.simulate:simulate",
        "plugins": "toolkit.cli.plugins:app",
    }


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    epilog="--debug and --quiet may stand anywhere on the line.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from toolkit.about import installed_version

        typer.echo(f"toolkit {installed_version()}")
        raise typer.Exit


@app.callback()
def toolkit(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show where an error came from.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing but errors.")] = False,
) -> None:
    """Measure a ball's position, direction, speed and path from one motion-blurred picture."""


def main(argv: list[str] | None = None) -> int:
    """Run one command line and give its exit code.

    Args:
        argv: the words after `toolkit`; those of the process when None.

    Returns:
        0 ok, 2 usage, 3 unreadable input, 4 inputs that do not fit, 5 refused, 6 batch with
        failures, 7 environment, 70 a bug, 130 interrupted, 141 the reader of our output left.
    """
    # read when torch is first imported: a streak is too small for more threads to pay, and threads
    # that wait for each other take ten times as long where other programs keep the processors busy
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    flags, words = _split_flags(list(sys.argv[1:] if argv is None else argv))
    debug = "--debug" in flags
    with _logging(quiet="--quiet" in flags):
        try:
            code = _run([*flags, *(words or ["--help"])])
            sys.stdout.flush()  # a full disk or a closed pipe must show before the exit code
            return code
        except BrokenPipeError:
            _drop_stdout()
            return BROKEN_PIPE
        except (Exception, SystemExit, KeyboardInterrupt) as error:
            if debug:
                traceback.print_exc()
            code, text = _explain(error, debug)
            if text:
                print(f"toolkit: {' '.join(text.split())}", file=sys.stderr)
            return code


def _run(words: list[str]) -> int:
    command = typer.main.get_command(app)
    try:
        with command.make_context("toolkit", words) as context:
            code = command.invoke(context)
    except typer.Exit as done:
        code = done.exit_code
    return code if isinstance(code, int) else 0


def _explain(error: BaseException, debug: bool) -> tuple[int, str]:
    """Give an error's exit code and its line."""
    if isinstance(error, KeyboardInterrupt | EOFError | typer.Abort):
        return INTERRUPTED, "interrupted"
    if isinstance(error, typer.TyperException):
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "toolkit"
        return USAGE, f"{error.format_message().rstrip('.')}; see {command} --help"
    if isinstance(error, ToolkitError) and error.exit_code != BUG:
        return error.exit_code, str(error)
    if isinstance(error, MemoryError):
        return (
            EnvironmentFault.exit_code,
            "not enough memory; close other programs or crop the shot",
        )
    if isinstance(error, OSError) and error.errno in MACHINE:
        place = f"{error.filename}: " if error.filename else ""
        reason = f"{place}{error.strerror}; make room, or choose another place"
        return EnvironmentFault.exit_code, reason
    advice = "please report it with the lines above" if debug else "run with --debug to see where"
    return BUG, f"bug: {type(error).__name__}: {error}; {advice}"


def _split_flags(words: list[str]) -> tuple[list[str], list[str]]:
    """Take --debug and --quiet out, so that they may stand anywhere before a `--`."""
    end = words.index("--") if "--" in words else len(words)
    flags = [word for word in words[:end] if word in ("--debug", "--quiet")]
    return flags, [*(word for word in words[:end] if word not in flags), *words[end:]]


@contextmanager
def _logging(quiet: bool) -> Iterator[None]:
    """Send the toolkit's log to stderr while a command runs."""
    logger = logging.getLogger("toolkit")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("toolkit: %(levelname)s: %(message)s"))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.ERROR if quiet else logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def _drop_stdout() -> None:
    """Send what is still buffered nowhere; Python would complain about the pipe at exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
