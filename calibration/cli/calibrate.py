"""`toolkit calibrate`: photos of a board in, camera.toml out."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from toolkit.cli.terminal import check_ending, check_outputs, expand, printable, progress
from toolkit.errors import CalibrationError, ConfigError, ToolkitError

if TYPE_CHECKING:
    from calibration.corners import BoardSearch, View
    from calibration.intrinsics import Calibration
    from toolkit.response import Response

SCHEMA = "toolkit.calibration/1"


def calibrate(
    images: Annotated[
        list[str] | None,
        typer.Option("--images", metavar="PHOTO...", help="Photos of a board."),
    ] = None,
    # a shell expands --images chess/*.jpg to one option and many words: these are the words
    more: Annotated[list[str] | None, typer.Argument(hidden=True, metavar="PHOTO")] = None,
    board: Annotated[
        str | None,
        typer.Option(
            metavar="CxR",
            help="Inner corners, 9x6, or squares of a ChArUco board, 5x7; found when not given.",
        ),
    ] = None,
    kind: Annotated[
        Literal["checker", "charuco"] | None, typer.Option(help="Found when not given.")
    ] = None,
    dictionary: Annotated[
        str | None, typer.Option(metavar="NAME", help="Of a ChArUco board's markers: DICT_6X6_250.")
    ] = None,
    marker: Annotated[
        float | None, typer.Option(metavar="M", help="Side of a marker in metres, to check it.")
    ] = None,
    square: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a square in metres, for the poses only."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the camera goes.")] = Path(
        "camera.toml"
    ),
    model: Annotated[
        Literal["auto", "pinhole", "rational", "fisheye"],
        typer.Option(help="Lenses to compare; auto tries them all."),
    ] = "auto",
    bootstrap: Annotated[
        int, typer.Option(metavar="N", help="Draw the views N times to check the uncertainty.")
    ] = 0,
    report: Annotated[
        Path | None, typer.Option(metavar="F.html", help="Write a page that shows how good it is.")
    ] = None,
    response: Annotated[
        str | None, typer.Option(metavar="NAME|F", help="A response curve for that page.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Calibrate a camera from photos of a checkerboard or a ChArUco board."""
    paths = photos_named([*(images or []), *(more or [])])
    size = parse_board(board)
    check_outputs({"--out": out, "--report": report}, paths)
    curve = _curve_of(report, response)
    from calibration.board import BoardRequest
    from calibration.corners import search_boards
    from calibration.intrinsics import calibrate_views, check_request, write_calibration

    check_request(paths, size, square, model, bootstrap)
    request = BoardRequest(
        kind=kind, size=size, square_m=square, marker_m=marker, dictionary=dictionary
    )
    with progress("reading photos", len(paths)) as on_photo:
        found = search_boards(paths, board=request, on_photo=on_photo)
    try:
        result = calibrate_views(
            found.views, square=square, model=model, bootstrap=bootstrap, cautions=found.cautions
        )
    except ToolkitError as error:
        _report_failure(found, error, json)
        raise
    write_calibration(out, result)
    if report is not None:
        from calibration.report.collect import write_report

        write_report(report, result, square=square, response=curve)
    typer.echo((_json_text if json else _text)(found, result, out, square))
    if report is not None and not json:
        typer.echo(f"wrote {printable(str(report))}, to look at in a browser")


def photos_named(words: Sequence[str]) -> list[Path]:
    """Give the photos that words name.

    Raises:
        ConfigError: when there is no word, or a pattern matches nothing.
    """
    if not words:
        raise ConfigError("no photos were given; use --images chess/*.jpg")
    return expand("--images", words)


def _curve_of(report: Path | None, response: str | None) -> "Response | None":
    """Give the response that the page is to show, before the work."""
    check_ending("--report", report, ".html", ".htm")
    if response is None:
        return None
    if report is None:
        raise ConfigError("--response is drawn on the report's page; add --report F.html")
    from toolkit.response import load_response

    return load_response(response)


def parse_board(text: str | None) -> tuple[int, int] | None:
    """Read a board size such as "9x6".

    Raises:
        ConfigError: when it is not two numbers from 3 to 99 with an x between them.
    """
    if text is None:
        return None
    match = re.fullmatch(r"\s*(\d{1,2})\s*[xX×]\s*(\d{1,2})\s*", text, re.ASCII)
    if match is None or min(map(int, match.groups())) < 3:
        raise ConfigError(f"--board '{text}' is no size; count inner corners, as in 9x6, 3x3 least")
    columns, rows = map(int, match.groups())
    return columns, rows


def _report_failure(found: "BoardSearch", error: ToolkitError, json: bool) -> None:
    """Log the failed photos that the error does not name; print a refusal as JSON where asked."""
    import logging

    from calibration.intrinsics import MOST_NAMED, reasons

    views = found.views
    for caution in found.cautions:
        logging.getLogger("toolkit").warning("%s", caution.message)
    failed = [view for view in views if not view.is_used]
    for view in failed[MOST_NAMED if reasons(views) in str(error) else 0 :]:
        logging.getLogger("toolkit").warning("%s", _line(view))
    if json and isinstance(error, CalibrationError):
        from json import dumps

        refusal = {"schema": SCHEMA, "status": "refused", "reason": str(error)}
        typer.echo(dumps(refusal | {"views": [_plain_view(view) for view in views]}))


def _line(view: "View") -> str:
    """Describe a view in one line."""
    name, reason = printable(str(view.path)), printable(view.reason)
    if view.is_used:
        return f"{name}: {view.corner_count} corners, {view.rms_px:.2f} px"
    return f"left out: {reason}" if reason.startswith(name) else f"{name}: left out: {reason}"


def _text(found: "BoardSearch", result: "Calibration", out: Path, square: float | None) -> str:
    from calibration.plain_trust import trust_lines

    camera = result.camera
    std = _std(result)
    numbers = ", ".join(
        f"{name} {getattr(camera, name):.2f} +/- {std[name]:.2f}"
        for name in ("fx", "fy", "cx", "cy")
    )
    return "\n".join(
        [
            *(_line(view) for view in result.views),
            *(f"warning: {caution.message}" for caution in result.warnings),
            f"{_board_text(found)}, {len(result.used)} of {len(result.views)}"
            f" photos used, RMS {result.rms_px:.2f} px",
            f"{numbers} px; {len(camera.distortion)} distortion coefficients",
            *trust_lines(result, square),
            f"wrote {printable(str(out))}",
        ]
    )


def _board_text(found: "BoardSearch") -> str:
    board = found.board
    if board is not None and board.kind == "charuco":
        return str(board)
    return f"board {board.columns}x{board.rows}" if board else "board"


def _std(result: "Calibration") -> dict[str, float]:
    assert result.camera.covariance is not None  # a calibrated camera has one
    values = result.camera.covariance.diagonal().sqrt().tolist()
    return dict(zip(("fx", "fy", "cx", "cy"), values, strict=False))


def _json_text(found: "BoardSearch", result: "Calibration", out: Path, square: float | None) -> str:
    from json import dumps

    from calibration.plain_trust import plain_trust
    from toolkit.plain_data import to_plain

    camera = result.camera
    assert camera.covariance is not None  # a calibrated camera has one
    names = ("width", "height", "model", "fx", "fy", "cx", "cy", "distortion")
    table: dict[str, Any] = {
        "schema": SCHEMA,
        "status": "ok",
        "reason": None,
        "out": str(out),
        "board": result.board,
        "board_kind": found.board.kind if found.board else None,
        "dictionary": found.board.dictionary if found.board else None,
        "rms_px": result.rms_px,
        "camera": {name: getattr(camera, name) for name in names}
        | {"covariance": camera.covariance.tolist()},
        "std": _std(result),
        **plain_trust(result),
        "residuals": _residuals(result, square),
        "pose_unit": "square" if square is None else "metre",
        "views": [_plain_view(view) for view in result.views],
        "warnings": result.warnings,
    }
    return dumps(to_plain(table))


def _residuals(result: "Calibration", square: float | None) -> dict[str, Any]:
    """Every corner used, and found less predicted, both to a thousandth of a pixel."""
    from calibration.report.collect import corner_errors

    places, errors = corner_errors(result, square=square)
    return {"place_px": places.round(3).tolist(), "error_px": errors.round(3).tolist()}


def _plain_view(view: "View") -> dict[str, Any]:
    return {
        "path": str(view.path),
        "status": "used" if view.is_used else "left out",
        "reason": view.reason or None,
        "corners": view.corner_count,
        "edge_px": view.edge_px,
        "clipped_share": view.clipped_share,
        "rms_px": view.rms_px,
        "T_cam_board": None if view.T_cam_board is None else view.T_cam_board.tolist(),
    }
