"""toolkit ball: a sharp picture of a ball in, ball.toml out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from toolkit.errors import ConfigError

if TYPE_CHECKING:
    from toolkit.ball import Disc
    from toolkit.ball_colours import BallColours
    from toolkit.ball_file import BallFile, SharpSource
    from toolkit.types import LinearImage


def ball(
    image: Annotated[
        Path | None, typer.Option(metavar="F", help="A sharp picture of the resting ball.")
    ] = None,
    background: Annotated[
        list[Path] | None,
        typer.Option(metavar="F", help="The same view without the ball; repeat it for several."),
    ] = None,
    response: Annotated[
        str | None,
        typer.Option(metavar="NAME|F", help="linear, srgb, a curve's name, or a response.toml."),
    ] = None,
    radius: Annotated[
        float | None, typer.Option(metavar="METRES", help="The ball's radius.")
    ] = None,
    overlay: Annotated[
        Path | None, typer.Option(metavar="F.png", help="Draw the disc on the picture.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the ball goes.")] = Path(
        "ball.toml"
    ),
) -> None:
    """Find a sharp ball's disc and colours, for estimators that need to know the ball.

    The ball rests in the light in which it will move, and the whole of it is seen.
    """
    image, background = _required(image, background)
    _check_radius(radius)
    curve = Path(response) if response is not None and Path(response).is_file() else None
    _check_outputs(out, overlay, [image, *background, *([curve] if curve else [])])

    from toolkit.ball_colours import learn_colours
    from toolkit.ball_file import SharpSource, write_ball
    from toolkit.disc import view_ball
    from toolkit.imaging import read_background, read_image

    seen = read_image(image, response=response)
    view = view_ball(seen, read_background(background, response=response))
    colours = learn_colours([view])
    disc = view.picture_disc
    if overlay is not None:
        from toolkit.report import write_disc_overlay

        write_disc_overlay(overlay, seen, disc)
    source = SharpSource(
        image=image, background=tuple(background), disc=disc, response=curve or response
    )
    write_ball(out, _as_file(radius, colours, source))
    told = [*_disc_lines(disc, view.clipped), *_colour_lines(colours), *_response_lines(seen)]
    typer.echo("\n".join(told))
    typer.echo(f"wrote {_printable(str(out))}")


def _required(image: Path | None, background: list[Path] | None) -> tuple[Path, list[Path]]:
    if image is None or not background:
        missing = [
            *([] if image else ["a sharp picture of the ball: --image F"]),
            *([] if background else ["the same view without the ball: --background F"]),
        ]
        raise ConfigError(f"the ball cannot be learnt without {'; and '.join(missing)}")
    return image, background


def _check_radius(radius: float | None) -> None:
    if radius is None:
        return
    from toolkit.shot_checks import RADIUS_LIMITS

    if not RADIUS_LIMITS[0] <= radius <= RADIUS_LIMITS[1]:
        span = f"from {RADIUS_LIMITS[0]:g} to {RADIUS_LIMITS[1]:g} m"
        raise ConfigError(f"--radius is {radius:g} m; a number {span} is needed")


def _as_file(radius: float | None, colours: "BallColours", source: "SharpSource") -> "BallFile":
    from toolkit.ball_file import BallFile

    return BallFile(
        radius=radius,
        kind=colours.kind,
        colours=colours.pigments,
        plane_normal=colours.normal,
        plane_normal_std=colours.normal_std,
        sharp=source,
    )


def _check_outputs(out: Path, overlay: Path | None, inputs: Sequence[Path]) -> None:
    """Refuse results that would replace an input or each other, or a format that is not drawn."""
    if overlay is not None and overlay.suffix.lower() != ".png":
        raise ConfigError(f"--overlay is {overlay}; its name must end in .png")
    taken = {path.resolve() for path in inputs}
    for flag, path in (("--out", out), ("--overlay", overlay)):
        if path is None:
            continue
        if path.resolve() in taken:
            raise ConfigError(f"{flag} is {path}, an input; choose another name")
        if not path.absolute().parent.is_dir():
            raise ConfigError(f"{flag} is {path}, but there is no folder {path.parent}; make it")
        taken.add(path.resolve())


def _disc_lines(disc: "Disc", clipped: float) -> list[str]:
    (x, y), (longer, shorter) = disc.centre, disc.semi_axes
    lines = [
        f"disc       centre ({x:.2f}, {y:.2f}) px, semi-axes {longer:.2f} and {shorter:.2f} px, "
        f"outline +/- {disc.std:.3f} px"
    ]
    if clipped > 0:
        lines.append(f"highlight  {clipped:.1%} of the disc met white, and is too dark there")
    return lines


def _colour_lines(colours: "BallColours") -> list[str]:
    lines = [f"mean       {_text(colours.mean)} linear R,G,B, sensor white = 1"]
    if colours.kind == "plane":
        lines += [f"pigment    {_text(pigment)}" for pigment in colours.pigments]
        lines.append(
            f"plane      normal {_text(colours.normal or ())} +/- {colours.normal_std or 0:.4f} rad"
            ": two pigments and their shades"
        )
    elif colours.kind == "line":
        lines.append(
            "line       one colour and its shades, or black and white: two pigments cannot be "
            "told, so use uniform or known-shading, not two-colour"
        )
    else:
        lines.append(
            "solid      more than two colours, or a glossy ball: they lie in no plane, so use "
            "known-shading, not two-colour"
        )
    return [*lines, f"off        {colours.off:.1%} of the pixels are off it (highlights, marks)"]


def _response_lines(image: "LinearImage") -> list[str]:
    if not image.response_is_assumed:
        return []
    return [
        f"caution    the response '{image.response}' is only assumed, and a wrong one shifts the "
        "colours; use RAW, or name it with --response"
    ]


def _text(values: Sequence[float]) -> str:
    return ",".join(f"{value:.4f}" for value in values)


def _printable(text: str) -> str:
    """Keep control characters and undecodable bytes of file names from the terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)
