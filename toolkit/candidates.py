"""Which estimators suit what is known about the ball: the one named, or all that can be made."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from toolkit import registry
from toolkit.alpha import AlphaEstimator
from toolkit.errors import ConfigError, PluginError
from toolkit.known_ball import KnownBall
from toolkit.measurement import Candidate

AUTO = "auto"
"""The name that leaves the choice to the pictures."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """Estimators ready to be tried, and why the others are not."""

    ready: tuple[tuple[str, AlphaEstimator], ...]
    unsuited: tuple[Candidate, ...]
    files: tuple[Path, ...]  # read to make them


def what_is_needed(name: str, ball: KnownBall, options: Mapping[str, str]) -> tuple[str, ...]:
    """Say in the user's words what an estimator still needs to know; nothing for `auto`.

    Raises:
        ConfigError: when options or several colours are given to an estimator without use for them.
        PluginError: when the estimator is unknown or broken.
    """
    if name == AUTO:
        if options:
            given = ", ".join(options)
            raise ConfigError(f"--set {given} belongs to one estimator; name it with --estimator")
        return ()
    estimator = registry.load(name)
    fields = estimator.option_names()
    colours = ball.numbers.get("colours", ())
    count = len(colours) if isinstance(colours, tuple) and not ball.file else 0
    if count > 1 and "colour" in fields and "colours" not in fields:
        raise ConfigError(
            f"{count} ball colours are given, but estimator '{name}' is for "
            "a ball of one; give one, or choose another --estimator"
        )
    return registry.missing_fields(estimator, dict.fromkeys([*ball.names, *options]))


def make_candidates(name: str, ball: KnownBall, options: Mapping[str, str]) -> Candidates:
    """Make the estimator called `name`, or with `auto` all that what is known suffices for.

    Raises:
        CalibrationError: when the sharp picture shows no disc that can be used.
        ConfigError: when a value is impossible.
        PluginError: when the estimator named is unknown or broken.
    """
    if name != AUTO:
        fields = registry.load(name).option_names()
        estimator = _build(name, ball, fields, options)
        return Candidates(ready=((name, estimator),), unsuited=(), files=ball.files(fields))
    ready, unsuited, files = [], [], dict.fromkeys(ball.files(()))
    for info in registry.installed():
        try:
            estimator, read = _make(info.name, ball)
        except (ConfigError, PluginError) as error:
            reason = str(error).removeprefix(f"{info.name} ")
            unsuited.append(Candidate(estimator=info.name, reason=reason))
            continue
        ready.append((info.name, estimator))
        files |= dict.fromkeys(read)
    if not ready:
        reasons = "; ".join(f"{candidate.estimator}: {candidate.reason}" for candidate in unsuited)
        raise ConfigError(f"no installed estimator can be used: {reasons or 'none is installed'}")
    return Candidates(ready=tuple(ready), unsuited=tuple(unsuited), files=tuple(files))


def _make(name: str, ball: KnownBall) -> tuple[AlphaEstimator, tuple[Path, ...]]:
    estimator = registry.load(name)
    missing = registry.missing_fields(estimator, dict.fromkeys(ball.names))
    if missing:
        raise ConfigError(f"needs {'; and '.join(missing)}")
    fields = estimator.option_names()
    return _build(name, ball, fields, {}), ball.files(fields)


def _build(
    name: str, ball: KnownBall, fields: Collection[str], options: Mapping[str, str]
) -> AlphaEstimator:
    """Make an estimator; where it lacks a plane and the ball's looks tell why, say that."""
    try:
        return registry.build(name, given=ball.facts(fields), options=options)
    except ConfigError as error:
        reason = None if options else ball.lacks_plane(fields)
        if reason is None:
            raise
        raise ConfigError(f"{name} cannot be used: {reason}") from error
