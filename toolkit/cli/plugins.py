"""Estimators: list those installed, explain one, check one, start a new one."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from toolkit.cli.lazy import LazyGroup

if TYPE_CHECKING:
    from collections.abc import Sequence

    from toolkit.plugin_help import OptionHelp
    from toolkit.registry import PluginInfo

WIDTH = 100

Name = Annotated[str, typer.Argument(metavar="NAME", help="The estimator.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


class PluginCommands(LazyGroup):
    """The commands about estimators."""

    built_in = {  # noqa: RUF012  (declared a ClassVar in the base)
        "list": "toolkit.cli.plugins:list_",
        "show": "toolkit.cli.plugins:show",
        "check": "toolkit.cli.plugin_check:check",
        "new": "toolkit.cli.plugins:new",
    }
    entry_points = None


app = typer.Typer(cls=PluginCommands, add_completion=False, rich_markup_mode=None)


@app.callback()
def plugins() -> None:
    """List, explain, check and start estimators: the ways a ball is told from its background."""


def list_(
    load: Annotated[
        bool, typer.Option("--load", help="Import each, which finds what only then shows.")
    ] = False,
    json: Json = False,
) -> None:
    """List the installed estimators, and what is wrong with those that cannot be used.

    Nothing is imported unless --load says so.
    """
    from toolkit import registry

    found = registry.installed()
    if load:
        found = tuple(registry.tried(info) for info in found)
    if json:
        _print_json({"estimators": [_plain(info) for info in found]})
        return
    for line in _table(found) if found else ["no estimator is installed"]:
        typer.echo(line)


def show(name: Name, json: Json = False) -> None:
    """Explain one estimator: what it is for, its options, and how each is given."""
    from toolkit.plugin_help import describe_estimator

    found = describe_estimator(name)
    if json:
        from dataclasses import asdict

        _print_json(asdict(found))
        return
    typer.echo(f"{name}: {found.about or 'its author wrote no description'}\n")
    typer.echo("options:" if found.options else "no options")
    for option in found.options:
        typer.echo(_explain(option))
    typer.echo(f"\nfor example: {found.example}")


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The new estimator's name.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The new folder; by default NAME, here."),
    ] = None,
) -> None:
    """Write a new package with an estimator that works, and its tests, for you to change."""
    from toolkit.new_plugin import write_plugin

    folder = write_plugin(name, out or Path(name))
    typer.echo(
        f"{folder} holds a package with the estimator '{name}'; next: "
        f"python -m pip install -e {folder} && toolkit plugins list"
    )


def _plain(info: "PluginInfo") -> dict[str, str | None]:
    return {
        "name": info.name,
        "distribution": info.distribution,
        "version": info.version,
        "target": info.target,
        "place": None if info.place is None else str(info.place),
        "problem": info.problem,
    }


def _table(found: "Sequence[PluginInfo]") -> list[str]:
    """One line each, with another below it where there is a problem."""
    rows = [(info.name, info.owner, str(info.place or "no such file")) for info in found]
    name_width, owner_width = (max(len(row[column]) for row in rows) for column in (0, 1))
    lines = []
    for info, (name, owner, place) in zip(found, rows, strict=True):
        lines.append(f"{name:{name_width}}  {owner:{owner_width}}  {place}")
        if info.problem is not None:
            lines.append(f"{'':{name_width}}  problem: {info.problem}")
    return lines


def _explain(option: "OptionHelp") -> str:
    default = "must be given" if option.default is None else f"default {option.default or 'empty'}"
    lines = [option.help or "(no help)", f"given by {option.how}"]
    text = "\n".join(textwrap.fill(line, WIDTH - 6) for line in lines)
    return f"  {option.name}: {option.kind}, {default}\n{textwrap.indent(text, ' ' * 6)}"


def _print_json(value: object) -> None:
    import json

    typer.echo(json.dumps(value, allow_nan=False, indent=1))
