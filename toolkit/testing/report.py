"""What the checks of one estimator found."""

from dataclasses import dataclass
from typing import Literal

Status = Literal["passed", "failed", "expected", "skipped"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """What one check found."""

    name: str
    status: Status
    promise: str  # what was checked, one sentence
    detail: str = ""  # why it failed, was expected to, or was left out
    seconds: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What all checks of one estimator found; as text, a table."""

    estimator: str
    results: tuple[CheckResult, ...]

    @property
    def ran(self) -> int:
        """How many checks were made."""
        return sum(result.status != "skipped" for result in self.results)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that failed, or passed although they were expected to fail."""
        return tuple(result.name for result in self.results if result.status == "failed")

    @property
    def is_good(self) -> bool:
        """True where nothing failed but what was expected to."""
        return not self.failed

    def __str__(self) -> str:
        width = max(len(result.name) for result in self.results)
        lines = []
        for result in self.results:
            told = result.promise if result.status == "passed" else result.detail
            lines.append(
                f"{result.status:8}  {result.name:{width}}  {result.seconds:5.2f} s  {told}"
            )
        ending = f", {len(self.failed)} failed" if self.failed else ""
        total = f"{self.estimator}: ran {self.ran} of {len(self.results)}{ending}"
        return "\n".join([*lines, total])
