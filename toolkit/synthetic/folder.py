"""A simulated shot on disk: pictures, rig, camera and truth, as a user's folder would hold them."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from toolkit.ball_file import BallFile, SharpSource, write_ball
from toolkit.camera import Camera
from toolkit.camera_file import write_camera
from toolkit.errors import ConfigError, EnvironmentFault
from toolkit.files import write_text
from toolkit.imaging import write_dng, write_png16
from toolkit.plain_data import to_plain
from toolkit.synthetic.appearance import Appearance, PlainBall, mean_colour, pigments
from toolkit.synthetic.backgrounds import Colour
from toolkit.synthetic.boards import RenderedBoard
from toolkit.synthetic.paths import BallPath
from toolkit.synthetic.render import RenderedShot, Scene
from toolkit.synthetic.still import SharpPicture
from toolkit.toml_text import to_toml
from toolkit.types import LinearImage

Format = Literal["dng", "png"]

BLACK_LEVEL, WHITE_LEVEL = 512, 15871
"""Stored values of no light and of sensor white, as a 14-bit camera has them."""
PATTERN = ((0, 1), (1, 2))
TRUTH_SCHEMA = "toolkit.truth/1"
PATH_SAMPLES = 101
OWN_FILES = (
    "shot.dng",
    "shot.png",
    "background.dng",
    "background.png",
    "ball.dng",
    "ball.png",
    "ball.toml",
    "camera.toml",
    "rig.toml",
    "boards/board_[0-9][0-9].dng",
    "boards/board_[0-9][0-9].png",
)


def write_shot(
    folder: Path,
    shot: RenderedShot,
    *,
    format: Format = "dng",
    sharp: SharpPicture | None = None,
    boards: Iterable[RenderedBoard] | None = None,
    seed: int = 0,
) -> None:
    """Write a shot, its background, rig.toml, truth.json, and what tells the camera.

    That is camera.toml with the true camera, known exactly, or, where `boards` are given, their
    photos in boards/; a calibration from them is to leave the camera.toml which the rig names.

    Args:
        folder: where to; made when absent, and cleared of an earlier simulation.
        shot: what to write.
        format: "dng", a Bayer mosaic of 14 bits, or "png", linear light in 16 bits.
        sharp: the ball at rest, for estimators that need to have seen it; ball.toml comes with it
            and tells its true disc and pigments.
        boards: photos of a board; each is drawn from the iterable when its turn comes.
        seed: noted in truth.json.

    Raises:
        ConfigError: when the folder holds anything but an earlier simulation.
        EnvironmentFault: when it cannot be written.
    """
    claim_folder(folder)
    write_text(folder / "truth.json", truth_text(shot, seed, sharp))
    if sharp is not None:
        write_picture(folder / f"ball.{format}", sharp.image)
        write_ball(folder / "ball.toml", _ball(folder, shot.scene, sharp, format))
    write_picture(folder / f"shot.{format}", shot.image)
    write_picture(folder / f"background.{format}", shot.background)
    rig = _rig(shot.scene, format, has_ball_file=sharp is not None)
    write_text(folder / "rig.toml", to_toml("rig", rig))
    if boards is None:
        images = [f"shot.{format}"]
        camera = _known_exactly(shot.scene.camera)
        write_camera(folder / "camera.toml", camera, rms_px=0.0, views=0, images=images)
        return
    _make(folder / "boards")
    for number, board in enumerate(boards):
        write_picture(folder / "boards" / f"board_{number:02d}.{format}", board.image)


def claim_folder(folder: Path) -> None:
    """Make a folder, or clear it of what an earlier simulation left.

    An old camera.toml goes too, even one that was calibrated there: it belongs to the old pictures.

    Raises:
        ConfigError: when the folder holds other files and no simulation.
        EnvironmentFault: when it cannot be made or cleared.
    """
    _make(folder)
    if not any(folder.iterdir()):
        return
    if not _is_simulation(folder):
        raise ConfigError(
            f"{folder} holds files that are no simulation; name a new or empty folder"
        )
    for pattern in OWN_FILES:
        for path in folder.glob(pattern):
            _remove(path)


def write_picture(path: Path, image: LinearImage) -> None:
    """Write a picture as a Bayer DNG or a 16-bit PNG, by its suffix."""
    rgb = image.rgb[0].numpy()
    exposure = None if image.exposure is None else float(image.exposure[0])
    if path.suffix == ".dng":
        write_dng(
            path,
            bayer_values(rgb),
            pattern=PATTERN,
            black=BLACK_LEVEL,
            white=WHITE_LEVEL,
            exposure_s=exposure,
        )
    else:
        write_png16(path, rgb, exposure_s=exposure)


def bayer_values(rgb: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Give what a 14-bit sensor behind an RGGB mosaic stores of linear light [3, H, W], [H, W]."""
    light = np.empty(rgb.shape[1:], dtype=np.float32)
    for row, channels in enumerate(PATTERN):
        for column, channel in enumerate(channels):
            light[row::2, column::2] = rgb[channel, row::2, column::2]
    stored = np.rint(BLACK_LEVEL + (WHITE_LEVEL - BLACK_LEVEL) * light)
    return np.clip(stored, 0, WHITE_LEVEL).astype(np.uint16)


def truth_text(shot: RenderedShot, seed: int, sharp: SharpPicture | None = None) -> str:
    """Give truth.json: the state at mid-exposure, samples of the path, all that was rendered.

    With a readout that of the row which shows the ball.
    """
    scene = shot.scene
    camera = {
        key: getattr(scene.camera, key)
        for key in ("width", "height", "model", "fx", "fy", "cx", "cy", "distortion")
    }
    time = scene.own_time()
    velocity = shot.velocity_at(time)
    left, right = shot.contours().tolist()
    table = {
        "schema": TRUTH_SCHEMA,
        "time_s": time,
        "position_m": shot.position_at(time).tolist(),
        "velocity_m_s": velocity.tolist(),
        "speed_m_s": float(torch.linalg.vector_norm(velocity)),
        "path": {"kind": type(scene.path).__name__, **_plain_path(scene.path)},
        "trajectory": _trajectory(scene),
        "contours": {"left": left, "right": right},
        "camera": camera,
        "ball": {"radius_m": scene.ball_radius, "colours": _lists(pigments(scene.appearance))},
        "sharp_picture": None if sharp is None else _resting(sharp),
        "exposure_s": scene.exposure,
        "readout_s": scene.readout,
        "blur_px": scene.blur,
        "noise": scene.noise,
        "seed": seed,
    }
    return json.dumps(to_plain(table), allow_nan=False, indent=1) + "\n"


def _known_exactly(camera: Camera) -> Camera:
    """Give a camera whose covariance says that nothing about it is in doubt."""
    size = len(camera.parameters)
    return replace(camera, covariance=torch.zeros(size, size, dtype=torch.float64))


def _plain_path(path: BallPath) -> dict[str, Any]:
    plain: dict[str, Any] = to_plain(path)
    return plain


def _trajectory(scene: Scene) -> dict[str, Any]:
    """Samples of the path while the row that shows the ball's centre is exposed."""
    first, last = scene.own_time(0.0), scene.own_time(1.0)
    time = torch.linspace(first, last, PATH_SAMPLES, dtype=torch.float64)
    return {
        "time_s": time.tolist(),
        "position_m": scene.path.position(time).tolist(),
        "velocity_m_s": scene.path.velocity(time).tolist(),
    }


def _resting(sharp: SharpPicture) -> dict[str, Any]:
    disc = sharp.disc
    ellipse = {
        "centre_px": disc.centre,
        "semi_axes_px": disc.semi_axes,
        "angle_rad": disc.angle,
    }
    return {"position_m": sharp.position, "disc": ellipse}


def _rig(scene: Scene, format: Format, *, has_ball_file: bool) -> dict[str, Any]:
    estimator, colours = _how_to_measure(scene.appearance)
    file = {"file": "ball.toml"} if has_ball_file else {}
    readout = {"readout_s": scene.readout} if scene.readout else {}
    return {
        "camera": {"file": "camera.toml"},
        "response": {"kind": "linear"},
        "ball": {"radius_m": scene.ball_radius, **file, "colours": _lists(colours)},
        "exposure": {"time_s": scene.exposure, **readout},
        "background": {"images": [f"background.{format}"]},
        "measure": {"estimator": estimator},
    }


def _ball(folder: Path, scene: Scene, sharp: SharpPicture, format: Format) -> BallFile:
    colours = pigments(scene.appearance)
    normal = None
    if len(colours) == 2:
        first, second = torch.tensor(colours, dtype=torch.float64)
        across = torch.linalg.cross(first, second)
        x, y, z = torch.nn.functional.normalize(across, dim=0).tolist()
        normal = (x, y, z)
    else:
        # a pigment under a lamp is nowhere seen as it is
        colours = (mean_colour(scene.appearance, scene.exposure),)
    return BallFile(
        radius=scene.ball_radius,
        colours=colours,
        plane_normal=normal,
        sharp=SharpSource(
            image=folder / f"ball.{format}",
            background=(folder / f"background.{format}",),
            disc=sharp.disc,
            response="linear",
        ),
    )


def _how_to_measure(appearance: Appearance) -> tuple[str, tuple[Colour, ...]]:
    """Give the estimator that suits a ball, and the colours that it needs to be told."""
    colours = pigments(appearance)
    if len(colours) == 2:
        return "two-colour", colours
    is_plain = isinstance(appearance, PlainBall)
    return ("uniform", colours) if is_plain else ("known-shading", ())


def _lists(colours: tuple[Colour, ...]) -> list[list[float]]:
    return [list(colour) for colour in colours]


def _is_simulation(folder: Path) -> bool:
    try:
        table = json.loads((folder / "truth.json").read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(table, dict) and table.get("schema") == TRUTH_SCHEMA


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EnvironmentFault(
            f"{folder} cannot be made ({error.strerror}); choose another place"
        ) from error


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise EnvironmentFault(
            f"{path} cannot be replaced ({error.strerror}); choose another folder"
        ) from error
