from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from toolkit import Camera, LinearImage
from toolkit.camera_file import write_camera
from toolkit.imaging import write_png16
from toolkit.synthetic import benchmark_scene, render_sharp, render_shot
from toolkit.synthetic.still import SharpPicture

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


Ball = tuple[SharpPicture, LinearImage]


@pytest.fixture(scope="session")
def sharp_ball() -> Callable[..., Ball]:
    """Render a sharp ball in the benchmark scene: the picture with its truth, and the background.

    `look` makes the appearance of the scene's orange, `offset` moves the ball in its radii.
    """
    made: dict[object, Ball] = {}

    def render(
        look: Callable[[tuple[float, float, float]], object] | None = None,
        *,
        radius_px: float = 30,
        distance_R: float = 15,
        offset: tuple[float, float] = (0.0, 0.0),
        size: tuple[int, int] | None = None,
        seed: int = 0,
    ) -> Ball:
        key = (look, radius_px, distance_R, offset, size, seed)
        if key not in made:
            scene = benchmark_scene(
                width_px=2 * radius_px, length_widths=1, distance_R=distance_R, size=size, seed=seed
            )
            if look is not None:
                scene = replace(scene, appearance=look(scene.appearance.colour))
            depth = distance_R * scene.ball_radius
            place = (offset[0] * scene.ball_radius, offset[1] * scene.ball_radius, depth)
            empty = render_shot(scene, seed=seed, step=3.0, supersampling=1).background
            made[key] = render_sharp(scene, seed=seed, position=place), empty
        return made[key]

    return render
