"""A measurement in a dozen lines of text; plain ASCII, so that every terminal can show it."""

import math
from collections.abc import Iterable, Sequence

from toolkit.measurement import Measurement, ProfileTable, Shares, Sign


def summarise(measurement: Measurement) -> str:
    """Say in words what was measured, with uncertainties (one standard deviation) and cautions."""
    rows = [
        ("position", _spread(measurement.position_m, measurement.position_std_m, "m")),
        ("direction", _vector(measurement.direction)),
        ("speed", _speed(measurement)),
        ("velocity", _vector(measurement.velocity_m_s, "m/s")),
        *_sign_rows(measurement.sign),
        ("time", _number(measurement.time_s, "s after the exposure began")),
        ("profiles", _profiles(measurement.profiles)),
        ("fit", _fit(measurement)),
        *_budget_rows(measurement),
        *(("caution", caution.message) for caution in measurement.warnings),
    ]
    head = "refused: " + (measurement.reason or "no reason given")
    if measurement.status == "ok":
        head = f"estimator {measurement.estimator}, stage {measurement.stage}, camera frame: "
        head += "x right, y down, z forward"
    return "\n".join([head, *(f"  {name:<10} {text}" for name, text in rows if text)])


def _vector(values: Sequence[float] | None, unit: str = "") -> str:
    if values is None:
        return ""
    return " ".join([*(f"{v:+.4f}" for v in values), unit]).rstrip()


def _spread(values: Sequence[float] | None, stds: Sequence[float] | None, unit: str) -> str:
    if values is None or stds is None:
        return _vector(values, unit)
    pairs = zip("xyz", values, stds, strict=True)
    return ", ".join(f"{axis} {_with_std(v, s, '+')}" for axis, v, s in pairs) + f" {unit}"


def _with_std(value: float, std: float, sign: str = "") -> str:
    """Write both to the second digit of the standard deviation: no more of the value is known."""
    if not (math.isfinite(std) and std > 0):
        return f"{value:{sign}.5g} +/- {std:.2g}"
    decimals = min(max(1 - math.floor(math.log10(std)), 0), 12)
    return f"{value:{sign}.{decimals}f} +/- {std:.{decimals}f}"


def _number(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.6g} {unit}"


def _speed(measurement: Measurement) -> str:
    if measurement.speed_m_s is None:
        limit = measurement.speed_upper_m_s
        return "unknown" if limit is None else f"below {limit:.4g} m/s"
    if measurement.speed_std_m_s is None:
        return f"{measurement.speed_m_s:.5g} m/s"
    return f"{_with_std(measurement.speed_m_s, measurement.speed_std_m_s)} m/s"


def _sign_rows(sign: Sign | None) -> Iterable[tuple[str, str]]:
    if sign is None:
        return []
    reported = f"probability {sign.probability:.2f}"
    if not sign.ambiguous:
        return [("sign", f"settled by {sign.cue}, {reported}")]
    rows = [("sign", f"open, {reported}; the picture fits these directions as well:")]
    return rows + [
        ("", f"{_vector(other.direction)}, probability {other.probability:.2f}")
        for other in sign.alternatives
    ]


def _profiles(table: ProfileTable | None) -> str:
    if table is None:
        return ""
    return f"{sum(flag == 0 for flag in table.flags)} of {len(table.flags)} used"


def _fit(measurement: Measurement) -> str:
    fit = measurement.fit
    if fit is None:
        return ""
    return f"chi2 per degree of freedom {fit.chi2_per_dof:.2f} over {fit.pixels} samples"


def _budget_rows(measurement: Measurement) -> Iterable[tuple[str, str]]:
    budget = measurement.budget
    if budget is None:
        return []
    rows = [("depth var.", _shares(budget.depth))]
    return rows + ([] if budget.speed is None else [("speed var.", _shares(budget.speed))])


def _shares(shares: Shares) -> str:
    sources = ("noise", "camera", "radius", "exposure", "response")
    known = [(name, getattr(shares, name)) for name in sources]
    return ", ".join(f"{name} {100 * share:.0f} %" for name, share in known if share is not None)
