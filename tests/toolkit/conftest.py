from pathlib import Path

import numpy as np
import pytest

from toolkit import Camera
from toolkit.camera_file import write_camera
from toolkit.imaging import write_png16

WIDTH, HEIGHT = 40, 30


def shading(height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """A smooth scene [3, H, W] around 1."""
    return np.linspace(0.8, 1.2, 3 * height * width).reshape(3, height, width)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with shot.png, empty.png and camera.toml, too plain to be measured."""
    camera = Camera(width=WIDTH, height=HEIGHT, fx=50, fy=50, cx=19.5, cy=14.5)
    write_camera(tmp_path / "camera.toml", camera, rms_px=0.1, views=9, images=["a.png"])
    for name, level in (("shot", 0.3), ("empty", 0.2)):
        write_png16(tmp_path / f"{name}.png", level * shading(), exposure_s=0.01)
    return tmp_path
