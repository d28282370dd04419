"""Finds the estimators that installed packages declare, and builds the one that was asked for.

A package declares one by an entry point of the group `toolkit.alpha_estimators`; the built-in ones
are declared in the same way. Listing imports none of them, building the named one only.
"""

import ast
import inspect
import re
import sys
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import lru_cache
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from toolkit.entry_points import declared, owner, owner_parts, unreadable
from toolkit.errors import ConfigError, PluginError, ToolkitError
from toolkit.files import one_line
from toolkit.option_text import parse_option

if TYPE_CHECKING:  # it brings torch, which a list of names does not need
    from toolkit.alpha import AlphaEstimator

GROUP = "toolkit.alpha_estimators"
NAME_PATTERN = re.compile(r"[a-z][a-z0-9_-]{0,40}")
RESERVED = ("auto",)
"""Names with a meaning of their own, which no package may claim."""

# how a user gives what an estimator needs to know about the ball; other fields come by --set
HOW_TO_GIVE = {
    "colour": "the ball's colour: --ball-colour R,G,B, or colours under [ball] in the rig",
    "colours": "the ball's colours: --ball-colour R,G,B each, or colours under [ball] in the rig",
    "ball": "a sharp picture of the ball: --ball-image F, or --ball F.toml",
    "plane_normal": "the plane of the ball's colours: --ball F.toml, or [ball] file in the rig",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PluginInfo:
    """One declared estimator, as its package describes it; nothing of it has been imported."""

    name: str
    distribution: str
    version: str
    target: str  # "module:class"
    place: Path | None = None  # the file it comes from; None when there is no such file
    problem: str | None = None  # why it cannot be used, as far as that shows

    @property
    def owner(self) -> str:
        """The distribution and its version."""
        return f"{self.distribution} {self.version}"


def installed() -> tuple[PluginInfo, ...]:
    """List the declared estimators by name, the unusable ones included, without importing any.

    What shows only when a package is imported is found by `tried`.
    """
    points = sorted(declared(GROUP), key=lambda point: point.name)
    names = [point.name for point in points]
    damaged = (
        PluginInfo(
            name="?",
            distribution=distribution,
            version="?",
            target="?",
            problem="its entry points cannot be read; repair or uninstall that package",
        )
        for distribution in unreadable()
    )
    return (*(_info(point, claims=names.count(point.name)) for point in points), *damaged)


def tried(info: PluginInfo) -> PluginInfo:
    """Import one estimator and note the problem that this shows, if any."""
    if info.problem is not None:
        return info
    try:
        load(info.name)
    except PluginError as error:
        return replace(info, problem=str(error))
    return info


def load(name: str) -> "type[AlphaEstimator]":
    """Import the one estimator called `name`.

    What would stop any program (Ctrl-C) stops this one too.

    Raises:
        PluginError: when no or more than one package declares it, it cannot be imported, or it is
            no finished subclass of AlphaEstimator for this API version.
    """
    point = _find(name)
    try:
        loaded = point.load()
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise PluginError(
            f"estimator '{name}' of {owner(point)} cannot be imported ({reason}); "
            "repair or uninstall that package"
        ) from error
    problem = _contract_problem(loaded)
    if problem is not None:
        raise PluginError(f"estimator '{name}' of {owner(point)} {problem}")
    estimator: type[AlphaEstimator] = loaded
    return estimator


def build(
    name: str, *, given: Mapping[str, object], options: Mapping[str, str]
) -> "AlphaEstimator":
    """Make the estimator called `name`.

    Args:
        name: of the entry point.
        given: what is known about the ball ("colour", "colours"); an estimator gets what it has a
            field for, and the rest does not concern it.
        options: text by field name, as `--set field=value` writes it; these beat `given`.

    Raises:
        PluginError: as `load` does, or when the estimator breaks while it is made.
        ConfigError: when a field is unknown, missing, or has an impossible value.
    """
    estimator = load(name)
    kinds = option_kinds(name, estimator)
    values: dict[str, object] = {key: given[key] for key in kinds if key in given}
    for key, text in options.items():
        if key not in kinds:
            known = ", ".join(kinds) or "none"
            raise ConfigError(f"estimator '{name}' has no field '{key}'; its fields are: {known}")
        values[key] = parse_option(text, kinds[key], f"field '{key}' of estimator '{name}'")
    missing = missing_fields(estimator, values)
    if missing:
        raise ConfigError(f"{name} needs {'; and '.join(missing)}")
    return _make(name, estimator, values)


def option_kinds(name: str, estimator: "type[AlphaEstimator]") -> dict[str, Any]:
    """Give the type of each field of an estimator that can be set.

    Raises:
        PluginError: when a type is written that does not exist.
    """
    try:
        hints = get_type_hints(estimator)
    except Exception as error:  # a stranger's code may raise anything
        raise PluginError(
            f"estimator '{name}' has a field type that cannot be read ({one_line(error)}); "
            "its author must correct it"
        ) from error
    return {key: hints[key] for key in estimator.option_names()}


def name_of(estimator: "type[AlphaEstimator]") -> str:
    """Give the name an estimator is declared by, or that of its class in lower case with hyphens.

    Example:
        >>> class TwoColour: ...
        >>> name_of(TwoColour)
        'two-colour'
    """
    name = _declared_name(estimator, tuple(sys.path))
    if name is not None:
        return name
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", estimator.__name__).lower()


def name_problem(name: str) -> str | None:
    """Say why an estimator cannot have this name, None where it can."""
    if not NAME_PATTERN.fullmatch(name):
        return f"its name does not match {NAME_PATTERN.pattern}"
    return f"the name '{name}' is reserved" if name in RESERVED else None


def called(estimator: "type[AlphaEstimator]") -> str:
    """Name an estimator for an error: its name, and whose it is where a package declares it.

    Example:
        >>> class TwoColour: ...
        >>> called(TwoColour)
        "estimator 'two-colour'"
    """
    point = _declaration(estimator)
    whose = "" if point is None else f" of {owner(point)}"
    return f"estimator '{name_of(estimator)}'{whose}"


def missing_fields(
    estimator: "type[AlphaEstimator]", values: Mapping[str, object]
) -> tuple[str, ...]:
    """Say in the user's words which required fields of `estimator` are not among `values`."""
    return tuple(
        HOW_TO_GIVE.get(field.name, f"its field '{field.name}': --set {field.name}=VALUE")
        for field in fields(estimator)
        if field.init
        and field.default is MISSING
        and field.default_factory is MISSING
        and field.name not in values
    )


@lru_cache(maxsize=64)
def _declared_name(estimator: type, _: tuple[str, ...]) -> str | None:
    """Find the name a class is declared by; to look through all packages takes a while.

    The path on which they lie is remembered with the answer.
    """
    point = _declaration(estimator)
    return None if point is None else point.name


def _declaration(estimator: type) -> EntryPoint | None:
    """Find the entry point that declares a class."""
    target = f"{estimator.__module__}:{estimator.__qualname__}"
    points = declared(GROUP)
    return next((point for point in points if point.value == target), None)


def _find(name: str) -> EntryPoint:
    points = [point for point in declared(GROUP) if point.name == name]
    if not points:
        names = ", ".join(sorted({point.name for point in declared(GROUP)})) or "none"
        if name in RESERVED:
            raise PluginError(f"'{name}' is no estimator but tries those installed: {names}")
        raise PluginError(f"no estimator '{name}' is installed; installed are: {names}")
    if len(points) > 1:
        owners = " and ".join(owner(point) for point in points)
        raise PluginError(f"estimator '{name}' is declared by {owners}; uninstall one of them")
    problem = _name_problem(name, claims=1)
    if problem is not None:
        raise PluginError(f"estimator '{name}' of {owner(points[0])}: {problem}")
    return points[0]


def _info(point: EntryPoint, claims: int) -> PluginInfo:
    place, (distribution, version) = _place(point.value), owner_parts(point)
    return PluginInfo(
        name=point.name,
        distribution=distribution,
        version=version,
        target=point.value,
        place=place,
        problem=_name_problem(point.name, claims) or _source_problem(point.value, place),
    )


def _name_problem(name: str, claims: int) -> str | None:
    problem = name_problem(name)
    if problem is not None:
        return f"{problem}; its author must rename it"
    if claims > 1:
        return f"{claims} packages declare this name; uninstall all but one"
    return None


def _place(target: str) -> Path | None:
    """Find the file of "module:class" without importing anything, not even its package."""
    top, *below = target.partition(":")[0].strip().split(".")
    try:
        spec = find_spec(top) if top else None
    except (ImportError, ValueError):  # a module that is half made, or broken on purpose
        return None
    if spec is None:
        return None
    if not below:
        return Path(spec.origin) if spec.origin else None
    for folder in spec.submodule_search_locations or ():
        stem = Path(folder, *below)
        found = [p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.is_file()]
        # a compiled module has a suffix of its machine
        found += sorted(stem.parent.glob(f"{stem.name}.*.so")) if stem.parent.is_dir() else []
        if found:
            return found[0]
    return None


def _source_problem(target: str, place: Path | None) -> str | None:
    """Say what a look at the source, which runs none of it, shows to be wrong."""
    module, _, attribute = target.partition(":")
    if place is None:
        return f"there is no module {module.strip()}; repair or uninstall that package"
    if not attribute.strip():
        return f"'{target}' names no class; its author must declare module:Class"
    if place.suffix != ".py":
        return None
    try:
        ast.parse(place.read_bytes())
    except (OSError, SyntaxError, ValueError) as error:
        return (
            f"its source cannot be read ({type(error).__name__}: {one_line(error)}); "
            "repair or uninstall that package"
        )
    return None


def _contract_problem(loaded: Any) -> str | None:
    """Say what keeps a loaded object from being an estimator, None when nothing does."""
    from toolkit.alpha import API_VERSION, AlphaEstimator

    if not isinstance(loaded, type) or not issubclass(loaded, AlphaEstimator):
        return "is not a subclass of toolkit.AlphaEstimator; its author must derive it from that"
    if inspect.isabstract(loaded):
        lacking = ", ".join(sorted(loaded.__abstractmethods__))
        return f"is unfinished; its author must write {lacking}"
    if loaded.api_version != API_VERSION:
        return (
            f"is written for API version {loaded.api_version!r}, this toolkit has {API_VERSION}; "
            "install versions that agree"
        )
    # without the decorator the fields of the class would be ignored in silence
    own = {key for key, kind in inspect.get_annotations(loaded).items() if not _is_class_var(kind)}
    if own and "__dataclass_params__" not in vars(loaded):
        return "has fields but is not a dataclass; its author must add @dataclass(frozen=True)"
    return None


def _is_class_var(kind: Any) -> bool:
    return "ClassVar" in (kind if isinstance(kind, str) else str(kind))


def _make(
    name: str, estimator: "type[AlphaEstimator]", values: Mapping[str, object]
) -> "AlphaEstimator":
    try:
        return estimator(**values)
    except ToolkitError:
        raise
    except Exception as error:  # a stranger's code may raise anything
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise PluginError(
            f"estimator '{name}' does not accept its values ({reason}); correct them, or report "
            "it to its author"
        ) from error
