"""toolkit plugins check: does an estimator keep what the interface promises?"""

from typing import TYPE_CHECKING, Annotated

import typer

from toolkit.errors import BadOutputError
from toolkit.option_text import parse_colours, parse_settings

if TYPE_CHECKING:
    from toolkit.testing import Report


def check(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The estimator.")],
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="FIELD=VALUE", help="An option of the estimator; repeatable."
        ),
    ] = None,
    ball_colour: Annotated[
        list[str] | None,
        typer.Option(
            metavar="R,G,B", help="Of the ball to render, linear, white = 1; twice for two."
        ),
    ] = None,
    background_colour: Annotated[
        str | None,
        typer.Option(metavar="R,G,B", help="Mean of the texture behind it [0.3,0.3,0.3]."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Try an estimator on a rendered shot with known truth: 24 checks.

    The ball is of the kind its fields ask for: plain, of two pigments, or shaded. Exit 5 when a
    check fails.
    """
    options = parse_settings(set_ or [])
    colours = parse_colours(ball_colour or [])
    if not colours and options.get("colour", "none") != "none":
        colours = parse_colours([options["colour"]], "--set colour")
    (behind,) = parse_colours([background_colour or "0.3,0.3,0.3"], "--background-colour")

    from toolkit import registry
    from toolkit.testing import check_estimator, sample_for

    sample = sample_for(registry.load(name), colours=colours, background_colour=behind)
    estimator = registry.build(name, given=sample.facts, options=options)
    report = check_estimator(estimator, sample=sample)
    typer.echo(_as_json(report) if json else str(report))
    if not report.is_good:
        raise BadOutputError(
            f"{registry.called(type(estimator))} fails {len(report.failed)} of {report.ran} checks "
            f"({', '.join(report.failed)}); repair it, or name the ball and the background that it "
            "is for with --ball-colour and --background-colour"
        )


def _as_json(report: "Report") -> str:
    import json

    from toolkit.plain_data import to_plain

    table = {**to_plain(report), "ran": report.ran, "failed": list(report.failed)}
    return json.dumps(table, allow_nan=False, indent=1)
