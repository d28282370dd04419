"""The inverse response of a camera from a bracket: curve, standard deviation and checks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.brackets import Bracket, check_bracket, read_bracket
from calibration.curve_fit import CurveFit, fit_curve
from toolkit.errors import CalibrationError, MismatchError
from toolkit.measurement import Caution
from toolkit.response import SampledCurve

Array = NDArray[Any]

SAMPLES = 256
MODES = 8
"""Most ways of erring that are kept of a curve."""
JUDGED = (12 / 255, 243 / 255)
"""Brightness between which the curve must be known."""
MOST_DOUBT = 0.02
"""Standard deviation of the light, white = 1, from which a curve is not determined."""
WRONG_TIME = 0.2
"""Stops by which a time may contradict the pictures: shutters are marked in rounded numbers."""
STRANGE = 0.3
"""Share of places that may contradict a photo before it counts as another scene."""
STRAYS = 1.0
"""Stops by which a place may differ in one photo before it counts as changed, or as a border."""
ROUNDED = 0.1
"""Stops by which marked times differ from exact ones at most."""
STRAIGHT = 0.01
"""Relative departure up to which light counts as proportional to brightness."""
FEW = 500
"""Values from which a photo's own time is judged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelFit:
    """One channel's curve and how it fits."""

    curve: SampledCurve
    seen: tuple[float, float]  # brightness between which photos overlap
    time_errors: Array  # [F] stops by which each exposure looks longer than stated; NaN: too few
    residual: float  # stops rms, of all single values between the other photos' light and this
    misfit: float  # squared, over noise
    bend: float  # largest relative departure from proportional light between 0.1 and 0.9
    linear_up_to: float  # brightness up to which light is proportional to 1 %; 0: nowhere

    @property
    def largest_std(self) -> float:
        """Largest standard deviation of the light where the curve was seen, white = 1."""
        inside = (self.curve.brightness >= self.seen[0]) & (self.curve.brightness <= self.seen[1])
        return float(self.curve.std[inside].max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredResponse:
    """The inverse response of a camera, and what it was found from."""

    bracket: Bracket
    channels: tuple[ChannelFit, ChannelFit, ChannelFit]
    warnings: tuple[Caution, ...] = ()

    @property
    def curves(self) -> tuple[SampledCurve, SampledCurve, SampledCurve]:
        """R, G, B."""
        red, green, blue = self.channels
        return red.curve, green.curve, blue.curve

    @property
    def time_errors(self) -> Array:
        """Stops by which each exposure looks longer than stated [F]; not a number: too few told."""
        return _time_errors_of(self.channels)

    @property
    def bend(self) -> float:
        """Largest relative departure from proportional light of any channel."""
        return max(channel.bend for channel in self.channels)

    @property
    def is_linear(self) -> bool:
        """Whether the photos are RAW and need no curve."""
        return self.bracket.is_raw and self.bend <= 2 * STRAIGHT


def measure_response(
    paths: Sequence[Path],
    times: Sequence[float] | None = None,
    *,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> MeasuredResponse:
    """Recover the inverse response from photos of one still scene, differently long exposed.

    The curve is known up to one factor and scaled so that white is 1.

    Args:
        paths: of the photos, JPEG, PNG, TIFF or RAW.
        times: exposure times in seconds, in the order of the paths; from the files when None.
        on_photo: called with each path as its photo is read.

    Raises:
        ConfigError: when times are missing or impossible.
        ImageError: when fewer than two photos can be read.
        MismatchError: when photos or times contradict each other.
        CalibrationError: when the curve is not determined; the text says what to add.
    """
    bracket = read_bracket(paths, times, on_photo=on_photo)
    check_bracket(bracket)
    bracket, marked = _with_true_times(bracket)
    if bracket.is_grey:
        one = fit_channel(bracket, 0)
        channels = (one, one, one)
    else:
        channels = (fit_channel(bracket, 0), fit_channel(bracket, 1), fit_channel(bracket, 2))
    left_out = [
        Caution(code="photo-left-out", message=f"{path.name}: left out: {reason}")
        for path, reason in bracket.left_out
    ]
    errors = _time_errors_of(channels)
    _check_times(bracket, errors)
    for name, channel in zip("RGB", channels, strict=True):
        _check_determined(name, channel.curve, channel.seen)
    doubts = _time_doubts(bracket, errors)
    return MeasuredResponse(
        bracket=bracket, channels=channels, warnings=(*left_out, *marked, *doubts)
    )


def exact_times(times: Array) -> Array | None:
    """Give the times that a shutter marked in thirds of a stop really has; None for other times.

    Shutters are marked in rounded numbers: 1/60 s stands for 1/64 s, 1/15 s for 1/16 s.
    """
    exact: Array = 2 ** (np.round(3 * np.log2(times)) / 3)
    off = np.abs(np.log2(times / exact))
    return exact if (off < ROUNDED).all() and off.max() > 1e-3 else None


def _with_true_times(bracket: Bracket) -> tuple[Bracket, list[Caution]]:
    """Take the times as exact stops where that explains the pictures far better."""
    exact = exact_times(bracket.times)
    if exact is None:
        return bracket, []
    other = replace(bracket, times=exact)
    stated, meant = (_spread_of(one) for one in (bracket, other))
    if not meant < stated / 2:
        return bracket, []
    text = (
        f"the times fit the pictures better as exact stops than as stated ({meant:.3f} instead of "
        f"{stated:.3f} stops off, rms), as where 1/60 s stands for 1/64 s; so they were taken"
    )
    return other, [Caution(code="times-rounded", message=text)]


def _spread_of(bracket: Bracket) -> float:
    errors = fit_channel(bracket, 1).time_errors
    return float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else np.inf


def fit_channel(bracket: Bracket, channel: int) -> ChannelFit:
    """Find one channel's curve, however well it is determined.

    Raises:
        MismatchError: when a photo contradicts the others.
        CalibrationError: when too few places link the photos.
    """
    values, name = bracket.values[channel], "RGB"[channel]
    inside = (values > JUDGED[0]) & (values < JUDGED[1])
    if np.count_nonzero(inside.sum(0) > 1) < FEW:
        raise CalibrationError(
            f"the response is not determined: too few places are neither black nor white in two "
            f"photos (channel {name}); add exposures between those given"
        )
    fit = fit_curve(values, bracket.times, bracket.steps[channel])
    errors, residual = _time_errors(fit, values)
    _check_scene(bracket, fit)
    curve, seen = sampled_curve(fit, errors)
    return ChannelFit(
        curve=curve,
        seen=seen,
        time_errors=errors,
        residual=residual,
        misfit=fit.misfit,
        bend=_bend(curve),
        linear_up_to=_linear_up_to(curve, seen[1]),
    )


def sampled_curve(
    fit: CurveFit, time_errors: Array | None = None
) -> tuple[SampledCurve, tuple[float, float]]:
    """Tabulate the inverse of a fitted curve with its standard deviation.

    A common factor is no error of a response: the deviation is what is left once the best factor is
    taken out, between the brightnesses seen.

    Args:
        fit: of one channel.
        time_errors: [F] stops; what they tell of all times' trust adds doubt in the exponent.

    Returns:
        The curve, and the brightnesses between which photos overlap.
    """
    low, high = (float(fit.curve.at(place)[0]) for place in fit.span)
    brightness = np.linspace(0, 1, SAMPLES)
    stops = fit.curve.inverse(brightness)
    light = _rising(brightness, 2 ** (stops - stops[-1]), max(low, float(fit.curve.brightness[0])))
    change = _changes(fit, stops, time_errors) * light[:, None]
    inside = (brightness >= low) & (brightness <= high)
    change -= np.outer(light, light[inside] @ change[inside]) / (light[inside] @ light[inside])
    # darker than was seen the line through black is a guess
    change[brightness < low] = 0
    std = np.sqrt((change**2).sum(1))
    std[brightness < low] = light[brightness < low]
    ways, sizes, _ = np.linalg.svd(change, full_matrices=False)
    modes = (ways * sizes)[:, :MODES].T
    curve = SampledCurve(brightness=brightness, exposure=light / light[-1], std=std, modes=modes)
    return curve, (low, high)


def _changes(fit: CurveFit, stops: Array, time_errors: Array | None) -> Array:
    """Give independent relative changes of the light [K, X], each of one standard deviation."""
    slope = np.maximum(fit.curve.at(stops)[1], 1e-6)
    J = -fit.curve.rows(fit.curve.J_brightness(), stops) / slope[:, None]
    spread, ways = np.linalg.eigh(fit.covariance)
    change: Array = np.log(2) * J @ (ways * np.sqrt(np.maximum(spread, 0)))
    if time_errors is None:
        return change
    known = time_errors[np.isfinite(time_errors)]
    lever = float(((fit.stops - fit.stops.mean()) ** 2).sum()) ** 0.5
    exponent = float(np.sqrt((known**2).sum() / max(len(known) - 2, 1))) / lever
    return np.column_stack([change, np.log(2) * exponent * (stops - stops.mean())])


def _rising(brightness: Array, light: Array, darkest: float) -> Array:
    """Continue to black along a line below what was seen; all values rise."""
    first = int(np.searchsorted(brightness, darkest))
    first = min(max(first, 1), len(light) - 2)
    line = light[first] * brightness / brightness[first]
    whole = np.where(brightness < brightness[first], line, light)
    rising: Array = np.maximum.accumulate(whole) + 1e-12 * np.arange(len(whole))
    return rising


def _time_errors(fit: CurveFit, values: Array) -> tuple[Array, float]:
    """Give by how many stops each frame looks longer exposed than stated, and the rms of all."""
    inside = (values > 0.1) & (values < 0.9)
    told = inside.sum(0) > 1
    inside, values = inside[:, told], values[:, told]
    light = fit.curve.inverse(values) - fit.stops[:, None]
    count = inside.sum(0)
    mean = np.where(inside, light, 0).sum(0) / count
    # of a value against the mean of the others; what strays is no matter of time
    off = (light - mean) * (count / (count - 1))
    inside = inside & ~(inside & (np.abs(off) > STRAYS)).any(0)
    errors = np.array(
        [
            float(np.median(row[at])) if np.count_nonzero(at) >= FEW else np.nan
            for row, at in zip(off, inside, strict=True)
        ]
    )
    return errors, float(np.sqrt(np.mean((light - mean)[inside] ** 2)))


def _check_times(bracket: Bracket, errors: Array) -> None:
    known = np.where(np.isfinite(errors), np.abs(errors), 0)
    worst = int(np.argmax(known))
    if known[worst] <= WRONG_TIME:
        return
    time = bracket.times[worst]
    raise MismatchError(
        f"the times contradict the pictures: {bracket.paths[worst].name} states {time:.4g} s but "
        f"looks like {time * 2 ** errors[worst]:.4g} s beside the others; correct --times, or "
        "leave it out (light, aperture and ISO must stay the same)"
    )


def _check_scene(bracket: Bracket, fit: CurveFit) -> None:
    strange = fit.groups.strange
    worst = int(np.argmax(strange))
    if strange[worst] > STRANGE:
        raise MismatchError(
            f"{bracket.paths[worst].name} does not fit the others at {strange[worst]:.0%} of its "
            "places: the scene or the camera moved, or its time is wrong; correct or leave it out"
        )


def _check_determined(name: str, curve: SampledCurve, seen: tuple[float, float]) -> None:
    if seen[0] > 0.1:
        raise CalibrationError(
            f"the response is not determined below brightness {seen[0]:.2f} (channel {name}); add "
            "exposures half as long, or a darker part of the scene"
        )
    if seen[1] < 0.9:
        raise CalibrationError(
            f"the response is not determined above brightness {seen[1]:.2f} (channel {name}); add "
            "exposures twice as long, or a brighter part of the scene"
        )
    inside = (curve.brightness > max(JUDGED[0], seen[0])) & (curve.brightness < JUDGED[1])
    doubt = float(curve.std[inside].max())
    if doubt > MOST_DOUBT:
        raise CalibrationError(
            f"the response is not determined: its light is known to {doubt:.3f} of white only "
            f"(channel {name}); add more exposures, each twice as long as the one before"
        )


def _time_errors_of(channels: Sequence[ChannelFit]) -> Array:
    """Give the middle of what the channels tell of each time: it is wrong in all or in none."""
    errors = np.stack([channel.time_errors for channel in channels])
    known = np.isfinite(errors).any(0)
    middle = np.full(errors.shape[1], np.nan)
    middle[known] = np.nanmedian(errors[:, known], axis=0)
    return middle


def _time_doubts(bracket: Bracket, errors: Array) -> list[Caution]:
    """Warn where a stated time is off by more than shutters usually are."""
    return [
        Caution(
            code="time-doubted",
            message=f"{path.name} looks exposed {error:+.2f} stops other than its {time:.4g} s; "
            "is the light steady?",
        )
        for path, time, error in zip(bracket.paths, bracket.times, errors, strict=True)
        if abs(error) > WRONG_TIME / 2
    ]


def _linear_up_to(curve: SampledCurve, highest: float) -> float:
    """Give the brightness up to which the line of the lower half holds, as far as was seen."""
    lower = (curve.brightness >= 0.1) & (curve.brightness <= 0.5)
    b, light = curve.brightness, curve.exposure
    factor = float((b * light)[lower].sum() / (light * light)[lower].sum())
    judged = (b >= 0.1) & (b <= highest)
    departs = np.abs(factor * light[judged] / b[judged] - 1) > STRAIGHT
    if not departs.any():
        return highest
    first = int(np.argmax(departs))
    return 0.0 if first == 0 else float(b[judged][first - 1])


def _bend(curve: SampledCurve) -> float:
    """Give the largest relative departure from the best line through black, from 0.1 to 0.9."""
    inside = (curve.brightness >= 0.1) & (curve.brightness <= 0.9)
    b, light = curve.brightness[inside], curve.exposure[inside]
    factor = float((b * light).sum() / (light * light).sum())
    return float(np.abs(factor * light / b - 1).max())
