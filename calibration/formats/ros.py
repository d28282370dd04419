"""ROS's camera_info: the YAML of camera_calibration, and the message as `rostopic echo` prints it.

Source: sensor_msgs/CameraInfo, and camera_calibration_parsers. Its pixels are OpenCV's.
"""

import re

from calibration.formats.foreign import (
    Cameras,
    ForeignCamera,
    focal_and_centre,
    matrix_rows,
    numbers,
    polynomial_model,
    size,
    yaml_list,
)
from calibration.formats.plain_yaml import Plain, parse_yaml
from toolkit.camera import Camera
from toolkit.errors import ConfigError

NAME = "ros"
# as the file names it, and as the message does
KEYS = {
    "image_width": "width",
    "image_height": "height",
    "camera_matrix": "K",
    "distortion_coefficients": "D",
    "rectification_matrix": "R",
    "projection_matrix": "P",
}
NEEDED = (*list(KEYS)[:4], "distortion_model")
FISHEYES = ("equidistant", "fisheye")
POLYNOMIALS = ("plumb_bob", "rational_polynomial")


def looks_alike(text: str) -> bool:
    """Tell whether a text could be such a file."""
    return re.search(r"^\s*distortion_model\s*:", text, re.MULTILINE) is not None


def parse(text: str) -> Cameras:
    """Give the camera.

    Raises:
        ConfigError: where it is no camera_info, or a model that no camera.toml holds.
    """
    table = _table(parse_yaml(text))
    missing = [key for key in NEEDED if table.get(key) is None]
    if missing:
        raise ConfigError(f"{', '.join(missing)} missing, so it is no camera_info of ROS")
    width, height = size([table["image_width"], table["image_height"]], "image_width, image_height")
    matrix = _matrix(table, "camera_matrix", 9)
    if matrix[0] == 0:
        raise ConfigError("its camera_matrix is all zero: ROS says so of a camera not calibrated")
    model, distortion = _lens(table)
    fx, fy, cx, cy = focal_and_centre(matrix, "camera_matrix")
    camera = Camera(
        width=width,
        height=height,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=distortion,
        model=model,
    )
    name = str(table.get("camera_name") or "camera")
    found = ForeignCamera(camera=camera, name=name, left_out=_left_out(table, matrix))
    return {name: lambda: found}


def compose(camera: Camera, name: str) -> str:
    """Write one camera; every lens there is has a model."""
    model, distortion = _ros_lens(camera)
    matrix = [value for row in matrix_rows(camera) for value in row]
    projection = [value for row in matrix_rows(camera) for value in (*row, 0.0)]
    straight = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return (
        f"image_width: {camera.width}\n"
        f"image_height: {camera.height}\n"
        f"camera_name: {re.sub(r'[^A-Za-z0-9_]', '_', name)}\n"
        + _block("camera_matrix", 3, 3, matrix)
        + f"distortion_model: {model}\n"
        + _block("distortion_coefficients", 1, len(distortion), distortion)
        + _block("rectification_matrix", 3, 3, straight)
        + _block("projection_matrix", 3, 4, projection)
    )


def _block(key: str, rows: int, columns: int, values: list[float]) -> str:
    return f"{key}:\n  rows: {rows}\n  cols: {columns}\n  data: {yaml_list(values)}\n"


def _table(document: Plain) -> dict[str, Plain]:
    """Give the keys as the file names them."""
    if isinstance(document, dict) and isinstance(document.get("camera_info"), dict):
        document = document["camera_info"]
    if not isinstance(document, dict):
        raise ConfigError("it holds no 'key: value' lines, so it is no camera_info of ROS")
    own = {message: key for key, message in KEYS.items()}
    return {own.get(key, key): value for key, value in document.items()}


def _matrix(table: dict[str, Plain], key: str, count: int | None = None) -> list[float]:
    section = table[key]
    return numbers(section.get("data") if isinstance(section, dict) else section, key, count)


def _lens(table: dict[str, Plain]) -> tuple[str, tuple[float, ...]]:
    lens = table["distortion_model"]
    coefficients = _matrix(table, "distortion_coefficients")
    if lens in FISHEYES:
        return "fisheye", tuple(numbers(coefficients, "distortion_coefficients", 4))
    if lens in POLYNOMIALS:
        return polynomial_model(coefficients, "distortion_coefficients")
    raise ConfigError(
        f"its distortion_model is '{lens!s:.40}', which no camera.toml holds; calibrate as one of "
        f"{', '.join((*POLYNOMIALS, FISHEYES[0]))}"
    )


def _ros_lens(camera: Camera) -> tuple[str, list[float]]:
    if camera.model == "fisheye":
        return FISHEYES[0], list(camera.distortion)
    if camera.model == "rational":
        return "rational_polynomial", list(camera.distortion)
    # ROS reads five, of which the last may be zero
    return "plumb_bob", [*camera.distortion, *(0.0,) * (5 - len(camera.distortion))]


def _left_out(table: dict[str, Plain], matrix: list[float]) -> tuple[str, ...]:
    """Name what belongs to rectified pictures, which nobody measures in."""
    turned = _matrix_if_any(table, "rectification_matrix")
    projected = _matrix_if_any(table, "projection_matrix")
    is_turned = turned is not None and turned != [1, 0, 0, 0, 1, 0, 0, 0, 1]
    plain = [*matrix[:3], 0, *matrix[3:6], 0, *matrix[6:], 0]
    is_moved = projected is not None and projected != plain
    return ("its rectification (use pictures as the camera took them)",) * (is_turned or is_moved)


def _matrix_if_any(table: dict[str, Plain], key: str) -> list[float] | None:
    """Give a matrix that may be absent."""
    return None if table.get(key) is None else _matrix(table, key)
