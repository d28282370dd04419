"""Kalibr's camchain.yaml: one or several cameras, cam0, cam1, ...

Source: Kalibr's wiki, "yaml formats" and "supported models". Its pixels are OpenCV's.
"""

import re
from functools import partial

from calibration.formats.foreign import (
    Cameras,
    ForeignCamera,
    four_polynomial,
    numbers,
    size,
    yaml_list,
)
from calibration.formats.plain_yaml import Plain, parse_yaml
from toolkit.camera import Camera
from toolkit.errors import ConfigError

NAME = "kalibr"
LENSES = {"radtan": "pinhole", "equidistant": "fisheye", "equi": "fisheye", "none": "pinhole"}
LEFT_OUT = {
    "T_cn_cnm1": "its place beside the other cameras",
    "T_cam_imu": "its place beside the IMU",
    "timeshift_cam_imu": "its time beside the IMU",
}


def looks_alike(text: str) -> bool:
    """Tell whether a text could be such a file."""
    return re.search(r"^cam\d+\s*:", text, re.MULTILINE) is not None


def parse(text: str) -> Cameras:
    """Give all cameras.

    Raises:
        ConfigError: where it is no camchain, or a model is one that no camera.toml holds.
    """
    table = parse_yaml(text)
    if not isinstance(table, dict):
        raise ConfigError("there is no cam0 in it, so it is no camchain of Kalibr")
    named = {key: value for key, value in table.items() if re.fullmatch(r"cam\d+", key)}
    return {name: partial(_camera, name, section) for name, section in named.items()}


def compose(camera: Camera, name: str) -> str:
    """Write one camera as cam0.

    Raises:
        MismatchError: where the lens has more terms than Kalibr's.
    """
    if camera.model == "fisheye":
        lens, distortion = "equidistant", list(camera.distortion)
    elif camera.distortion:
        lens, distortion = "radtan", four_polynomial(camera, "Kalibr's radtan")
    else:
        lens, distortion = "none", []
    inner = [camera.fx, camera.fy, camera.cx, camera.cy]
    return (
        "cam0:\n"
        "  cam_overlaps: []\n"
        "  camera_model: pinhole\n"
        f"  distortion_coeffs: {yaml_list(distortion)}\n"
        f"  distortion_model: {lens}\n"
        f"  intrinsics: {yaml_list(inner)}\n"
        f"  resolution: {[camera.width, camera.height]}\n"
        f"  rostopic: /{re.sub(r'[^A-Za-z0-9_]', '_', name)}/image_raw\n"
    )


def _camera(name: str, section: Plain) -> ForeignCamera:
    if not isinstance(section, dict):
        raise ConfigError(f"{name} is empty; a camera of Kalibr has camera_model, intrinsics ...")
    needed = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution")
    missing = [key for key in needed if key not in section]
    if missing:
        raise ConfigError(
            f"{name} lacks {', '.join(missing)}; give the camchain as Kalibr wrote it"
        )
    model, lens = section["camera_model"], section["distortion_model"]
    if model != "pinhole" or not isinstance(lens, str) or lens not in LENSES:
        raise ConfigError(
            f"{name} is {model!s:.20}-{lens!s:.20}, which no camera.toml holds; calibrate as "
            "pinhole-radtan or pinhole-equi"
        )
    coefficients = numbers(
        section["distortion_coeffs"] or [], f"{name}: distortion_coeffs", 0 if lens == "none" else 4
    )
    fx, fy, cx, cy = numbers(section["intrinsics"], f"{name}: intrinsics", 4)
    width, height = size(
        numbers(section["resolution"], f"{name}: resolution", 2), f"{name}: resolution"
    )
    camera = Camera(
        width=width,
        height=height,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=tuple(coefficients),
        model=LENSES[lens],
    )
    left_out = tuple(what for key, what in LEFT_OUT.items() if key in section)
    return ForeignCamera(camera=camera, name=name, left_out=left_out)
