"""`toolkit board`: a printable target at true scale."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from toolkit.cli.terminal import check_ending, check_outputs
from toolkit.errors import ConfigError

SCHEMA = "toolkit.board/1"
Kind = Literal["checker", "charuco"]
Paper = Literal["a4", "letter", "a3"]


def board(
    out: Annotated[Path, typer.Option(metavar="F.pdf", help="Where the page goes.")] = Path(
        "board.pdf"
    ),
    kind: Annotated[
        Kind, typer.Option(help="charuco has markers: a part of it in view is enough.")
    ] = "checker",
    size: Annotated[
        str | None,
        typer.Option(
            metavar="CxR",
            help="Inner corners of a checkerboard, 9x6; squares of a ChArUco board, 7x5.",
        ),
    ] = None,
    square: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a square in metres; the largest that fits."),
    ] = None,
    marker: Annotated[
        float | None, typer.Option(metavar="M", help="Side of a marker in metres, of a ChArUco.")
    ] = None,
    dictionary: Annotated[
        str | None, typer.Option(metavar="NAME", help="Of the markers, such as DICT_5X5_250.")
    ] = None,
    paper: Annotated[Paper, typer.Option(help="The paper it is printed on.")] = "a4",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a calibration board as a PDF at true scale, with a ruler to check the print."""
    check_ending("--out", out, ".pdf")
    check_outputs({"--out": out}, [])
    from calibration.board import Board, BoardRequest
    from calibration.board_page import command, write_board
    from calibration.cli.calibrate import parse_board

    request = BoardRequest(
        kind="charuco" if kind == "charuco" else None if marker or dictionary else kind,
        size=parse_board(size) or ((7, 5) if kind == "charuco" else (9, 6)),
        square_m=square,
        marker_m=marker,
        dictionary=dictionary,
    )
    if request.kind != kind:
        raise ConfigError("--marker and --dictionary belong to --kind charuco; add it")
    columns, rows = request.size or (9, 6)
    less = 1 if kind == "charuco" else 0
    wanted = Board(
        kind=kind,
        columns=columns - less,
        rows=rows - less,
        square_m=square,
        marker_m=marker,
        dictionary=dictionary,
    )
    made = write_board(out, wanted, paper=paper)
    if json:
        from json import dumps

        table = {"schema": SCHEMA, "out": str(out), "kind": kind, "size": [columns, rows]}
        lengths = {"square_m": made.square_m, "marker_m": made.marker_m}
        typer.echo(dumps(table | lengths | {"dictionary": made.dictionary, "paper": paper}))
        return
    typer.echo(f"wrote {out}: {made}, squares of {1000 * (made.square_m or 0):g} mm, on {paper}")
    typer.echo("print it at 100 %, check the 100 mm bar, glue it flat, take 10 to 20 photos; then:")
    typer.echo(command(made))
