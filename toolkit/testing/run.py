"""Runs the checks on an estimator."""

import inspect
import time
from collections.abc import Callable, Collection, Mapping

from toolkit.alpha import AlphaEstimator
from toolkit.errors import ConfigError
from toolkit.files import one_line
from toolkit.registry import name_of
from toolkit.testing import checks_foreground as fore
from toolkit.testing import checks_manners as manners
from toolkit.testing import checks_observe as observe
from toolkit.testing import checks_truth as truth
from toolkit.testing.case import Case, CheckFailed
from toolkit.testing.report import CheckResult, Report
from toolkit.testing.sample import Sample, sample_for

Check = Callable[[Case], None]

_CHECKS: tuple[Check, ...] = (
    observe.observe_shapes,
    observe.observe_finite,
    observe.observe_ground,
    observe.observe_noise,
    observe.observe_raw,
    observe.observe_bad_pixels,
    observe.observe_input_unchanged,
    observe.observe_batch,
    observe.observe_window,
    fore.foreground_shapes,
    fore.foreground_order,
    fore.foreground_parts,
    fore.foreground_slope,
    fore.foreground_appearance,
    truth.truth_alpha,
    truth.truth_variance,
    truth.truth_measure,
    manners.precision_kept,
    manners.repeatable,
    manners.threads_kept,
    manners.state_kept,
    manners.options_round_trip,
    manners.options_refused,
    manners.cost,
)


def check_names() -> tuple[str, ...]:
    """Names of all checks, in the order in which they run.

    Example:
        >>> len(check_names())
        24
    """
    return tuple(_name(check) for check in _CHECKS)


def check_estimator(
    estimator: AlphaEstimator,
    *,
    sample: Sample | None = None,
    expected_failures: Mapping[str, str] | None = None,
    only: Collection[str] | None = None,
) -> Report:
    """Try every promise of the estimator interface on a rendered shot with known truth.

    Args:
        estimator: what to check.
        sample: a shot of the kind of ball it is for; `sample_for` chooses one when None.
        expected_failures: reasons by the names of checks that are known to fail; one that passes
            all the same is a failure, so that no reason outlives its cause.
        only: names of the checks to make; the others are reported as skipped.

    Raises:
        ConfigError: when a name is unknown, or a reason empty.

    Example:
        >>> from plugins.uniform import Uniform
        >>> report = check_estimator(Uniform(colour=(0.75, 0.4, 0.1)), only=["foreground-slope"])
        >>> report.ran, report.failed
        (1, ())
    """
    expected = expected_failures or {}
    wanted = check_names() if only is None else only
    _check_names(expected, wanted)
    case = Case(estimator=estimator, sample=sample or sample_for(estimator))
    results = [
        _result(check, case, expected.get(_name(check)))
        if _name(check) in wanted
        else CheckResult(
            name=_name(check), status="skipped", promise=_promise(check), detail="not asked for"
        )
        for check in _CHECKS
    ]
    return Report(estimator=name_of(type(estimator)), results=tuple(results))


def _result(check: Check, case: Case, reason: str | None) -> CheckResult:
    name, promise = _name(check), _promise(check)
    start = time.perf_counter()
    trouble = _trouble(check, case)
    seconds = time.perf_counter() - start
    if reason is None:
        status, detail = ("passed", "") if trouble is None else ("failed", trouble)
    elif trouble is None:
        status, detail = "failed", f"passes, though expected to fail ({reason}); drop the reason"
    else:
        status, detail = "expected", f"{reason} ({trouble})"
    return CheckResult(
        name=name,
        status=status,  # type: ignore[arg-type]
        promise=promise,
        detail=detail,
        seconds=seconds,
    )


def _trouble(check: Check, case: Case) -> str | None:
    """Make a check and say in one line what is wrong, None when nothing is."""
    try:
        check(case)
    except CheckFailed as error:
        return one_line(error)
    except (Exception, SystemExit) as error:  # a stranger's code may raise anything
        return f"breaks with {type(error).__name__}: {one_line(error)}"
    return None


def _name(check: Check) -> str:
    return check.__name__.replace("_", "-")


def _promise(check: Check) -> str:
    return inspect.cleandoc(check.__doc__ or "").partition("\n")[0]


def _check_names(expected: Mapping[str, str], wanted: Collection[str]) -> None:
    for name in (*expected, *wanted):
        if name not in check_names():
            raise ConfigError(f"no check '{name}'; there are: {', '.join(check_names())}")
    for name, reason in expected.items():
        if not reason.strip():
            raise ConfigError(f"the failure of '{name}' is expected without a reason; give one")
