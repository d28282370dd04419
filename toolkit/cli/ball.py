"""toolkit ball: sharp pictures of a ball in, ball.toml out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from toolkit.cli.terminal import check_ending, check_outputs, expand, printable, progress
from toolkit.errors import CalibrationError, ConfigError

if TYPE_CHECKING:
    from toolkit.ball import Disc
    from toolkit.ball_colours import BallColours
    from toolkit.learn_ball import LearntBall, Picture

SCHEMA = "toolkit.learnt-ball/1"


def ball(
    image: Annotated[
        list[str] | None,
        typer.Option(
            metavar="F",
            help="A sharp picture of the resting ball; repeat it for several, or quote a pattern.",
        ),
    ] = None,
    background: Annotated[
        list[str] | None,
        typer.Option(
            metavar="F",
            help="The same view without the ball: one for each picture, or any number for all.",
        ),
    ] = None,
    # what a shell makes of --image sharp/*.png: nobody could tell pictures from backgrounds
    more: Annotated[list[str] | None, typer.Argument(hidden=True, metavar="F")] = None,
    response: Annotated[
        str | None,
        typer.Option(metavar="NAME|F", help="linear, srgb, a curve's name, or a response.toml."),
    ] = None,
    radius: Annotated[
        float | None, typer.Option(metavar="METRES", help="The ball's radius.")
    ] = None,
    radius_std: Annotated[
        float | None, typer.Option(metavar="METRES", help="Its standard deviation.")
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(metavar="F", help="A camera.toml: sizes then tell radius or distance."),
    ] = None,
    distance: Annotated[
        list[float] | None,
        typer.Option(
            metavar="METRES",
            help="From the camera to the ball's centre: once for all pictures, or once for each.",
        ),
    ] = None,
    distance_std: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Its standard deviation; 0.01 when not given."),
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(metavar="F.png", help="Draw the disc on the picture that stands for all."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the ball goes.")] = Path(
        "ball.toml"
    ),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find a sharp ball's size, colours and light, for estimators that need to know the ball.

    The ball rests in the light in which it will move, and the whole of it is seen.
    """
    pictures, empty = _required(image, background, more)
    curve = Path(response) if response is not None and Path(response).is_file() else None
    inputs = [*pictures, *empty, *(path for path in (curve, camera) if path)]
    check_ending("--overlay", overlay, ".png")
    check_outputs({"--out": out, "--overlay": overlay}, inputs)

    from toolkit.ball_file import write_ball
    from toolkit.learn_ball import Told, learn_ball

    told = Told(
        radius=radius,
        radius_std=radius_std,
        distances=tuple(distance or ()),
        distance_std=distance_std,
    )
    try:
        with progress("looking at pictures", len(pictures)) as on_picture:
            learnt = learn_ball(
                pictures,
                empty,
                told=told,
                camera=camera,
                response=curve or response,
                on_picture=on_picture,
            )
    except CalibrationError as error:
        if json:
            _print_json({"schema": SCHEMA, "status": "refused", "reason": str(error)})
        raise
    if overlay is not None:
        from toolkit.report import write_disc_overlay

        write_disc_overlay(overlay, learnt.reference.image, learnt.reference.disc)
    write_ball(out, learnt.file)
    if json:
        _print_json(_plain(learnt, out))
        return
    for line in _lines(learnt):
        typer.echo(printable(line))
    typer.echo(f"wrote {printable(str(out))}")


def _required(
    image: list[str] | None, background: list[str] | None, more: list[str] | None
) -> tuple[list[Path], list[Path]]:
    if more:
        raise ConfigError(
            f"'{more[0]}' stands without a flag; name each picture by an --image of its own, or "
            "put a pattern in quotes: --image 'sharp/*.png'"
        )
    if not image or not background:
        missing = [
            *([] if image else ["a sharp picture of the ball: --image F"]),
            *([] if background else ["the same view without the ball: --background F"]),
        ]
        raise ConfigError(f"the ball cannot be learnt without {'; and '.join(missing)}")
    return expand("--image", image), expand("--background", background)


def _lines(learnt: "LearntBall") -> list[str]:
    """Say what was learnt, line by line."""
    is_alone = len(learnt.pictures) + len(learnt.left_out) == 1
    found: list[str] = []
    for picture in learnt.pictures:
        if not is_alone:
            found.append(f"picture    {picture.path}")
        found += [*_disc_lines(picture.disc, picture.view.clipped), *_size_lines(learnt, picture)]
    left_out = [
        f"left out   {one.path}, of {one.of}: {one.reason}"
        if one.of != "all"
        else f"left out   {one.path}: {one.reason.removeprefix(f'{one.path}: ')}"
        for one in learnt.left_out
    ]
    shading = [] if is_alone else [_shading_line(learnt)]
    cautions = [f"caution    {caution}" for caution in learnt.cautions]
    colours = _colour_lines(learnt.together.colours, learnt.together.std)
    return [*found, *_radius_lines(learnt), *colours, *shading, *left_out, *cautions]


def _shading_line(learnt: "LearntBall") -> str:
    count = len(learnt.light.alike)
    if count == 1:
        return f"shading    by {learnt.reference.path} alone"
    return (
        f"shading    mean of {count} pictures, +/- {learnt.light.std:.2%} of its brightness by "
        "how they differ beyond noise"
    )


def _disc_lines(disc: "Disc", clipped: float) -> list[str]:
    (x, y), (longer, shorter) = disc.centre, disc.semi_axes
    lines = [
        f"disc       centre ({x:.2f}, {y:.2f}) px, semi-axes {longer:.2f} and {shorter:.2f} px, "
        f"outline +/- {disc.std:.3f} px"
    ]
    if clipped > 0:
        lines.append(f"highlight  {clipped:.1%} of the disc met white, and is too dark there")
    return lines


def _size_lines(learnt: "LearntBall", picture: "Picture") -> list[str]:
    """Say what one picture tells of size or distance."""
    size, radius = picture.size, learnt.file.radius
    if size is None:
        if radius is None:
            return []
        longer, shorter = picture.disc.semi_axes
        return [f"scale      {1000 * radius / (longer * shorter) ** 0.5:.4f} mm a px at the ball"]
    if picture.distance is not None:
        found = size.ratio * picture.distance
        return [f"radius     {1000 * found:.2f} +/- {1000 * found * size.std:.2f} mm by its disc"]
    if radius is not None:
        away, share = radius / size.ratio, _share(size.std, (learnt.file.radius_std or 0) / radius)
        return [f"distance   {away:.4f} +/- {away * share:.4f} m by its disc"]
    return [
        f"scale      {size.ratio:.6f} +/- {size.ratio * size.std:.6f}, radius over distance; give "
        "--radius or --distance, and it tells the other"
    ]


def _share(*parts: float) -> float:
    from math import hypot

    return hypot(*parts)


def _radius_lines(learnt: "LearntBall") -> list[str]:
    found = learnt.radius
    if found is None:
        return []
    count = len(found.by_picture) - len(found.contradicting)
    pictures = "1 picture" if count == 1 else f"{count} pictures"
    return [
        f"radius     {1000 * found.radius:.2f} +/- {1000 * found.std:.2f} mm by {pictures}, "
        f"distances taken for known within {1000 * learnt.distance_std:g} mm"
    ]


def _colour_lines(colours: "BallColours", std: Sequence[Sequence[float]]) -> list[str]:
    lines = [f"mean       {_text(colours.mean)} linear R,G,B, sensor white = 1"]
    if colours.kind == "plane":
        lines += [
            f"pigment    {_text(pigment)} +/- {_text(doubt)}"
            for pigment, doubt in zip(colours.pigments, std, strict=True)
        ]
        lines.append(
            f"plane      normal {_text(colours.normal or ())} +/- {colours.normal_std or 0:.4f} rad"
            ": two pigments and their shades"
        )
    elif colours.kind == "line":
        lines[0] += f"; +/- {_text(std[0])}"
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


def _plain(learnt: "LearntBall", out: Path) -> dict[str, Any]:
    file, colours = learnt.file, learnt.together.colours
    return {
        "schema": SCHEMA,
        "status": "ok",
        "reason": None,
        "out": str(out),
        "radius_m": file.radius,
        "radius_std_m": file.radius_std,
        "radius_found_m": None if learnt.radius is None else learnt.radius.radius,
        "radius_found_std_m": None if learnt.radius is None else learnt.radius.std,
        "kind": file.kind,
        "mean_colour": colours.mean,
        "colours": file.colours,
        "colours_std": file.colours_std,
        "plane_normal": file.plane_normal,
        "plane_normal_std": file.plane_normal_std,
        "off": colours.off,
        "pictures": [_plain_picture(one) for one in learnt.pictures],
        "shading": {
            "pictures": [
                str(source.image) for source in (*((file.sharp,) if file.sharp else ()), *file.also)
            ],
            "std_share": learnt.light.std if file.also else None,
        },
        "left_out": [
            {"path": str(one.path), "of": one.of, "reason": one.reason} for one in learnt.left_out
        ],
        "cautions": learnt.cautions,
    }


def _plain_picture(picture: "Picture") -> dict[str, Any]:
    disc, size = picture.disc, picture.size
    return {
        "path": str(picture.path),
        "background": [str(path) for path in picture.background],
        "centre_px": disc.centre,
        "semi_axes_px": disc.semi_axes,
        "angle_rad": disc.angle,
        "outline_std_px": disc.std,
        "clipped": picture.view.clipped,
        "distance_m": picture.distance,
        "radius_over_distance": None if size is None else size.ratio,
        "radius_over_distance_std": None if size is None else size.ratio * size.std,
    }


def _print_json(table: dict[str, Any]) -> None:
    from json import dumps

    from toolkit.plain_data import to_plain

    typer.echo(dumps(to_plain(table), allow_nan=False))


def _text(values: Sequence[float]) -> str:
    return ",".join(f"{value:.4f}" for value in values)
