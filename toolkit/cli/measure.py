"""toolkit measure: one shot in, one measurement out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from toolkit.cli.terminal import check_ending, check_outputs
from toolkit.errors import BadOutputError, CalibrationError, StreakError
from toolkit.option_text import parse_colours, parse_option, parse_settings

if TYPE_CHECKING:
    from toolkit.measurement import Measurement

Stage = Literal["profiles", "contours", "sweep"]


def measure(
    shot: Annotated[Path, typer.Argument(metavar="SHOT", help="The picture with the streak.")],
    rig: Annotated[
        Path | None,
        typer.Option(metavar="F", help="rig.toml; the one in the shot's folder is used by itself."),
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="F", help="camera.toml; by default beside the shot.")
    ] = None,
    background: Annotated[
        list[Path] | None,
        typer.Option(metavar="F", help="A picture without the ball; repeat it for several."),
    ] = None,
    radius: Annotated[
        float | None, typer.Option(metavar="METRES", help="The ball's radius.")
    ] = None,
    radius_std: Annotated[
        float | None, typer.Option(metavar="METRES", help="Its standard deviation.")
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="The exposure time; by default the file's own."),
    ] = None,
    readout: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="From the start of the first row to that of the last row [0]."
        ),
    ] = None,
    response: Annotated[
        str | None,
        typer.Option(metavar="NAME|F", help="linear, srgb, a curve's name, or a response.toml."),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|auto", help="How the ball is told from its background [uniform]."
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="FIELD=VALUE", help="An option of the estimator; repeatable."
        ),
    ] = None,
    ball_colour: Annotated[
        list[str] | None,
        typer.Option(
            metavar="R,G,B", help="The ball's linear colour, sensor white = 1; twice for two."
        ),
    ] = None,
    ball: Annotated[
        Path | None, typer.Option(metavar="F", help="ball.toml, as `toolkit ball` writes it.")
    ] = None,
    ball_image: Annotated[
        Path | None,
        typer.Option(
            metavar="F",
            help="A sharp picture of the ball in the same light, over the same background.",
        ),
    ] = None,
    roi: Annotated[
        str | None,
        typer.Option(metavar="X,Y,W,H", help="The part of the picture that holds the streak, px."),
    ] = None,
    frame: Annotated[
        int | None, typer.Option(metavar="N", help="Which picture of a video, from 0.")
    ] = None,
    stage: Annotated[
        Stage | None, typer.Option(help="Where to stop; the last one is the most accurate.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="F.json", help="Write the measurement here.")
    ] = None,
    overlay: Annotated[
        Path | None, typer.Option(metavar="F.png", help="Draw what was found on the shot.")
    ] = None,
    residuals: Annotated[
        Path | None,
        typer.Option(metavar="F.png", help="Draw what the exact streak leaves unexplained."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Measure the ball of one shot: position, direction, speed and path, each with its uncertainty.

    What is said here beats the rig, and the rig beats what the shot's file tells. Without an
    exposure time position and direction are measured, but no speed.
    """
    check_ending("--overlay", overlay, ".png")
    check_ending("--residuals", residuals, ".png")
    results = {"--out": out, "--overlay": overlay, "--residuals": residuals}
    check_outputs(results, [shot])
    options = parse_settings(set_ or [])
    colours = parse_colours(ball_colour or [])
    corner_and_size = _roi(roi)

    from toolkit.measurement import Measurement
    from toolkit.report import summarise, write_overlay, write_residuals
    from toolkit.shot import DEFAULT_STAGE, load_shot, measure_shot, refuse_shot

    try:
        loaded = load_shot(
            shot,
            rig=rig,
            camera=camera,
            background=background or (),
            ball_radius=radius,
            ball_radius_std=radius_std,
            exposure=exposure,
            readout=readout,
            response=response,
            estimator=estimator,
            options=options,
            ball_colours=colours,
            ball=ball,
            ball_image=ball_image,
            roi=corner_and_size,
            frame=frame,
            stage=stage or DEFAULT_STAGE,
        )
    except CalibrationError as error:
        # no file yet: which ones were read, and must not be replaced, is not known
        _hand_out(Measurement.refused(str(error)), None, json)
        raise
    check_outputs(results, loaded.files)
    try:
        measurement = measure_shot(loaded)
    except (StreakError, BadOutputError) as error:
        _hand_out(refuse_shot(loaded, str(error)), out, json)
        raise
    if overlay is not None:
        write_overlay(overlay, loaded.image, measurement)
    _hand_out(measurement, out, json)
    if not json:
        typer.echo(summarise(measurement))
    if residuals is not None:  # last, since there may be none where contours stood in
        write_residuals(residuals, loaded.image, measurement)


def _hand_out(measurement: "Measurement", out: Path | None, json: bool) -> None:
    from toolkit.files import write_text

    text = measurement.to_json()
    if out is not None:
        write_text(out, text + "\n")
    if json:
        typer.echo(text)


def _roi(text: str | None) -> tuple[int, int, int, int] | None:
    return None if text is None else parse_option(text, tuple[int, int, int, int], "--roi")
