"""Checks for authors of estimators: 24 promises, each tried on a rendered shot with known truth.

from toolkit.testing import estimator_checks

@estimator_checks(lambda: Shiny(gloss=0.3))
def test_shiny(check):
    check()
"""

from toolkit.testing.parametrise import estimator_checks
from toolkit.testing.report import CheckResult, Report, Status
from toolkit.testing.run import check_estimator, check_names
from toolkit.testing.sample import Sample, make_sample, sample_for

__all__ = [
    "CheckResult",
    "Report",
    "Sample",
    "Status",
    "check_estimator",
    "check_names",
    "estimator_checks",
    "make_sample",
    "sample_for",
]
