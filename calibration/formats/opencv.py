"""OpenCV's cv2.FileStorage, YAML, XML or JSON, as its calibration samples write it.

Source: OpenCV's samples calibration.cpp, camera_calibration.cpp and interactive-calibration.
"""

import re
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from calibration.formats.foreign import (
    Cameras,
    ForeignCamera,
    focal_and_centre,
    matrix_rows,
    numbers,
    polynomial_model,
    size,
)
from toolkit.camera import Camera
from toolkit.errors import ConfigError

NAME = "opencv"
ENDINGS = (".yml", ".yaml", ".xml", ".json")
DEEPEST = 100
"""Levels of brackets or tags; the parser recurses, and falls over at some ten thousand."""
MOST_NUMBERS = 20
MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix")
DISTORTION = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "Distortion_Coefficients")
SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"))
SIZE = ("cameraResolution",)  # as interactive-calibration writes it
ERROR = ("avg_reprojection_error", "Avg_Reprojection_Error")


def looks_alike(text: str) -> bool:
    """Tell whether a text could be such a file."""
    return text.lstrip().startswith(("%YAML", "<?xml", "<opencv_storage", "{"))


def parse(text: str) -> Cameras:
    """Give the camera.

    Raises:
        ConfigError: where it is no such file, lacks a part, or has a lens that no camera.toml
            holds.
    """
    _check_depth(text)
    try:
        found = _camera(cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY))
    except (cv2.error, SystemError):  # what its binding makes of an error in a constructor
        raise ConfigError(
            "it cannot be parsed as YAML, XML or JSON of OpenCV's FileStorage; write it anew"
        ) from None
    return {found.name: lambda: found}


def compose(camera: Camera, name: str, ending: str = ".yml") -> str:
    """Write one camera as the samples do.

    Args:
        camera: of any model.
        name: not told in such a file.
        ending: .yml, .yaml, .xml or .json.
    """
    file = cv2.FileStorage(ending, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    file.write("image_width", camera.width)
    file.write("image_height", camera.height)
    file.write("fisheye_model", int(camera.model == "fisheye"))
    file.write("camera_matrix", np.array(matrix_rows(camera)))
    distortion = camera.distortion or (0.0,) * 5
    file.write("distortion_coefficients", np.array(distortion)[:, None])
    return str(file.releaseAndGetString())


def _check_depth(text: str) -> None:
    """Refuse a text that would overflow the parser's stack."""
    depth = 0
    for match in re.finditer(r"[\[{]|[\]}]|<[A-Za-z_]|</", text):
        depth += 1 if match[0] in "[{" or (match[0][0] == "<" and match[0] != "</") else -1
        if depth > DEEPEST:
            raise ConfigError(f"it is nested more than {DEEPEST} deep, as no camera file is")


def _camera(file: Any) -> ForeignCamera:
    matrix = numbers(_values(file, MATRIX), MATRIX[0], 9)
    coefficients = numbers(_values(file, DISTORTION), DISTORTION[0])
    width, height = size(_size(file), "image_width, image_height")
    if _is_fisheye(file):
        model, distortion = "fisheye", tuple(numbers(coefficients, DISTORTION[0], 4))
    else:
        model, distortion = polynomial_model(coefficients, DISTORTION[0])
    fx, fy, cx, cy = focal_and_centre(matrix, MATRIX[0])
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
    error = _find(file, ERROR)
    rms = error.real() if error is not None and (error.isReal() or error.isInt()) else None
    return ForeignCamera(camera=camera, name="camera", rms_px=rms)


def _find(file: Any, names: Sequence[str]) -> Any:
    """Give the first node there is by one of the names, or None."""
    nodes = (file.getNode(name) for name in names)
    return next((node for node in nodes if not node.empty()), None)


def _values(file: Any, names: Sequence[str]) -> list[float]:
    """Give the numbers of a matrix, however it is laid out.

    The matrix is not read by OpenCV, which would first make room for as many numbers as the file
    claims to have.
    """
    node = _find(file, names)
    if node is None:
        raise ConfigError(f"{names[0]} is missing; give a file of OpenCV's calibration samples")
    if node.isMap():
        node = node.getNode("data")
    if not node.isSeq() or node.size() > MOST_NUMBERS:
        raise ConfigError(f"{names[0]} is no list of at most {MOST_NUMBERS} numbers")
    parts = [node.at(index) for index in range(node.size())]
    if not all(part.isReal() or part.isInt() for part in parts):
        raise ConfigError(f"{names[0]} holds something else than numbers")
    return [part.real() for part in parts]


def _size(file: Any) -> list[float]:
    for names in SIZES:
        nodes = [file.getNode(name) for name in names]
        if all(node.isInt() for node in nodes):
            return [node.real() for node in nodes]
    if _find(file, SIZE) is not None:
        return numbers(_values(file, SIZE), SIZE[0], 2)
    raise ConfigError("image_width and image_height are missing; add them, in pixels, to the file")


def _is_fisheye(file: Any) -> bool:
    node = file.getNode("fisheye_model")
    return bool(node.isInt() and node.real())
