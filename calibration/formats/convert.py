"""Reading a camera from another program's file, and writing one for it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from calibration.formats import colmap, kalibr, opencv, ros
from calibration.formats.foreign import Cameras, ForeignCamera
from toolkit.camera import Camera
from toolkit.errors import ConfigError, MismatchError
from toolkit.files import write_text

AUTO = "auto"
MAX_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """How one program keeps cameras."""

    looks_alike: Callable[[str], bool]
    parse: Callable[[str], Cameras]
    compose: Callable[[Camera, str, str], str]  # camera, its name, the file's ending
    endings: tuple[str, ...]


FORMATS = {
    opencv.NAME: Format(
        looks_alike=opencv.looks_alike,
        parse=opencv.parse,
        compose=opencv.compose,
        endings=opencv.ENDINGS,
    ),
    kalibr.NAME: Format(
        looks_alike=kalibr.looks_alike,
        parse=kalibr.parse,
        compose=lambda camera, name, _: kalibr.compose(camera, name),
        endings=(".yaml", ".yml"),
    ),
    ros.NAME: Format(
        looks_alike=ros.looks_alike,
        parse=ros.parse,
        compose=lambda camera, name, _: ros.compose(camera, name),
        endings=(".yaml", ".yml"),
    ),
    colmap.NAME: Format(
        looks_alike=colmap.looks_alike,
        parse=colmap.parse,
        compose=lambda camera, name, _: colmap.compose(camera, name),
        endings=(".txt",),
    ),
}
"""In the order in which `auto` tries them: a camchain too has a distortion_model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """A camera read from another program's file."""

    camera: Camera
    format: str
    name: str
    rms_px: float | None
    cautions: tuple[str, ...]


def import_camera(path: Path, *, format: str = AUTO, name: str | None = None) -> Imported:
    """Read a camera.

    Args:
        path: the other program's file.
        format: "opencv", "kalibr", "ros" or "colmap"; "auto" tells it by the contents.
        name: which camera of a file that holds several: "cam1" or 1.

    Raises:
        ConfigError: when the file cannot be read as such, or holds no such camera.
    """
    text = _read(path)
    try:
        chosen = _known(format) if format != AUTO else _tell(text)
        camera = _choose(FORMATS[chosen].parse(text), name)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return Imported(
        camera=camera.camera,
        format=chosen,
        name=camera.name,
        rms_px=camera.rms_px,
        cautions=_import_cautions(camera),
    )


def export_camera(camera: Camera, path: Path, *, format: str) -> tuple[str, ...]:
    """Write a camera for another program, and say what its file does not hold.

    Raises:
        ConfigError: when the format is unknown, or the file's ending is not one of it.
        MismatchError: when that program has no such lens.
        EnvironmentFault: when the place cannot be written.
    """
    known = FORMATS[_known(format)]
    if path.suffix.lower() not in known.endings:
        raise ConfigError(
            f"{path}: a file of {format} ends in {' or '.join(known.endings)}; choose such a name"
        )
    try:
        text = known.compose(camera, path.stem, path.suffix.lower())
    except MismatchError as error:
        raise MismatchError(f"{path} is not written: {error}") from None
    write_text(path, text)
    if camera.covariance is None:
        return ()
    return (f"{format} files hold no covariance, so the camera's uncertainty is lost there",)


def _known(format: str) -> str:
    if format not in FORMATS:
        raise ConfigError(f"format '{format:.40}' is unknown; use one of {', '.join(FORMATS)}")
    return format


def _tell(text: str) -> str:
    for name, format in FORMATS.items():
        if format.looks_alike(text):
            return name
    raise ConfigError(f"no camera file of {', '.join(FORMATS)} is recognised in it; say --format")


def _read(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path} is larger than {MAX_BYTES} bytes; is it a camera file?")
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist; give the path of a camera file") from None
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read ({error.strerror}); give the path of a camera file"
        ) from None
    except UnicodeDecodeError:
        raise ConfigError(
            f"{path} is no text; export it as text (COLMAP: colmap model_converter "
            "--output_type TXT)"
        ) from None


def _choose(cameras: Cameras, name: str | None) -> ForeignCamera:
    names = list(cameras)
    shown = ", ".join(f"'{one:.20}'" for one in names[:10]) + (" ..." if len(names) > 10 else "")
    if not cameras:
        raise ConfigError("there is no camera in it")
    if name is None:
        if len(cameras) > 1:
            raise ConfigError(f"it holds {len(cameras)} cameras, {shown}; choose one by --camera")
        return cameras[names[0]]()
    found = [one for one in (name, f"cam{name}") if one in cameras]
    if not found:
        raise ConfigError(f"there is no camera '{name:.40}' in it; there is {shown}")
    return cameras[found[0]]()


def _import_cautions(camera: ForeignCamera) -> tuple[str, ...]:
    left_out = [f"{what} is left out" for what in camera.left_out]
    unknown = (
        "the file tells no covariance, so measurements leave this camera's error out, and say so; "
        "calibrate from the photos with `toolkit calibrate` to know it"
    )
    return (*left_out, unknown)
