"""Lead from photos of a board to a rig with which `toolkit measure SHOT` alone is enough."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from toolkit.cli.terminal import is_quiet, printable, progress
from toolkit.errors import CalibrationError, ConfigError, ToolkitError

if TYPE_CHECKING:
    from collections.abc import Callable

    from calibration.wizard.desk import Desk, Outcome
    from calibration.wizard.run import Step

SCHEMA = "toolkit.wizard-run/1"
REFUSED = CalibrationError.exit_code
EITHER = (("images", "camera"), ("bracket", "response"))
"""Answers of which one takes the place of the other."""
MANY = ("--images", "--bracket", "--background", "--ball-image")
"""Options after which a shell's expanded pattern may stand: --images chess/*.jpg."""


def spread(words: Sequence[str]) -> list[str]:
    """Repeat an option before each of the words that a shell made of its pattern.

    Example:
        >>> spread(["--images", "a.jpg", "b.jpg", "--json"])
        ['--images', 'a.jpg', '--images', 'b.jpg', '--json']
    """
    out: list[str] = []
    option, is_first = "", False
    for word in words:
        if word.startswith("-"):
            option, is_first = word if word in MANY else "", True
        elif option and not is_first:
            out.append(option)
        out.append(word)
        is_first = word.startswith("-")
    return out


class ManyWords(TyperCommand):
    """A command whose options of many pictures take what a shell makes of a pattern."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the words of the command line."""
        return super().parse_args(ctx, spread(args))


app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command("wizard", cls=ManyWords)
def wizard(
    folder: Annotated[
        Path, typer.Option(metavar="DIR", help="Where rig.toml and all that is made go.")
    ] = Path(),
    make_board: Annotated[
        bool | None,
        typer.Option("--make-board/--no-make-board", help="Write a board to print."),
    ] = None,
    kind: Annotated[
        str | None, typer.Option(metavar="KIND", help="Of the board: checker or charuco.")
    ] = None,
    paper: Annotated[
        str | None, typer.Option(metavar="NAME", help="For the board: a4, letter or a3.")
    ] = None,
    images: Annotated[
        list[str] | None,
        typer.Option(metavar="PHOTO...", help="Photos of the board, or their folder."),
    ] = None,
    camera: Annotated[
        str | None, typer.Option(metavar="F", help="A camera.toml instead of photos.")
    ] = None,
    board: Annotated[
        str | None, typer.Option(metavar="CxR", help="Inner corners; found when not given.")
    ] = None,
    square: Annotated[
        str | None, typer.Option(metavar="M", help="Side of a square; not needed.")
    ] = None,
    model: Annotated[
        str | None, typer.Option(metavar="NAME", help="auto, pinhole, rational or fisheye.")
    ] = None,
    response: Annotated[
        str | None,
        typer.Option(metavar="NAME|F|unknown", help="linear, srgb, a curve, a response.toml."),
    ] = None,
    bracket: Annotated[
        list[str] | None,
        typer.Option(metavar="PHOTO...", help="Measure the response from such photos."),
    ] = None,
    times: Annotated[
        str | None, typer.Option(metavar="T1,T2,..", help="Their exposure times in seconds.")
    ] = None,
    background: Annotated[
        list[str] | None,
        typer.Option(metavar="F...", help="Pictures of the scene without the ball."),
    ] = None,
    exposure: Annotated[
        str | None, typer.Option(metavar="SECONDS", help="Where the files do not tell it: 1/100.")
    ] = None,
    readout: Annotated[
        str | None, typer.Option(metavar="SECONDS", help="Of a rolling shutter, first row to last.")
    ] = None,
    radius: Annotated[
        str | None, typer.Option(metavar="METRES", help="The ball's radius: 0.036 or '36 mm'.")
    ] = None,
    radius_std: Annotated[
        str | None, typer.Option(metavar="METRES", help="Its standard deviation.")
    ] = None,
    ball_image: Annotated[
        list[str] | None,
        typer.Option(metavar="F...", help="Sharp pictures of the resting ball, or none."),
    ] = None,
    kind_of_ball: Annotated[
        str | None, typer.Option(metavar="KIND", help="plain, shaded, two-colour or unsure.")
    ] = None,
    shot: Annotated[
        str | None, typer.Option(metavar="F", help="A shot to try the rig on, or none.")
    ] = None,
    accept: Annotated[
        bool, typer.Option("--accept", help="Go on with a camera that has cautions.")
    ] = False,
    redo: Annotated[
        list[str] | None,
        typer.Option(metavar="STEP", help="Answer a step anew; repeat it for several."),
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace files that the wizard did not write.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Lead from photos of a board to a rig with which `toolkit measure SHOT` alone is enough.

    Asks for what no option says. What is done is kept, in wizard.toml: the next run goes on where
    this one stopped, and does again only what changed. Without a terminal nothing is asked.
    """
    given = _given(
        make_board=() if make_board is None else ("yes" if make_board else "no",),
        board_kind=_word(kind),
        paper=_word(paper),
        images=tuple(images or ()),
        camera=_word(camera),
        board=_word(board),
        square=_word(square),
        model=_word(model),
        response=_word(response),
        bracket=tuple(bracket or ()),
        times=_word(times),
        background=tuple(background or ()),
        exposure=_word(exposure),
        readout=_word(readout),
        radius=_word(radius),
        radius_std=_word(radius_std),
        ball_image=tuple(ball_image or ()),
        kind_of_ball=_word(kind_of_ball),
        shot=_word(shot),
    )
    desk = _desk(folder, given, redo or (), json)
    desk.may_replace, desk.takes_doubtful = replace, accept
    from calibration.wizard.run import run_wizard

    outcomes: dict[str, Outcome] = {}
    show = _shower(json)

    def on_outcome(step: "Step", outcome: "Outcome") -> None:
        outcomes[step.name] = outcome
        show(step, outcome)

    try:
        run_wizard(desk, on_outcome=on_outcome)
    except (KeyboardInterrupt, typer.Abort):
        _tell_how_to_go_on(desk)
        raise
    except ToolkitError as error:
        if json and error.exit_code == REFUSED:
            typer.echo(_json_text(desk, outcomes, str(error)))
        raise
    if json:
        typer.echo(_json_text(desk, outcomes))
    else:
        where = "this folder" if folder == Path() else printable(str(folder))
        typer.echo(f"next: toolkit measure SHOT, for a shot in {where}")


def _word(text: str | None) -> tuple[str, ...]:
    return () if text is None else (text,)


def _given(**words: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Keep the answers that flags gave."""
    given = {name: answer for name, answer in words.items() if answer}
    for one, other in EITHER:
        if one in given and other in given:
            raise ConfigError(f"--{one} and --{other} are both given; choose one")
    return given


def _desk(
    folder: Path, given: dict[str, tuple[str, ...]], redo: Sequence[str], json: bool
) -> "Desk":
    from calibration.wizard.desk import Desk
    from calibration.wizard.memory import read_memory
    from calibration.wizard.questions import Asker, Terminal
    from calibration.wizard.run import NAMES, STEPS

    if not folder.is_dir():
        raise ConfigError(f"--folder {folder} is no folder; make it, or choose another")
    unknown = [name for name in redo if name not in NAMES]
    if unknown:
        raise ConfigError(f"--redo {unknown[0]} is no step; there are {', '.join(NAMES)}")
    memory = read_memory(folder, NAMES)
    answers = dict(memory.answers)
    for pair in EITHER:
        for one, other in (pair, pair[::-1]):
            if one in given:
                answers.pop(other, None)
    asker = Asker(
        folder=folder,
        given=given,
        answers=answers,
        person=Terminal() if _is_terminal() else None,
    )
    for step in STEPS:
        if step.name in redo:
            memory.forget(step.name)
            asker.refuse(*(q.name for q in step.asks if q.name not in given))
    return Desk(
        folder=folder,
        asker=asker,
        memory=memory,
        progress=progress,
        tell=_teller(json),
    )


def _is_terminal() -> bool:
    """Whether questions can be read and answered; stdout may go elsewhere."""
    import sys

    return sys.stdin.isatty() and sys.stderr.isatty()


def _teller(json: bool) -> "Callable[[str], None]":
    """Show headings and advice to a person; nobody else needs them."""
    if not _is_terminal() or is_quiet():
        return lambda text: None

    return lambda text: typer.echo(printable(text), err=json)


def _shower(json: bool) -> "Callable[[Step, Outcome], None]":
    """Show how a step ended; with --json on stderr, and only to a person."""
    if json and (not _is_terminal() or is_quiet()):
        return lambda step, outcome: None

    def show(step: "Step", outcome: "Outcome") -> None:
        note = "  (done before, unchanged)" if outcome.status == "kept" else ""
        lines = outcome.told or ("nothing to do",)
        texts = [printable(line) for line in lines]
        typer.echo(f"{step.name}: {texts[0]}{note}", err=json)
        for text in texts[1:]:
            typer.echo(f"  {text}", err=json)

    return show


def _tell_how_to_go_on(desk: "Desk") -> None:

    done = ", ".join(desk.memory.steps) or "nothing yet"
    where = "" if desk.folder == Path() else f" --folder {desk.folder}"
    typer.echo(f"\nkept: {done}; `toolkit wizard{printable(where)}` goes on from here", err=True)


def _json_text(desk: "Desk", outcomes: "dict[str, Outcome]", reason: str | None = None) -> str:
    from json import dumps

    from calibration.wizard.rig_step import rig_path

    table: dict[str, Any] = {
        "schema": SCHEMA,
        "status": "ok" if reason is None else "refused",
        "reason": reason,
        "rig": str(rig_path(desk)) if "rig" in outcomes else None,
        "steps": [
            {"name": name, "status": outcome.status, "told": list(outcome.told)}
            for name, outcome in outcomes.items()
        ],
    }
    return dumps(table)
