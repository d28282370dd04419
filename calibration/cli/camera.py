"""Bring a camera over from another program's file, or write one for it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from toolkit.cli.lazy import LazyGroup
from toolkit.cli.terminal import check_outputs, printable
from toolkit.errors import ConfigError

if TYPE_CHECKING:
    from toolkit.camera import Camera

SCHEMA = "toolkit.camera-conversion/1"
FORMATS = "opencv|ros|kalibr|colmap"

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


class CameraCommands(LazyGroup):
    """The commands about camera files."""

    built_in = {  # noqa: RUF012  (declared a ClassVar in the base)
        "import": "calibration.cli.camera:import_",
        "export": "calibration.cli.camera:export",
    }
    entry_points = None


app = typer.Typer(cls=CameraCommands, add_completion=False, rich_markup_mode=None)


@app.callback()
def camera() -> None:
    """Bring a camera over from another program's file, or write one for it."""


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The other program's file.")],
    format: Annotated[
        str, typer.Option(metavar=f"auto|{FORMATS}", help="Told by the contents when not given.")
    ] = "auto",
    camera: Annotated[
        str | None,
        typer.Option(metavar="N|NAME", help="Which one, of a file that holds several."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the camera goes.")] = Path(
        "camera.toml"
    ),
    json: Json = False,
) -> None:
    """Make a camera.toml of OpenCV's, ROS's, Kalibr's or COLMAP's camera file."""
    check_outputs({"--out": out}, [file])
    from calibration.formats.convert import import_camera
    from toolkit.camera_file import write_camera

    found = import_camera(file, format=format, name=camera)
    write_camera(out, found.camera, rms_px=found.rms_px)
    cautions = found.cautions
    if json:
        _print_json(found.camera, found.format, out, cautions, {"name": found.name})
        return
    typer.echo(f"{found.format} camera '{printable(found.name)}': {_describe(found.camera)}")
    _finish(cautions, out)


def export(
    file: Annotated[Path, typer.Argument(metavar="camera.toml", help="The camera.")],
    format: Annotated[str | None, typer.Option(metavar=FORMATS, help="For which program.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Its ending tells YAML, XML or JSON for opencv."),
    ] = None,
    json: Json = False,
) -> None:
    """Write a camera.toml for OpenCV, ROS, Kalibr or COLMAP."""
    if format is None or out is None:
        missing = [*([] if format else [f"--format {FORMATS}"]), *([] if out else ["--out FILE"])]
        raise ConfigError(f"the camera cannot be written without {' and '.join(missing)}")
    check_outputs({"--out": out}, [file])
    from calibration.formats.convert import export_camera
    from toolkit.camera_file import read_camera

    camera = read_camera(file)
    cautions = export_camera(camera, out, format=format)
    if json:
        _print_json(camera, format, out, cautions, {})
        return
    typer.echo(f"camera for {format}: {_describe(camera)}")
    _finish(cautions, out)


def _describe(camera: "Camera") -> str:
    return (
        f"{camera.width}x{camera.height} px, {camera.model}, fx {camera.fx:.2f}, fy "
        f"{camera.fy:.2f}, cx {camera.cx:.2f}, cy {camera.cy:.2f} px, {len(camera.distortion)} "
        "distortion coefficients"
    )


def _finish(cautions: tuple[str, ...], out: Path) -> None:
    for caution in cautions:
        typer.echo(f"caution: {caution}")
    typer.echo(f"wrote {printable(str(out))}")


def _print_json(
    camera: "Camera", format: str, out: Path, cautions: tuple[str, ...], more: dict[str, Any]
) -> None:
    from json import dumps

    names = ("width", "height", "model", "fx", "fy", "cx", "cy", "distortion")
    table = {"schema": SCHEMA, "status": "ok", "format": format, "out": str(out), **more}
    table |= {"camera": {name: getattr(camera, name) for name in names}}
    typer.echo(dumps({**table, "cautions": cautions}, allow_nan=False))
