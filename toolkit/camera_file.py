"""camera.toml: a calibrated camera on disk, in OpenCV's terms, and fitting it to a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from toolkit.camera import Camera
from toolkit.errors import ConfigError, MismatchError
from toolkit.files import check_keys, read_toml, write_text
from toolkit.toml_text import to_toml
from toolkit.types import LinearImage

_REQUIRED = {
    "width": int,
    "height": int,
    "model": str,
    "fx": float,
    "fy": float,
    "cx": float,
    "cy": float,
    "distortion": list,
}
_OPTIONAL = {
    "covariance": list,
    "rms_px": float,
    "held_out_px": float,
    "views": int,
    "images": list,
    "model_scores": list,
    "gates": list,
}


def read_camera(path: Path) -> Camera:
    """Read a camera.toml.

    Args:
        path: the file; its `covariance` and the notes on how it was got may be absent.

    Returns:
        The camera of the picture size the file names; `covariance` None where the file has none.

    Raises:
        ConfigError: when the file is missing, is no camera file, or a value is unknown,
            missing or impossible.
    """
    where = str(path)
    table = read_toml(path, "camera")
    check_keys(where, table, _REQUIRED | _OPTIONAL)
    missing = [key for key in _REQUIRED if key not in table]
    if missing:
        raise ConfigError(f"{where}: {', '.join(missing)} missing; calibrate again")
    try:
        camera = Camera(
            width=table["width"],
            height=table["height"],
            model=table["model"],
            fx=_number(table["fx"]),
            fy=_number(table["fy"]),
            cx=_number(table["cx"]),
            cy=_number(table["cy"]),
            distortion=tuple(_number(value) for value in table["distortion"]),
            covariance=_covariance(table),
        )
        _check_notes(table)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None
    return camera


def write_camera(
    path: Path,
    camera: Camera,
    *,
    rms_px: float | None = None,
    views: int | None = None,
    images: Sequence[str] = (),
    held_out_px: float | None = None,
    model_scores: Sequence[str] = (),
    gates: Sequence[str] = (),
) -> None:
    """Write a camera.toml, whole or not at all.

    Args:
        path: where to; an older file is replaced.
        camera: what to write.
        rms_px: root mean square distance between the corners found and those the camera predicts;
            None where nobody knows, as of a camera that another program calibrated.
        views: how many photos were used, if known.
        images: their names.
        held_out_px: error of views left out of the fit.
        model_scores: the lenses compared, in words.
        gates: what was asked of the calibration and answered, in words.

    Raises:
        ConfigError: when a number is not finite.
        EnvironmentFault: when the place cannot be written.
    """
    table: dict[str, Any] = {
        "width": camera.width,
        "height": camera.height,
        "model": camera.model,
        **{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
        "distortion": [float(value) for value in camera.distortion],
    }
    if camera.covariance is not None:
        table["covariance"] = camera.covariance.tolist()
    notes = {
        "rms_px": rms_px,
        "held_out_px": held_out_px,
        "views": views,
        "images": list(images) or None,
        "model_scores": list(model_scores) or None,
        "gates": list(gates) or None,
    }
    table |= {key: value for key, value in notes.items() if value is not None}
    write_text(path, to_toml("camera", table))


def fit_camera(camera: Camera, image: LinearImage) -> Camera:
    """Give the camera of `image`, following a known crop or a whole-number scale.

    Other scales are refused although their shape may agree: a sensor crop of the same shape looks
    alike and has another focal length.

    Raises:
        MismatchError: when the camera was calibrated on another kind of file.
    """
    size, wanted = (image.width, image.height), (camera.width, camera.height)
    if size == wanted:
        return camera
    if image.crop is not None and image.crop[2:] == wanted:
        return camera.cropped(image.crop[0], image.crop[1], *size)
    if _is_whole_number_scale(size, wanted) or _is_whole_number_scale(wanted, size):
        return camera.resized(*size)
    sizes = f"the picture is {size[0]}x{size[1]} and the camera {wanted[0]}x{wanted[1]}"
    if size == wanted[::-1]:
        raise MismatchError(
            f"{sizes}: it was turned by 90 degrees; use the file as the camera wrote it"
        )
    raise MismatchError(
        f"{sizes}, no known crop or whole-number scale of it; calibrate from the same kind of file"
    )


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{value!r:.40} stands where a number is needed")
    try:
        return float(value)
    except OverflowError:
        raise ConfigError("a number has hundreds of digits; calibrate again") from None


def _check_notes(table: dict[str, Any]) -> None:
    """Check the keys that only people read, so that a spoilt file is noticed."""
    for key in ("rms_px", "held_out_px"):
        if not 0 <= table.get(key, 0.0) < float("inf"):
            raise ConfigError(f"{key} is {table[key]}; a finite length in pixels is needed")
    if table.get("views", 0) < 0 or not all(isinstance(n, str) for n in table.get("images", [])):
        raise ConfigError("views must be a count and images a list of names")
    for key in ("model_scores", "gates"):
        if not all(isinstance(text, str) for text in table.get(key, [])):
            raise ConfigError(f"{key} must be a list of texts")


def _covariance(table: dict[str, Any]) -> Tensor | None:
    """Give the checked covariance of [fx fy cx cy, distortion...], [4 + K, 4 + K] float64."""
    if "covariance" not in table:
        return None
    rows, size = table["covariance"], 4 + len(table["distortion"])
    if len(rows) != size or not all(isinstance(row, list) and len(row) == size for row in rows):
        raise ConfigError(f"covariance is not {size}x{size}, of [fx fy cx cy, distortion...]")
    values = [[_number(value) for value in row] for row in rows]
    covariance = torch.tensor(values, dtype=torch.float64)
    if not bool(torch.isfinite(covariance).all()):
        raise ConfigError("covariance holds a value that is not a finite number; calibrate again")
    # unit diagonal first: the entries span twelve orders of magnitude, px^2 beside k^2
    scale = covariance.diagonal().clamp_min(0).sqrt()
    scale = torch.where(scale > 0, scale, 1)
    correlation = covariance / scale / scale[:, None]
    if not torch.allclose(correlation, correlation.mT, atol=1e-6):
        raise ConfigError("covariance is not symmetric; calibrate again")
    if float(torch.linalg.eigvalsh(correlation).min()) < -1e-6:
        raise ConfigError("covariance has a negative eigenvalue, so it is none; calibrate again")
    return covariance


def _is_whole_number_scale(small: tuple[int, int], large: tuple[int, int]) -> bool:
    """Tell whether `large` is 2, 3, ... times `small`, within a pixel of the small one."""
    factor = round(large[0] / small[0])
    return factor > 1 and all(
        abs(factor * s - l) <= factor for s, l in zip(small, large, strict=True)
    )
