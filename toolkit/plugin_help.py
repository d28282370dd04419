"""What a user wants to know about an estimator before using it: its purpose and its options."""

import ast
import inspect
import re
import textwrap
from dataclasses import MISSING, Field, dataclass, fields
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from toolkit.option_text import can_be_text, format_option
from toolkit.registry import HOW_TO_GIVE, load, option_kinds

if TYPE_CHECKING:  # it brings torch
    from toolkit.alpha import AlphaEstimator

EXAMPLES = {
    "colour": "--ball-colour 0.8,0.4,0.1",
    "colours": "--ball-colour 0.8,0.4,0.1 --ball-colour 0.1,0.2,0.6",
    "ball": "--ball-image sharp.png",
    "plane_normal": "--ball ball.toml",
}
"""How what is known about the ball may be written on a command line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OptionHelp:
    """One option of an estimator, in words."""

    name: str
    kind: str
    default: str | None  # None where it must be given
    help: str
    how: str  # how it is given


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorHelp:
    """An estimator, in words."""

    name: str
    about: str
    options: tuple[OptionHelp, ...]
    example: str  # a command line


def describe_estimator(name: str) -> EstimatorHelp:
    """Import the estimator called `name` and describe it from its docstring and its fields.

    The help of an option is the string under its field, or `metadata={"help": ...}` of the field.

    Raises:
        PluginError: as `toolkit.registry.load` does.
    """
    estimator = load(name)
    kinds = option_kinds(name, estimator)
    texts = field_texts(estimator)
    options = tuple(
        OptionHelp(
            name=field.name,
            kind=_kind(field),
            default=_default(field),
            help=str(field.metadata.get("help", texts.get(field.name, ""))),
            how=_how(field.name, kinds[field.name]),
        )
        for field in fields(estimator)
        if field.init
    )
    return EstimatorHelp(
        name=name, about=_about(estimator), options=options, example=_example(name, options)
    )


def field_texts(estimator: "type[AlphaEstimator]") -> dict[str, str]:
    """Read the string under each field from the source of a class and its parents."""
    texts: dict[str, str] = {}
    for parent in reversed(estimator.__mro__):
        if "__dataclass_fields__" in vars(parent):
            texts |= _texts_in(parent)
    return texts


def _about(estimator: "type[AlphaEstimator]") -> str:
    """Give a class's own docstring as far as it speaks to users."""
    text = inspect.cleandoc(vars(estimator).get("__doc__") or "")
    # dataclass writes a signature where the author wrote nothing
    if text.startswith(f"{estimator.__name__}("):
        return ""
    return re.split(r"^(?:Source|Args|Raises|Example)s?:", text, maxsplit=1, flags=re.M)[0].strip()


def _texts_in(parent: type) -> dict[str, str]:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(parent)))
    except (OSError, TypeError, SyntaxError):  # made on the fly, or installed without its source
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    found = {}
    for statement, below in pairwise(body):
        if not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)):
            continue
        text = below.value if isinstance(below, ast.Expr) else None
        if isinstance(text, ast.Constant) and isinstance(text.value, str):
            found[statement.target.id] = " ".join(text.value.split())
    return found


def _kind(field: "Field[Any]") -> str:
    return field.type if isinstance(field.type, str) else inspect.formatannotation(field.type)


def _default(field: "Field[Any]") -> str | None:
    if field.default is not MISSING:
        value = field.default
    elif field.default_factory is not MISSING:
        value = field.default_factory()
    else:
        return None
    try:
        return format_option(value)
    except Exception:  # a value of the author's own kind: any text will do
        return type(value).__name__


def _how(name: str, kind: Any) -> str:
    if name in HOW_TO_GIVE:
        return HOW_TO_GIVE[name].partition(": ")[2]
    if can_be_text(kind):
        return f"--set {name}=VALUE, or {name} under [measure] in the rig"
    return "from Python only"


def _example(name: str, options: tuple[OptionHelp, ...]) -> str:
    words = [f"toolkit measure shot.dng --estimator {name}"]
    # one thing known about the ball is enough where several would serve
    words += [EXAMPLES[option.name] for option in options if option.name in EXAMPLES][:1]
    for option in options:
        if option.how.startswith("--set"):
            words.append(f"--set {option.name}={option.default or 'VALUE'}")
    return " ".join(words)
