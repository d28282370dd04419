"""COLMAP's cameras.txt, whose pixel (0, 0) is the CORNER of the top-left pixel.

Source: COLMAP's documentation of its output format and camera models, sensor/models.h.
"""

import re
from functools import partial

from calibration.formats.foreign import Cameras, ForeignCamera, number, polynomial_model, size
from toolkit.camera import Camera
from toolkit.errors import ConfigError

NAME = "colmap"
HALF = 0.5
"""px from the corner of the top-left pixel to its centre, our (0, 0)."""
# what the parameters are: f stands for both focal lengths
MODELS = {
    "SIMPLE_PINHOLE": ("pinhole", "f cx cy"),
    "PINHOLE": ("pinhole", "fx fy cx cy"),
    "SIMPLE_RADIAL": ("pinhole", "f cx cy k1"),
    "RADIAL": ("pinhole", "f cx cy k1 k2"),
    "OPENCV": ("pinhole", "fx fy cx cy k1 k2 p1 p2"),
    "FULL_OPENCV": ("rational", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "OPENCV_FISHEYE": ("fisheye", "fx fy cx cy k1 k2 k3 k4"),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", "f cx cy k1"),
    "RADIAL_FISHEYE": ("fisheye", "f cx cy k1 k2"),
}
DISTORTION = {
    "pinhole": ("k1", "k2", "p1", "p2"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}


def looks_alike(text: str) -> bool:
    """Tell whether a text could be such a file."""
    return any(re.match(r"\d+\s+[A-Z_]+\s+\d+\s+\d+\s", line) for line in _rows(text)[:1])


def parse(text: str) -> Cameras:
    """Give all cameras.

    Raises:
        ConfigError: naming the line that is none, or the model that no camera.toml holds.
    """
    return {line.split()[0]: partial(_camera, line) for line in _rows(text)}


def compose(camera: Camera, name: str) -> str:
    """Write one camera; every lens there is has a model."""
    model, values = _colmap_model(camera)
    words = [name if name.isdigit() else "1", model, str(camera.width), str(camera.height)]
    return (
        "# Camera list with one line of data per camera:\n"
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        "# Number of cameras: 1\n" + " ".join([*words, *map(repr, values)]) + "\n"
    )


def _rows(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if line.strip() and line.strip()[0] != "#"]


def _camera(line: str) -> ForeignCamera:
    words = line.split()
    if len(words) < 4:
        raise ConfigError(f"'{line:.40}' is no line CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
    name, model, *rest = words
    if model not in MODELS:
        raise ConfigError(
            f"camera {name:.20} has the model '{model:.40}', which no camera.toml holds; "
            f"calibrate as one of {', '.join(MODELS)}"
        )
    values = [_parsed(word, name) for word in rest]
    kind, names = MODELS[model][0], MODELS[model][1].split()
    if len(values) != 2 + len(names):
        raise ConfigError(
            f"camera {name:.20} has {len(values) - 2} parameters; {model} has "
            f"{len(names)}: {' '.join(names)}"
        )
    width, height = size(values[:2], f"size of camera {name:.20}")
    told = dict(zip(names, values[2:], strict=True))
    bent = tuple(told.get(term, 0.0) for term in DISTORTION[kind])
    if kind == "rational":
        kind, bent = polynomial_model(bent, model)
    elif not any(term in told for term in DISTORTION[kind]):
        bent = ()
    camera = Camera(
        width=width,
        height=height,
        fx=told.get("fx", told.get("f", 0.0)),
        fy=told.get("fy", told.get("f", 0.0)),
        cx=told["cx"] - HALF,
        cy=told["cy"] - HALF,
        distortion=bent,
        model=kind,
    )
    return ForeignCamera(camera=camera, name=name)


def _parsed(word: str, name: str) -> float:
    try:
        return number(float(word), f"a parameter of camera {name:.20}")
    except ValueError:
        raise ConfigError(
            f"camera {name:.20}: '{word:.40}' stands where a number is needed"
        ) from None


def _colmap_model(camera: Camera) -> tuple[str, list[float]]:
    inner = [camera.fx, camera.fy, camera.cx + HALF, camera.cy + HALF]
    if camera.model == "fisheye":
        return "OPENCV_FISHEYE", [*inner, *camera.distortion]
    if len(camera.distortion) > 4:
        padded = (*camera.distortion, *(0.0,) * (8 - len(camera.distortion)))
        return "FULL_OPENCV", [*inner, *padded]
    if camera.distortion:
        return "OPENCV", [*inner, *camera.distortion]
    return "PINHOLE", inner
