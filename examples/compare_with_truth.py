"""A measurement beside the truth of a simulated shot.

Run:  python examples/compare_with_truth.py demo       (after `make demo`)
"""

import json
import math
import sys
from pathlib import Path

from toolkit import Measurement


def compare(folder: Path) -> None:
    """Print measured, true, difference and standard deviation of every number of the state."""
    truth = json.loads((folder / "truth.json").read_text())
    ball = Measurement.from_json((folder / "measurement.json").read_text())
    if ball.position_m is None:
        sys.exit(f"nothing was measured: {ball.reason}")
    covariance = ball.state_covariance or [[math.nan] * 6] * 6
    measured = [*ball.position_m, *(ball.velocity_m_s or [math.nan] * 3)]
    true = [*truth["position_m"], *nearest_branch(truth["velocity_m_s"], measured[3:])]
    print(f"{'':12}{'measured':>11}{'true':>11}{'difference':>12}{'std':>10}")
    for i, name in enumerate(["x m", "y m", "z m", "vx m/s", "vy m/s", "vz m/s"]):
        row(name, measured[i], true[i], math.sqrt(covariance[i][i]))
    if ball.speed_m_s is not None:
        row("speed m/s", ball.speed_m_s, truth["speed_m_s"], ball.speed_std_m_s or math.nan)
    radius = truth["ball"]["radius_m"]
    print(f"\nposition is off by {math.dist(measured[:3], true[:3]) / radius:.4f} ball radii")


def nearest_branch(true: list[float], measured: list[float]) -> list[float]:
    """Give the true velocity, or its reverse: one picture leaves the sign open."""
    along = sum(t * m for t, m in zip(true, measured, strict=True))
    return [-t for t in true] if along < 0 else true


def row(name: str, measured: float, true: float, std: float) -> None:
    """Print one line of the table."""
    print(f"{name:12}{measured:11.5f}{true:11.5f}{measured - true:12.5f}{std:10.5f}")


if __name__ == "__main__":
    compare(Path(sys.argv[1]))
