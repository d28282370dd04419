"""From stored brightness to light: the inverse response of a camera or a file format.

A response has one curve a channel, or none at all where brightness already is proportional to
light.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ConfigError
from toolkit.files import check_keys, one_line, read_toml

Curve = Callable[[NDArray[Any]], NDArray[Any]]
"""Maps stored brightness, white = 1, to light, white = 1."""

MAX_SAMPLES = 65536


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledCurve:
    """A measured inverse response of one channel, linear between its samples.

    Below the first sample it goes on with the first slope, so that dark noise keeps its mean; above
    the last it stays.
    """

    brightness: NDArray[np.float64]  # [K] rising
    exposure: NDArray[np.float64]  # [K] rising
    std: NDArray[np.float64]  # [K] standard deviation of the exposure

    def __call__(self, brightness: NDArray[Any]) -> NDArray[Any]:
        """Give the light of each brightness, any shape."""
        slope = (self.exposure[1] - self.exposure[0]) / (self.brightness[1] - self.brightness[0])
        below: NDArray[Any] = slope * np.minimum(brightness - self.brightness[0], 0)
        light: NDArray[Any] = np.interp(brightness, self.brightness, self.exposure) + below
        return light


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """How stored brightness becomes light."""

    name: str
    curves: tuple[Curve, Curve, Curve] | None = None  # R, G, B; None: proportional

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
    check_keys(where, table, dict.fromkeys(keys, list))
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
    return SampledCurve(brightness=brightness, exposure=exposure, std=std)


def _numbers(where: str, values: list[Any]) -> NDArray[np.float64]:
    if not 2 <= len(values) <= MAX_SAMPLES:
        raise ConfigError(f"{where} has {len(values)} values; 2 to {MAX_SAMPLES} are needed")
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        raise ConfigError(f"{where} holds something that is not a number; calibrate again")
    numbers = np.array(values, dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise ConfigError(f"{where} holds a value that is not finite; calibrate again")
    return numbers


def _named_response(name: str) -> Response:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it complains about optional plotting packages
        import colour
    names = {key.lower(): key for key in (*colour.CCTF_DECODINGS, *colour.LOG_DECODINGS)}
    if name.lower() not in names:
        near = [names[n] for n in get_close_matches(name.lower(), names, n=5, cutoff=0.4)]
        hint = (
            f"did you mean {', '.join(near)}?" if near else "give linear, srgb or a response.toml"
        )
        raise ConfigError(f"response '{name}' is neither a file nor a known curve; {hint}")
    key = names[name.lower()]
    curve = partial(_decode_named, colour.CCTF_DECODINGS.get(key) or colour.LOG_DECODINGS[key])
    _check_curve(key, curve)
    return Response(name=key, curves=(curve,) * 3)


def _decode_named(decode: Callable[..., Any], brightness: NDArray[Any]) -> NDArray[Any]:
    """Decode with a colour-science curve, scaled so that the largest stored value is white, 1."""
    with np.errstate(all="ignore"):
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
