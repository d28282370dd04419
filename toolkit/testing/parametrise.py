"""The checks as tests of an author's own suite."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from toolkit.alpha import AlphaEstimator
from toolkit.errors import ConfigError
from toolkit.testing.case import CheckFailed
from toolkit.testing.run import check_estimator, check_names
from toolkit.testing.sample import Sample, sample_for


def estimator_checks(
    make_estimator: Callable[[], AlphaEstimator],
    *,
    make_sample: Callable[[], Sample] | None = None,
    expected_failures: Mapping[str, str] | None = None,
) -> Any:
    """Make one pytest test of each check; the test calls the `check` it is given.

    Nothing is made or rendered before the first test runs, and the sample once.

    Args:
        make_estimator: gives the estimator to check.
        make_sample: gives a shot of the kind of ball it is for; `sample_for` when None.
        expected_failures: reasons by the names of checks that are known to fail; strict.

    Example:
        >>> from plugins.uniform import Uniform
        >>> @estimator_checks(lambda: Uniform(colour=(0.75, 0.4, 0.1)))
        ... def test_uniform(check):
        ...     check()
    """
    import pytest

    expected = dict(expected_failures or {})
    unknown = [name for name in expected if name not in check_names()]
    if unknown:
        raise ConfigError(f"no check '{unknown[0]}'; there are: {', '.join(check_names())}")

    @cache
    def sample() -> Sample:
        return sample_for(make_estimator()) if make_sample is None else make_sample()

    def check_called(name: str) -> Callable[[], None]:
        def check() -> None:
            reasons = {name: expected[name]} if name in expected else None
            report = check_estimator(
                make_estimator(), sample=sample(), expected_failures=reasons, only=[name]
            )
            (result,) = (result for result in report.results if result.name == name)
            if result.status == "failed":
                raise CheckFailed(f"{name}: {result.detail}. {result.promise}")
            if result.status == "expected":
                pytest.xfail(result.detail)

        return check

    return pytest.mark.parametrize(
        "check", [pytest.param(check_called(name), id=name) for name in check_names()]
    )
