"""The door for every picture file."""

from pathlib import Path

from toolkit.errors import ConfigError, ImageError
from toolkit.imaging.jpeg import read_jpeg
from toolkit.imaging.kinds import Kind, kind_of
from toolkit.imaging.png import read_png
from toolkit.imaging.raw import read_raw
from toolkit.imaging.stored import StoredPicture, to_linear
from toolkit.imaging.tiff import read_tiff
from toolkit.response import LINEAR, load_response
from toolkit.types import LinearImage

_STILLS = {"jpeg": read_jpeg, "png": read_png, "tiff": read_tiff}


def read_image(
    path: str | Path, *, response: str | Path | None = None, frame: int | None = None
) -> LinearImage:
    """Read one picture as linear light, in sensor orientation.

    No EXIF or RAW orientation is applied. The content decides how the file is read, not its name.
    Where no response is named, RAW and float pictures are linear; a PNG may state its encoding (a
    gAMA chunk of 1 or an sRGB chunk); otherwise 8-bit pictures and video are taken for sRGB and
    16-bit ones for linear, and the result says that this is assumed. A grey picture gives three
    equal channels; an alpha channel is dropped where it is opaque and refused where it is not.

    Args:
        path: a RAW, DNG, JPEG, PNG or TIFF picture, or a video.
        response: "linear", "srgb", a colour-science curve or a response.toml.
        frame: which frame of a video, from 0; only for videos.

    Returns:
        One picture (B = 1); its exposure is None where the file does not tell.

    Raises:
        ImageError: when the file is missing, damaged or of an unsupported kind; a part of a picture
            is never returned.
        ConfigError: when the response is unknown, or the frame does not exist or does not belong.
    """
    path = Path(path)
    kind = kind_of(path)
    _check_frame(path, kind, frame)
    try:
        if kind == "raw":
            return read_raw(path, LINEAR if response is None else load_response(response))
        stored = _STILLS[kind](path) if frame is None else _read_frame(path, frame)
        return to_linear(path, stored, response)
    except OSError as error:
        raise ImageError(
            f"{path} cannot be read ({error.strerror or error}); check the disk and the permissions"
        ) from None


def _check_frame(path: Path, kind: Kind, frame: int | None) -> None:
    if kind == "video" and frame is None:
        raise ConfigError(f"{path} is a video; name the frame with --frame N")
    if kind != "video" and frame is not None:
        raise ConfigError(f"{path} is a still picture; leave --frame {frame} out")
    if frame is not None and frame < 0:
        raise ConfigError(f"--frame {frame} is negative; frames of {path} count from 0")


def _read_frame(path: Path, frame: int) -> StoredPicture:
    from toolkit.imaging.video import read_frame  # its library takes a while to load

    return read_frame(path, frame)
