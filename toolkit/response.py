"""From stored brightness to light: the inverse response of a camera or a file format.

A response has one curve a channel, or none at all where brightness already is proportional to
light.
"""

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ConfigError
from toolkit.files import check_keys, one_line, read_toml, write_text
from toolkit.toml_text import to_toml

Curve = Callable[[NDArray[Any]], NDArray[Any]]
"""Maps stored brightness, white = 1, to light, white = 1."""

MAX_SAMPLES = 65536
MAX_MODES = 64

NICKNAMES = {
    "rec709": "ITU-R BT.709",
    "rec601": "ITU-R BT.601",
    "rec2020": "ITU-R BT.2020",
    "HLG": "ARIB STD-B67",  # of the scene's light; BT.2100 HLG gives that of a display
    "C-Log": "Canon Log",
    "C-Log2": "Canon Log 2",
    "C-Log3": "Canon Log 3",
    "LogC": "ARRI LogC3",
    "Apple Log": "Apple Log Profile",
}
"""Names by which cameras and programs call curves that colour-science calls otherwise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledCurve:
    """A measured inverse response of one channel, linear between its samples.

    Below the first sample it goes on with the first slope, so that dark noise keeps its mean; above
    the last it stays.
    """

    brightness: NDArray[np.float64]  # [K] rising
    exposure: NDArray[np.float64]  # [K] rising
    std: NDArray[np.float64]  # [K] standard deviation of the exposure, but for a common factor
    # [M, K] the largest independent ways in which the exposure may err, by one standard deviation
    # each; None where a file tells only their sum: then all samples err together
    modes: NDArray[np.float64] | None = None

    @property
    def changes(self) -> NDArray[np.float64]:
        """Independent changes of the exposure, one standard deviation each [M, K]."""
        return self.std[None] if self.modes is None else self.modes

    def __call__(self, brightness: NDArray[Any]) -> NDArray[Any]:
        """Give the light of each brightness, any shape."""
        slope = (self.exposure[1] - self.exposure[0]) / (self.brightness[1] - self.brightness[0])
        below: NDArray[Any] = slope * np.minimum(brightness - self.brightness[0], 0)
        light: NDArray[Any] = np.interp(brightness, self.brightness, self.exposure) + below
        return light


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveDoubt:
    """How the light of a picture may be wrong because its response was measured."""

    light: NDArray[np.float64]  # [3, K] rising, as decoded
    changes: NDArray[np.float64]  # [M, 3, K] of it, independent, one standard deviation each

    @staticmethod
    def of(curves: "Sequence[SampledCurve]") -> "CurveDoubt":
        """Join the curves of R, G, B; what was measured in one channel errs in it alone.

        Three equal curves, those of a grey bracket, err as one.
        """
        grid = np.union1d(
            np.union1d(curves[0].brightness, curves[1].brightness), curves[2].brightness
        )
        light = np.stack([np.interp(grid, c.brightness, c.exposure) for c in curves])
        own = [np.stack([np.interp(grid, c.brightness, row) for row in c.changes]) for c in curves]
        if all(_are_equal(curves[0], c) for c in curves[1:]):
            return CurveDoubt(light=light, changes=np.stack([own[0]] * 3, axis=1))
        changes = []
        for channel, rows in enumerate(own):
            apart = np.zeros((len(rows), 3, len(grid)))
            apart[:, channel] = rows
            changes.append(apart)
        return CurveDoubt(light=light, changes=np.concatenate(changes))

    def change(self, light: NDArray[Any], mode: int, channel: int) -> NDArray[np.float64]:
        """Give the change of one channel's light, any shape, by one way of erring."""
        changed: NDArray[np.float64] = np.interp(
            light, self.light[channel], self.changes[mode, channel]
        )
        return changed

    def exponent_std(self) -> float:
        """Give the standard deviation of the light's exponent that all changes amount to."""
        total = 0.0
        for change in self.changes:
            bend = self.light * np.log(np.maximum(self.light, 1e-3))
            # a common factor is no exponent
            flat = self.light * (bend * self.light).sum() / (self.light**2).sum()
            total += float((change * (bend - flat)).sum() / ((bend - flat) ** 2).sum()) ** 2
        return math.sqrt(total)


def _are_equal(first: SampledCurve, second: SampledCurve) -> bool:
    pairs = zip(
        (first.brightness, first.exposure, first.changes),
        (second.brightness, second.exposure, second.changes),
        strict=True,
    )
    return all(np.array_equal(one, other) for one, other in pairs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """How stored brightness becomes light."""

    name: str
    curves: tuple[Curve, Curve, Curve] | None = None  # R, G, B; None: proportional

    def doubt(self) -> "CurveDoubt | None":
        """Give how measured curves may err, by light; None where nothing was measured."""
        curves = [curve for curve in self.curves or () if isinstance(curve, SampledCurve)]
        if len(curves) < 3 or not any(curve.std.any() for curve in curves):
            return None
        return CurveDoubt.of(curves)

    def light(self, brightness: NDArray[Any], channel: int) -> NDArray[np.float32]:
        """Give the light of one channel's brightness, white = 1, any shape."""
        if self.curves is None:
            return brightness.astype(np.float32, copy=False)
        return self.curves[channel](brightness).astype(np.float32)

    def decode(self, stored: NDArray[Any]) -> NDArray[np.float32]:
        """Turn a stored picture into light.

        Args:
            stored: [H, W] or [H, W, 3]; integers are shares of their type's largest value, floats
                are taken as they are.

        Returns:
            Light [3, H, W]; a grey picture gets three equal channels only when the curves are
            equal.
        """
        planes = [stored[..., c] if stored.ndim == 3 else stored for c in range(3)]
        rgb = np.empty((3, *stored.shape[:2]), np.float32)
        for channel, plane in enumerate(planes):
            rgb[channel] = self._decode_plane(plane, channel)
        return rgb

    def _decode_plane(self, plane: NDArray[Any], channel: int) -> NDArray[np.float32]:
        if plane.dtype.kind == "f":
            return self.light(plane, channel)
        white = np.iinfo(plane.dtype).max
        if self.curves is None:
            return plane.astype(np.float32) * np.float32(1 / white)
        table = self.light(np.arange(white + 1) / white, channel)
        if plane.dtype == np.uint8:  # OpenCV looks bytes up several times faster than numpy
            return np.asarray(cv2.LUT(np.ascontiguousarray(plane), table), dtype=np.float32)
        return np.take(table, plane)


LINEAR = Response(name="linear")


def decode_srgb(brightness: NDArray[Any]) -> NDArray[Any]:
    """Undo the sRGB transfer function; negative values stay on its linear part.

    Source: IEC 61966-2-1. Deviation: none.
    """
    curved = ((np.maximum(brightness, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(brightness <= 0.04045, brightness / 12.92, curved)


def load_response(spec: str | Path) -> Response:
    """Find a response by its name or read it from a file.

    Args:
        spec: "linear", "srgb", the name of a colour-science decoding curve in any case, or the path
            of a response.toml.

    Raises:
        ConfigError: when the name is unknown (the nearest ones are listed) or the file is not a
            response.
    """
    name = str(spec)
    if name.lower() == "linear":
        return LINEAR
    if name.lower() == "srgb":
        return Response(name="srgb", curves=(decode_srgb,) * 3)
    if isinstance(spec, Path) or name.endswith(".toml") or Path(name).is_file():
        return _read_response(Path(spec))
    return _named_response(name)


def _read_response(path: Path) -> Response:
    table = read_toml(path, "response")
    check_keys(str(path), table, {"channels": dict, "provenance": dict})
    channels = table.get("channels", {})
    check_keys(f"{path} [channels]", channels, dict.fromkeys("rgb", dict))
    missing = [c for c in "rgb" if c not in channels]
    if missing:
        raise ConfigError(f"{path} lacks [channels.{missing[0]}]; calibrate the response again")
    r, g, b = (_sampled_curve(f"{path} [channels.{c}]", channels[c]) for c in "rgb")
    return Response(name=str(path), curves=(r, g, b))


def _sampled_curve(where: str, table: dict[str, Any]) -> SampledCurve:
    keys = ("brightness", "exposure", "std")
    check_keys(where, table, dict.fromkeys([*keys, "modes"], list))
    missing = [key for key in keys if key not in table]
    if missing:
        raise ConfigError(f"{where} lacks '{missing[0]}'; calibrate the response again")
    brightness, exposure, std = (_numbers(f"{where} {key}", table[key]) for key in keys)
    if not brightness.size == exposure.size == std.size:
        raise ConfigError(
            f"{where}: brightness, exposure and std have {brightness.size}, {exposure.size} "
            f"and {std.size} values; they need equally many"
        )
    for key, values in (("brightness", brightness), ("exposure", exposure)):
        if values.min() < 0 or values.max() > 1 or np.diff(values).min() <= 0:
            raise ConfigError(f"{where}: '{key}' does not rise from 0 to 1; calibrate again")
    if std.min() < 0:
        raise ConfigError(f"{where}: 'std' has a negative value; calibrate the response again")
    modes = _modes(f"{where} modes", table["modes"], std.size) if "modes" in table else None
    return SampledCurve(brightness=brightness, exposure=exposure, std=std, modes=modes)


def _modes(where: str, rows: list[Any], size: int) -> NDArray[np.float64]:
    if not 1 <= len(rows) <= MAX_MODES or not all(isinstance(row, list) for row in rows):
        raise ConfigError(f"{where}: 1 to {MAX_MODES} lists are needed; calibrate again")
    modes = [_numbers(where, row) for row in rows]
    if any(mode.size != size for mode in modes):
        raise ConfigError(f"{where}: each list needs {size} values; calibrate again")
    return np.stack(modes)


def _numbers(where: str, values: list[Any]) -> NDArray[np.float64]:
    if not 2 <= len(values) <= MAX_SAMPLES:
        raise ConfigError(f"{where} has {len(values)} values; 2 to {MAX_SAMPLES} are needed")
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        raise ConfigError(f"{where} holds something that is not a number; calibrate again")
    numbers = np.array(values, dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise ConfigError(f"{where} holds a value that is not finite; calibrate again")
    return numbers


def write_response(
    path: Path, curves: Sequence[SampledCurve], provenance: Mapping[str, Any]
) -> None:
    """Write measured curves of R, G, B as a response.toml, whole or not at all."""
    table: dict[str, Any] = {"provenance": dict(provenance)} if provenance else {}
    for name, curve in zip("rgb", curves, strict=True):
        table[f"channels.{name}"] = {
            "brightness": curve.brightness.tolist(),
            "exposure": curve.exposure.tolist(),
            "std": curve.std.tolist(),
            **({} if curve.modes is None else {"modes": curve.modes.tolist()}),
        }
    write_text(path, to_toml("response", table))


def curve_names() -> list[str]:
    """List the curves that `load_response` knows by name, those that rise with brightness."""
    usable = []
    for name in sorted(_decodings(), key=str.lower):
        try:
            _named_response(name)
        except ConfigError:
            continue
        usable.append(name)
    return ["linear", "srgb", *(name for name in usable if name != "sRGB")]


def _decodings() -> dict[str, Callable[..., Any]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it complains about optional plotting packages
        import colour
    return {**colour.LOG_DECODINGS, **colour.CCTF_DECODINGS}


def _plain(name: str) -> str:
    """Reduce a name to its letters and digits: BT.709, bt709 and BT 709 are the same."""
    return "".join(c for c in name.lower() if c.isalnum())


def _known_as(names: Iterable[str]) -> dict[str, str]:
    """Give the full name for each natural one: without maker's or standard's prefix too."""
    known = {_plain(short): full for short, full in NICKNAMES.items()}
    for name in names:
        for prefix in ("ITU-R ", "ITU-T ", "ARRI ", "SMPTE "):
            known.setdefault(_plain(name.removeprefix(prefix)), name)
    return known | {_plain(name): name for name in names}


def _named_response(name: str) -> Response:
    decodings = _decodings()
    known = _known_as(decodings)
    key = known.get(_plain(name))
    if key is None:
        close = get_close_matches(_plain(name), known, n=8, cutoff=0.4)
        near = list(dict.fromkeys(known[one] for one in close))[:5]
        hint = (
            f"did you mean {', '.join(near)}?" if near else "give linear, srgb or a response.toml"
        )
        raise ConfigError(f"response '{name}' is neither a file nor a known curve; {hint}")
    curve = partial(_decode_named, decodings[key])
    _check_curve(key, curve)
    return Response(name=key, curves=(curve,) * 3)


def _decode_named(decode: Callable[..., Any], brightness: NDArray[Any]) -> NDArray[Any]:
    """Decode with a colour-science curve, scaled so that the largest stored value is white, 1."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # some curves have remarks about displays
        light = np.array(decode(np.append(brightness.ravel(), 1.0)), dtype=np.float64)
        scaled: NDArray[Any] = light[:-1] / light[-1]
    return scaled.reshape(brightness.shape)


def _check_curve(name: str, curve: Curve) -> None:
    try:
        light = curve(np.linspace(0, 1, 256))
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"response '{name}' needs more than a brightness ({one_line(error)}); choose another"
        ) from None
    if not np.isfinite(light).all() or np.diff(light).min() < 0:
        raise ConfigError(f"response '{name}' does not rise with brightness; choose another")
