"""What a file holds, told from its content and never from its name."""

from codecs import getincrementaldecoder
from pathlib import Path
from typing import Literal

from toolkit.errors import ImageError
from toolkit.imaging.tiff import holds_raw

Kind = Literal["raw", "jpeg", "png", "tiff", "video"]

HEAD_BYTES = 400  # two packets of an MPEG transport stream

RAW_NAMES = frozenset(
    ".3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .fff .iiq .kdc .mef .mos .mrw .nef .nrw .orf .pef "
    ".raf .raw .rw2 .rwl .sr2 .srf .srw .x3f".split()
)

_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_RAW = (
    b"FUJIFILM",
    b"II\x1a\0\0\0HEAPCCDR",
    b"IIRO",
    b"IIRS",
    b"MMOR",
    b"IIU\0",
    b"FOVb",
    b"\0MRM",
)
_VIDEO = (
    b"\x1aE\xdf\xa3",  # Matroska, WebM
    b"OggS",
    b"FLV\x01",
    b"\0\0\x01\xba",  # MPEG program stream
    b"\0\0\x01\xb3",  # MPEG video
    b"0&\xb2u",  # Windows media
    b"YUV4MPEG2",
)
_QUICKTIME = (b"moov", b"mdat", b"wide", b"free", b"skip")
_STILL_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1", b"avif", b"avis")
_OTHERS = (
    (b"GIF8", "a GIF picture"),
    (b"BM", "a BMP picture"),
    (b"v/1\x01", "an OpenEXR picture"),
    (b"#?", "a Radiance picture"),
    (b"%PDF", "a PDF document"),
    (b"\xff\x4f\xff\x51", "a JPEG 2000 picture"),
    (b"PK\x03\x04", "an archive"),
)
_REMEDY = "give a RAW, DNG, JPEG, PNG or TIFF picture or a video"


def kind_of(path: Path) -> Kind:
    """Tell the kind of a file from its first bytes.

    The name decides nothing, with one exception that protects from a silent error: a JPEG under a
    RAW name is refused, because a picture processed by the camera would pass for the sensor's own
    values.

    Raises:
        ImageError: when there is no such file, it is empty or cannot be opened, or it holds nothing
            this toolkit reads.
    """
    head = _head(path)
    if head.startswith(b"\xff\xd8\xff"):
        if path.suffix.lower() in RAW_NAMES:
            raise ImageError(
                f"{path} has a RAW name but holds a processed JPEG; "
                "give the RAW file, or rename this one to .jpg"
            )
        return "jpeg"
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    if head.startswith(_TIFF):
        return "raw" if head[8:10] == b"CR" or holds_raw(path) else "tiff"
    if head.startswith(_RAW) or head[4:11] == b"ftypcrx":
        return "raw"
    if _is_video(head):
        return "video"
    raise ImageError(f"{path} is {_describe(head)}; {_REMEDY}")


def _head(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise ImageError(f"{path} is a folder; give one picture file")
        if not path.exists():
            raise ImageError(f"{path} does not exist; {_REMEDY}")
        if not path.is_file():
            raise ImageError(f"{path} is not a regular file; {_REMEDY}")
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        reason = getattr(error, "strerror", None) or str(error)
        raise ImageError(f"{path} cannot be read ({reason}); {_REMEDY}") from None
    if not head:
        raise ImageError(f"{path} is empty; copy it again from the camera")
    return head


def _is_video(head: bytes) -> bool:
    if head[4:8] == b"ftyp":
        return head[8:12] not in _STILL_BRANDS
    is_avi = head.startswith(b"RIFF") and head[8:12] == b"AVI "
    is_transport = head[:1] == b"G" and head[188:189] == b"G" and head[376:377] == b"G"
    return is_avi or is_transport or head.startswith(_VIDEO) or head[4:8] in _QUICKTIME


def _describe(head: bytes) -> str:
    if head[4:8] == b"ftyp":
        return "a HEIF or AVIF picture"
    if head.startswith(b"RIFF") and head[8:12] == b"WEBP":
        return "a WebP picture"
    for magic, name in _OTHERS:
        if head.startswith(magic):
            return name
    is_text = all(byte >= 32 or byte in b"\t\r\n\f" for byte in head) and _is_utf8(head)
    return "a text file" if is_text else "of an unknown kind or damaged"


def _is_utf8(head: bytes) -> bool:
    try:
        getincrementaldecoder("utf-8")().decode(head)  # lets a cut last character pass
    except UnicodeDecodeError:
        return False
    return True
