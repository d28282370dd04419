"""A bracket: photos of one still scene that differ in nothing but their exposure time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.demosaicing import Pattern
from toolkit.errors import CalibrationError, ConfigError, ImageError, MismatchError
from toolkit.types import LinearImage

Array = NDArray[np.float64]

POSITIONS = 100_000
"""Places a channel that are looked at; the calmer half of them is kept."""
DARK, BRIGHT = 0.03, 0.97
"""Brightness between which a value counts as neither black nor white."""
FOG = 0.12
"""Brightness up to which a place may show stray light and noise alone."""
LEAST_SHARED = 200
"""Places that two photos must both show well before they are compared."""
WIDEST = 4.0
"""Stops between two exposures over which smoothness alone no longer tells the curve."""
SAME_TIME = 0.01
"""Share by which exposure times count as different."""
FAINTEST = 0.02
"""Brightness by which doubling the exposure changes what is lit, at the very least."""
STRANGE = 0.35
"""Share of places that may be out of order between photos of one scene; by chance 0.56 are."""
OUT_OF_ORDER = 0.25
"""Share of all places by which one may come earlier or later when sorted by brightness."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bracket:
    """What the photos show at the same places, by rising exposure time."""

    paths: tuple[Path, ...]  # [F]
    times: Array  # [F] s
    values: tuple[Array, Array, Array]  # R, G, B: [F, N] brightness, white = 1
    steps: tuple[float, float, float]  # between stored values
    is_raw: bool
    left_out: tuple[tuple[Path, str], ...] = ()  # photos that cannot be used, and why

    @property
    def is_grey(self) -> bool:
        """Whether all channels hold the same."""
        red, green, blue = self.values
        return np.array_equal(red, green) and np.array_equal(red, blue)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Photo:
    path: Path
    time: float
    size: tuple[int, int]
    pattern: Pattern | None
    is_raw: bool
    values: tuple[Array, ...]  # [N] a channel
    restless: tuple[Array, ...]  # [N] a channel: how much brightness changes around


def read_bracket(
    paths: Sequence[Path],
    times: Sequence[float] | None = None,
    *,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> Bracket:
    """Read the photos of a bracket; a damaged one is left out as long as two remain.

    Only calm surroundings are used: where the camera moved by a pixel they still show the same.

    Args:
        paths: of one camera on a tripod, same settings but for the time.
        times: s, in the order of the paths; those of the files when None.
        on_photo: called with each path as its photo is done.

    Raises:
        ConfigError: when times are missing, too many, too few or not positive.
        ImageError: when fewer than two photos can be read.
        MismatchError: when sizes or kinds differ.
        CalibrationError: when fewer than two exposure times differ.
    """
    _check_request(paths, times)
    photos: list[_Photo] = []
    left_out: list[tuple[Path, str]] = []
    for index, path in enumerate(paths):
        try:
            photos.append(_read(path, None if times is None else times[index]))
        except ImageError as error:
            left_out.append((path, str(error)))
        on_photo(path)
    if len(photos) < 2:
        reasons = "; ".join(reason for _, reason in left_out)
        raise ImageError(f"fewer than two photos of the bracket can be used: {reasons}")
    photos.sort(key=lambda photo: photo.time)
    _check_alike(photos)
    values = tuple(_calm_values(photos, channel) for channel in range(3))
    return Bracket(
        paths=tuple(photo.path for photo in photos),
        times=np.array([photo.time for photo in photos]),
        values=(values[0], values[1], values[2]),
        steps=(_step(values[0]), _step(values[1]), _step(values[2])),
        is_raw=photos[0].is_raw,
        left_out=tuple(left_out),
    )


def check_bracket(bracket: Bracket) -> None:
    """Raise where the pictures contradict each other or their times, naming the photos.

    Raises:
        CalibrationError: when all is clipped, or nothing links the photos.
        MismatchError: when a longer exposure is darker, or photos show different scenes.
    """
    values = bracket.values[1]
    inside = (values > DARK) & (values < BRIGHT)
    if inside.sum(1).max() < LEAST_SHARED:
        whites, blacks = float((values >= BRIGHT).mean()), float((values <= DARK).mean())
        advice = "shorter" if whites > blacks else "longer"
        raise CalibrationError(
            f"all photos are clipped: {whites:.0%} of the values are white and {blacks:.0%} black; "
            f"add {advice} exposures"
        )
    if not (np.diff(np.log2(bracket.times)) < WIDEST).any():
        raise CalibrationError(
            f"the response is not determined: all times are more than {WIDEST:.0f} stops apart; "
            "add exposures between, best each twice as long as the one before"
        )
    for first in range(len(values) - 1):
        _check_neighbours(bracket, first, inside)


def _check_neighbours(bracket: Bracket, first: int, inside: NDArray[np.bool_]) -> None:
    second = first + 1
    shared = inside[first] & inside[second]
    if shared.sum() < LEAST_SHARED:
        return
    low, high = bracket.values[1][first][shared], bracket.values[1][second][shared]
    names = [
        f"{path.name} ({time:.4g} s)"
        for path, time in zip(
            bracket.paths[first : second + 1], bracket.times[first : second + 1], strict=True
        )
    ]
    lit = high > FOG
    strange = _share_out_of_order(low[lit], high[lit]) if lit.sum() >= LEAST_SHARED else 0.0
    if strange > STRANGE and min(low.std(), high.std()) > 0.02:
        raise MismatchError(
            f"{names[0]} and {names[1]} do not show the same scene ({strange:.0%} of the places "
            "differ); use one tripod and a still scene, and leave strangers out"
        )
    ratio = bracket.times[second] / bracket.times[first]
    # most of a dark photo may be fog that no exposure changes: the places that change most tell
    fall, middle, rise = np.quantile(high - low, [0.1, 0.5, 0.9])
    if ratio > 1 + 5 * SAME_TIME and middle < 0 and -fall > 3 * max(rise, 0.004):
        raise MismatchError(
            f"{names[1]} is darker than {names[0]} although it was exposed longer; its time or "
            "the order of --times is wrong, or the light, aperture or ISO changed"
        )
    if ratio > 1.3 and rise < 0.5 * (ratio - 1) * FAINTEST and _is_lit(low):
        raise MismatchError(
            f"{names[1]} is as bright as {names[0]} although its time is {ratio:.3g} times as "
            "long; a time is wrong, or the light, aperture or ISO changed"
        )


def _share_out_of_order(first: Array, second: Array) -> float:
    """Give the share of places that are among the dark in one photo and the bright in another."""
    ranks = [np.argsort(np.argsort(values)) / len(values) for values in (first, second)]
    return float((np.abs(ranks[0] - ranks[1]) > OUT_OF_ORDER).mean())


def _is_lit(brightness: Array) -> bool:
    """Whether a good share of the places is bright enough to change with the exposure."""
    return float(np.quantile(brightness, 0.9)) > FOG


def _check_request(paths: Sequence[Path], times: Sequence[float] | None) -> None:
    if times is not None and len(times) != len(paths):
        raise ConfigError(
            f"--times has {len(times)} values for {len(paths)} photos; give one for each, in order"
        )
    for time in times or ():
        if not 0 < time < 1e5:
            raise ConfigError(f"--times: {time:g} is no exposure time; give seconds above 0")
    if len(set(paths)) < len(paths):
        twice = next(path for path in paths if list(paths).count(path) > 1)
        raise ConfigError(f"{twice} is named twice; name every photo once")
    if len(paths) < 2:
        raise CalibrationError(
            "one photo tells nothing of the response; add photos of the same scene with other "
            "exposure times, best five to seven, each twice as long as the one before"
        )


def _read(path: Path, time: float | None) -> _Photo:
    from toolkit.imaging import read_image

    image = read_image(path, response="linear")
    if time is None and image.exposure is None:
        raise ConfigError(f"{path} states no exposure time; give all with --times t1,t2,...")
    planes = [_plane(image, channel) for channel in range(3)]
    places = [_positions(plane.shape) for plane in planes]
    return _Photo(
        path=path,
        time=float(image.exposure[0]) if time is None and image.exposure is not None else time or 0,
        size=(image.width, image.height),
        pattern=image.pattern,
        is_raw=image.pattern is not None,
        values=tuple(
            plane[place].ravel().astype(float) for plane, place in zip(planes, places, strict=True)
        ),
        restless=tuple(
            _restless(plane)[place].ravel() for plane, place in zip(planes, places, strict=True)
        ),
    )


def _plane(image: LinearImage, channel: int) -> NDArray[np.float32]:
    """Give one channel as recorded: of a mosaic its first site in every period."""
    if image.mosaic is None or image.pattern is None:
        return np.asarray(image.rgb[0, channel])
    period = np.array(image.pattern)
    row, column = np.argwhere(period == channel)[0]
    return np.ascontiguousarray(
        image.mosaic[0, 0].numpy()[row :: len(period), column :: len(period)]
    )


def _positions(shape: tuple[int, ...]) -> tuple[slice, slice]:
    step = max(1, int((shape[0] * shape[1] / POSITIONS) ** 0.5))
    return slice(1, -1, step), slice(1, -1, step)


def _restless(plane: NDArray[np.float32]) -> Array:
    smooth = cv2.blur(plane, (3, 3))
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    return np.asarray(cv2.magnitude(across, down), dtype=np.float64)


def _calm_values(photos: Sequence[_Photo], channel: int) -> Array:
    restless = np.sum([photo.restless[channel] for photo in photos], axis=0)
    values = np.stack([photo.values[channel] for photo in photos])
    told = ((values > DARK) & (values < BRIGHT)).sum(0) > 1
    limit = np.median(restless[told]) if told.any() else np.inf
    calm: Array = values[:, (restless <= limit) | ~told]
    return calm


def _step(values: Array) -> float:
    """Give the least difference between stored values."""
    levels = np.unique(values[:, :4000].astype(np.float32))
    apart = np.diff(levels)
    apart = apart[apart > 1e-6]
    return float(apart.min()) if apart.size else 1 / 255


def _check_alike(photos: Sequence[_Photo]) -> None:
    kinds = [(photo.size, photo.pattern) for photo in photos]
    usual = max(kinds, key=kinds.count)
    for photo, kind in zip(photos, kinds, strict=True):
        if kind != usual:
            (width, height), _ = usual
            raise MismatchError(
                f"{photo.path} has {photo.size[0]}x{photo.size[1]} px or is of another kind, the "
                f"others have {width}x{height}; use photos of one camera setting"
            )
    shortest, longest = photos[0].time, photos[-1].time
    if longest < shortest * (1 + 5 * SAME_TIME):
        raise CalibrationError(
            f"all photos were exposed equally long ({shortest:.4g} s); the response needs other "
            "times, best five to seven, each twice as long as the one before"
        )
