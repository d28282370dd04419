"""A measurement in a dozen lines of text; plain ASCII, so that every terminal can show it."""

import math
from collections.abc import Iterable, Sequence
from statistics import median

from toolkit.measurement import Bound, Measurement, ProfileTable, Shares, Sign

PROFILES = "profiles"
"""The stage that looks through no camera yet."""


def summarise(measurement: Measurement) -> str:
    """Say in words what was measured, with uncertainties (one standard deviation) and cautions."""
    rows = [
        ("position", _spread(measurement.position_m, measurement.position_std_m, "m")),
        ("direction", _vector(measurement.direction)),
        ("speed", _speed(measurement)),
        ("velocity", _velocity(measurement)),
        *_sign_rows(measurement.sign),
        ("time", _number(measurement.time_s, "s after the first row's exposure began")),
        ("profiles", _profiles(measurement.profiles)),
        ("fit", _fit(measurement)),
        ("bound", _bound(measurement.bound)),
        *_budget_rows(measurement),
        *(("caution", caution.message) for caution in measurement.warnings),
    ]
    return "\n".join([_head(measurement), *(f"  {name:<10} {text}" for name, text in rows if text)])


def _head(measurement: Measurement) -> str:
    if measurement.status != "ok":
        return "refused: " + (measurement.reason or "no reason given")
    frame = "camera frame: x right, y down, z forward"
    if measurement.stage == PROFILES:
        frame = "pixels of the stored picture; nothing in space"
    return f"estimator {measurement.estimator}, stage {measurement.stage}, {frame}"


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
    if measurement.stage == PROFILES:
        return ""
    if measurement.speed_upper_m_s is not None:
        return f"at most {measurement.speed_upper_m_s:.2g} m/s (95 %): it may have stood still"
    if measurement.speed_m_s is None:
        return "unknown"
    if measurement.speed_std_m_s is None:
        return f"{measurement.speed_m_s:.5g} m/s"
    return f"{_with_std(measurement.speed_m_s, measurement.speed_std_m_s)} m/s"


def _velocity(measurement: Measurement) -> str:
    """Nothing where the ball may have stood still: the likeliest of many says little then."""
    is_known = measurement.speed_upper_m_s is None
    return _vector(measurement.velocity_m_s, "m/s") if is_known else ""


def _sign_rows(sign: Sign | None) -> Iterable[tuple[str, str]]:
    if sign is None:
        return []
    if not sign.ambiguous:
        return [("sign", f"settled by {sign.cue}, {_odds(sign.probability)}")]
    is_even = all(other.probability == sign.probability for other in sign.alternatives)
    rest = "the picture fits these directions as well:"
    if not is_even:
        rest = f"{sign.cue or 'the picture'} does not settle it; the others:"
    rows = [("sign", f"open, probability {sign.probability:.2f}; {rest}")]
    return rows + [
        ("", f"{_vector(other.direction)}, probability {other.probability:.2f}")
        for other in sign.alternatives
    ]


def _odds(probability: float) -> str:
    """Write a probability near 1 so that a reader sees how near."""
    against = 1 - probability
    if against < 1e-6:
        return "odds above a million to one"
    return f"odds {probability / against:.3g} to 1"


def _profiles(table: ProfileTable | None) -> str:
    if table is None:
        return ""
    rows = zip(table.flags, table.half_width_px, table.opacity, strict=True)
    good = [(half_width, opacity) for flag, half_width, opacity in rows if flag == 0]
    used = f"{len(good)} of {len(table.flags)} used"
    if not good:
        return used
    half_width, opacity = (median(column) for column in zip(*good, strict=True))
    return f"{used}, half width {half_width:.2f} px, opacity {opacity:.3f} (medians)"


def _fit(measurement: Measurement) -> str:
    fit = measurement.fit
    if fit is None:
        return ""
    blur = "" if fit.blur_px is None else f", lens blur {fit.blur_px:.2f} px"
    return f"chi2 per degree of freedom {fit.chi2_per_dof:.2f} over {fit.pixels} samples{blur}"


def _bound(bound: Bound | None) -> str:
    """Say the smallest standard deviations that any measurement of this picture can have."""
    if bound is None:
        return ""
    axes = " ".join(f"{a} {s:.2g}" for a, s in zip("xyz", bound.position_std_m, strict=True))
    speed = "" if bound.speed_std_m_s is None else f", speed {bound.speed_std_m_s:.2g} m/s"
    share = "" if bound.efficiency is None else f"; efficiency {bound.efficiency:.2f}"
    return f"at best {axes} m{speed}{share}"


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
