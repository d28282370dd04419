"""`toolkit response`: bracketed exposures in, response.toml out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli.calibrate import photos_named
from toolkit.cli.terminal import check_outputs, printable, progress
from toolkit.errors import CalibrationError, ConfigError, ToolkitError

if TYPE_CHECKING:
    from calibration.noise_model import MeasuredNoise
    from calibration.response_curve import MeasuredResponse

SCHEMA = "toolkit.response-result/1"


def response(
    images: Annotated[
        list[str] | None,
        typer.Option(
            "--images", metavar="PHOTO...", help="Photos of one still scene, differently exposed."
        ),
    ] = None,
    # a shell expands --images bracket/* to one option and many words: these are the words
    more: Annotated[list[str] | None, typer.Argument(hidden=True, metavar="PHOTO")] = None,
    times: Annotated[
        str | None,
        typer.Option(metavar="T1,T2,..", help="Exposure times in seconds, e.g. 1/60,1/30,1/15."),
    ] = None,
    noise: Annotated[
        bool,
        typer.Option("--noise", help="Measure the noise, from photos alike in all but noise."),
    ] = False,
    curve: Annotated[
        str | None,
        typer.Option(
            "--response", metavar="NAME|F", help="With --noise: the curve of photos not RAW."
        ),
    ] = None,
    names: Annotated[bool, typer.Option("--names", help="List the curves known by name.")] = False,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the response goes.")] = Path(
        "response.toml"
    ),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Recover a camera's response curve, or its noise, from photos of a still scene."""
    if names:
        typer.echo(_names(json))
        return
    paths = photos_named([*(images or []), *(more or [])])
    seconds = parse_times(times)
    if noise:
        _refuse_out_of_place(("--times", times))
        _tell_noise(paths, curve, json)
        return
    _refuse_out_of_place(("--response", curve))
    check_outputs({"--out": out}, paths)
    from calibration.response_curve import measure_response

    try:
        with progress("reading photos", len(paths)) as on_photo:
            result = measure_response(paths, seconds, on_photo=on_photo)
    except ToolkitError as error:
        _report_refusal(error, json)
        raise
    if not result.is_linear:  # a curve would only add its own noise to light that needs none
        _write(out, result)
    typer.echo(_json_text(result, out) if json else _text(result, out))


def parse_times(text: str | None) -> list[float] | None:
    """Read exposure times such as "1/60,0.5,2".

    Raises:
        ConfigError: naming what is no time.
    """
    if text is None:
        return None
    return [_seconds(word.strip()) for word in text.split(",")]


def _seconds(word: str) -> float:
    above, _, below = word.removesuffix("s").strip().partition("/")
    try:
        return float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        raise ConfigError(
            f"--times: '{word}' is no time; give seconds, as in 1/60,1/30,0.5"
        ) from None


def _refuse_out_of_place(*options: tuple[str, str | None]) -> None:
    for name, value in options:
        if value is not None:
            raise ConfigError(f"{name} has no use here; see toolkit response --help")


def _report_refusal(error: ToolkitError, json: bool) -> None:
    if json and isinstance(error, CalibrationError):
        from json import dumps

        typer.echo(dumps({"schema": SCHEMA, "status": "refused", "reason": str(error)}))


def _names(json: bool) -> str:
    from json import dumps

    from toolkit.response import curve_names

    return dumps(curve_names()) if json else "\n".join(curve_names())


def _write(out: Path, result: "MeasuredResponse") -> None:
    from toolkit.response import write_response

    bracket = result.bracket
    write_response(
        out,
        result.curves,
        {
            "images": [path.name for path in bracket.paths],
            "times_s": bracket.times.tolist(),
            "is_raw": bracket.is_raw,
            "time_errors_stops": _known(result.time_errors.tolist()),
            "residual_stops": [channel.residual for channel in result.channels],
            "seen": [list(channel.seen) for channel in result.channels],
        },
    )


def _known(numbers: Sequence[float]) -> list[float]:
    """Give the numbers for a file, 0 where one is not known."""
    return [number if number == number else 0.0 for number in map(float, numbers)]


def _text(result: "MeasuredResponse", out: Path) -> str:
    bracket = result.bracket
    lines = [f"warning: {printable(caution.message)}" for caution in result.warnings]
    lines += [
        f"{len(bracket.paths)} photos from {bracket.times[0]:.4g} to {bracket.times[-1]:.4g} s"
    ]
    for name, channel in zip(("red", "green", "blue"), result.channels, strict=True):
        low, high = channel.seen
        lines.append(
            f"{name:<6} known from brightness {low:.3f} to {high:.3f}, +/- "
            f"{channel.largest_std:.5f} of white at most; exposures agree to "
            f"{channel.residual:.3f} stops rms"
        )
    level = min(channel.linear_up_to for channel in result.channels)
    if bracket.is_raw or level > 0.5:
        lines.append(
            f"proportional to light to {100 * result.bend:.2f} % between a tenth and nine tenths "
            f"of white, and to 1 % up to {level:.2f}"
        )
    if result.is_linear:
        return "\n".join([*lines, "these RAW photos need no response file; none was written"])
    return "\n".join([*lines, f"wrote {printable(str(out))}"])


def _json_text(result: "MeasuredResponse", out: Path) -> str:
    from json import dumps

    from toolkit.plain_data import to_plain

    bracket = result.bracket
    channels = {
        name: {
            "brightness": channel.curve.brightness.tolist(),
            "exposure": channel.curve.exposure.tolist(),
            "std": channel.curve.std.tolist(),
            "seen": list(channel.seen),
            "residual_stops": channel.residual,
            "misfit": channel.misfit,
            "bend": channel.bend,
            "linear_up_to": channel.linear_up_to,
        }
        for name, channel in zip("rgb", result.channels, strict=True)
    }
    table: dict[str, Any] = {
        "schema": SCHEMA,
        "status": "ok",
        "reason": None,
        "out": None if result.is_linear else str(out),
        "images": [str(path) for path in bracket.paths],
        "times_s": bracket.times.tolist(),
        "time_errors_stops": [e if e == e else None for e in result.time_errors.tolist()],
        "is_raw": bracket.is_raw,
        "is_linear": result.is_linear,
        "channels": channels,
        "left_out": [{"path": str(path), "reason": reason} for path, reason in bracket.left_out],
        "warnings": result.warnings,
    }
    return dumps(to_plain(table))


def _tell_noise(paths: Sequence[Path], curve: str | None, json: bool) -> None:
    from calibration.noise_model import measure_noise

    try:
        with progress("reading photos", len(paths)) as on_photo:
            result = measure_noise(paths, response=curve, on_photo=on_photo)
    except ToolkitError as error:
        _report_refusal(error, json)
        raise
    typer.echo(_noise_json(result) if json else _noise_text(result))


def _noise_text(result: "MeasuredNoise") -> str:
    lines = [f"warning: {printable(caution.message)}" for caution in result.warnings]
    lines.append(
        f"{result.photos} photos, light from {result.range[0]:.4f} to {result.range[1]:.4f} of "
        "white; variance = read^2 + gain * light"
    )
    for index, name in enumerate(("red", "green", "blue")):
        read, gain = result.read_std[index], result.gain[index]
        electrons = f", {1 / gain:.0f} electrons at white" if gain > 0 else ""
        lines.append(
            f"{name:<6} read {read:.6f} +/- {result.read_std_error[index]:.6f}, gain {gain:.3e} "
            f"+/- {result.gain_std[index]:.1e}{electrons}"
        )
    return "\n".join(lines)


def _noise_json(result: "MeasuredNoise") -> str:
    from json import dumps

    from toolkit.plain_data import to_plain

    table = {
        "schema": SCHEMA,
        "status": "ok",
        "reason": None,
        "photos": result.photos,
        "range": list(result.range),
        "read_std": list(result.read_std),
        "read_std_error": list(result.read_std_error),
        "gain": list(result.gain),
        "gain_std": list(result.gain_std),
        "warnings": result.warnings,
    }
    return dumps(to_plain(table))
