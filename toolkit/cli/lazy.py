"""A command group that imports a command only when that command runs."""

import ast
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from toolkit.entry_points import declared, owner
from toolkit.errors import ConfigError, PluginError
from toolkit.files import one_line

GROUP = "toolkit.commands"


class LazyGroup(TyperGroup):
    """Commands by "module:function": those of `built_in`, and those other packages declare.

    A name of `built_in` cannot be taken over by another package.
    """

    built_in: ClassVar[Mapping[str, str]] = {}
    entry_points: ClassVar[str | None] = GROUP
    """The group by which other packages declare commands; None where they cannot."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Name all commands without importing any."""
        return [*self.built_in, *sorted({point.name for point in self._strangers()})]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import one command; None when there is no such name."""
        target = self._target(cmd_name)
        if target is None:
            return None
        module, _, attribute = target.partition(":")
        try:
            loaded = getattr(import_module(module), attribute)
        except (Exception, SystemExit) as error:
            if cmd_name in self.built_in:
                raise  # our own bug, or a missing dependency: main reports it
            reason = f"{type(error).__name__}: {one_line(error)}"
            raise PluginError(
                f"command '{cmd_name}' ({target}) cannot be loaded ({reason}); "
                "repair or uninstall the package that declares it"
            ) from error
        return as_command(cmd_name, loaded)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command to run; an unknown one is answered with the nearest name."""
        names = self.list_commands(ctx)
        if args[0] not in names:
            near = get_close_matches(args[0], names, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(names)}"
            raise ConfigError(f"no command '{args[0]}'; {hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands for --help."""
        rows = [(name, help_line(self._target(name) or "")) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def _target(self, name: str) -> str | None:
        if name in self.built_in:
            return self.built_in[name]
        points = [point for point in self._strangers() if point.name == name]
        if len(points) > 1:
            owners = " and ".join(owner(point) for point in points)
            raise PluginError(f"command '{name}' is declared by {owners}; uninstall one of them")
        return points[0].value if points else None

    def _strangers(self) -> list[EntryPoint]:
        if self.entry_points is None:
            return []
        points = declared(self.entry_points)
        return [point for point in points if point.name not in self.built_in]


def as_command(name: str, loaded: Callable[..., Any] | typer.Typer) -> TyperCommand | TyperGroup:
    """Make a command of a plain function, or of an app that has subcommands."""
    if isinstance(loaded, typer.Typer):
        app = loaded
    else:
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        app.command(name)(loaded)
    command = typer.main.get_command(app)
    command.name = name
    assert isinstance(command, TyperCommand | TyperGroup)  # what typer makes, for the type checker
    return command


def help_line(target: str) -> str:
    """Read the first docstring line of "module:function" from its source, running none of it.

    The module's own docstring stands in where there is no such function.
    """
    module, _, function = target.partition(":")
    try:
        spec = find_spec(module)
        if spec is None or spec.origin is None:
            return "(not found; reinstall the package that declares it)"
        tree = ast.parse(Path(spec.origin).read_bytes())
    except (Exception, SystemExit) as error:
        return f"(broken: {one_line(error)})"
    found = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == function]
    text = (ast.get_docstring(found[0]) if found else None) or ast.get_docstring(tree) or ""
    return text.partition("\n")[0]
