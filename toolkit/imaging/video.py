"""Video frames, addressed by their presentation times."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ConfigError, ImageError
from toolkit.files import one_line
from toolkit.imaging.stored import StoredPicture, check_size

MOST_MEDIAN_FRAMES = 61
MOST_MEDIAN_BYTES = 600 * 10**6
MEDIAN_BAND_BYTES = 16 * 10**6


def read_frame(path: Path, number: int) -> StoredPicture:
    """Read one frame of a video, in the stored orientation; its exposure time is not known.

    Args:
        path: a video file.
        number: from 0, in the order of presentation.

    Raises:
        ConfigError: when the video has no such frame; the text tells how many it has.
        ImageError: when the video or this frame is damaged or interlaced.
    """
    times = _presentation_times(path)
    if times is not None and number < len(times):
        values = _seek_frame(path, times[number])
        if values is not None:
            return StoredPicture(values=values, is_video=True)
    count = 0
    for count, frame in enumerate(_frames(path), start=1):
        if count == number + 1:
            return StoredPicture(values=_pixels(path, frame), is_video=True)
    raise ConfigError(f"{path} has {count} frames; give --frame a number from 0 to {count - 1}")


def read_median(path: Path) -> tuple[StoredPicture, int]:
    """Take the median of a clip at every pixel: the scene without what moves.

    Long clips are sampled evenly, so that memory stays bounded.

    Returns:
        The median of the stored values, and of how many frames.

    Raises:
        ImageError: when the video is damaged, interlaced or changes its size.
    """
    total = _count_frames(path)
    chosen: set[int] = set()
    kept: list[NDArray[Any]] = []
    for number, frame in enumerate(_frames(path)):
        if not chosen:
            chosen = _choose_frames(total, frame.width * frame.height * 3)
        if number in chosen:
            kept.append(_pixels(path, frame))
            if kept[-1].shape != kept[0].shape or kept[-1].dtype != kept[0].dtype:
                raise ImageError(f"{path} changes its size on the way; cut out the part to use")
    if not kept:
        raise ImageError(f"{path} has no frame that can be decoded; copy it again")
    odd = kept[: len(kept) - 1 + len(kept) % 2]  # the median of an odd number is one of its values
    return StoredPicture(values=_median(odd), is_video=True), len(odd)


def _choose_frames(total: int, frame_bytes: int) -> set[int]:
    most = max(1, min(MOST_MEDIAN_FRAMES, MOST_MEDIAN_BYTES // frame_bytes))
    return set(np.linspace(0, max(total, 1) - 1, most).round().astype(int).tolist())


def _median(frames: list[NDArray[Any]]) -> NDArray[Any]:
    """Give the median of an odd number of integer pictures, in bands of rows."""
    rows = max(1, MEDIAN_BAND_BYTES // max(1, frames[0][0].nbytes * len(frames)))
    bands = [
        _median_by_bits(np.stack([frame[top : top + rows] for frame in frames]))
        for top in range(0, frames[0].shape[0], rows)
    ]
    return np.concatenate(bands)


def _median_by_bits(stack: NDArray[Any]) -> NDArray[Any]:
    """Find the median along axis 0 bit by bit, the highest first: much faster than sorting."""
    half = stack.shape[0] // 2
    found = np.zeros(stack.shape[1:], stack.dtype)
    for bit in reversed(range(stack.dtype.itemsize * 8)):
        trial = found | stack.dtype.type(1 << bit)
        below = (stack < trial).sum(axis=0, dtype=np.uint8)
        found = np.where(below <= half, trial, found)
    return found


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video; give its container and first video stream, set to report damage."""
    try:
        # The prefix keeps a name with a colon from being taken for a network address.
        with av.open(f"file:{path}", metadata_errors="replace") as container:
            if not container.streams.video:
                raise ImageError(f"{path} holds no video; give a picture or a video")
            stream = container.streams.video[0]
            if stream.codec_context is None:
                raise ImageError(f"{path} uses a video codec that is not supported; convert it")
            check_size(path, stream.width, stream.height)
            stream.codec_context.options = {"err_detect": "crccheck+bitstream+buffer+explode"}
            yield container, stream
    except (av.error.FFmpegError, LookupError, ValueError) as error:
        raise ImageError(
            f"{path} is a damaged or unsupported video ({one_line(error)}); copy or convert it"
        ) from None


def _frames(path: Path) -> Iterator[Any]:
    with _opened(path) as (container, stream):
        yield from container.decode(stream)


def _presentation_times(path: Path) -> list[int] | None:
    """Give the frames' presentation times in order, undecoded; None where packets do not tell."""
    with _opened(path) as (container, stream):
        packets = [p for p in container.demux(stream) if p.size and not p.is_discard]
    times = [packet.pts for packet in packets]
    if None in times or len(set(times)) != len(times):
        return None
    return sorted(times)


def _count_frames(path: Path) -> int:
    with _opened(path) as (container, stream):
        return sum(1 for p in container.demux(stream) if p.size and not p.is_discard)


def _seek_frame(path: Path, time: int) -> NDArray[Any] | None:
    """Decode from the key frame before `time` up to it; None when no frame bears this time."""
    with _opened(path) as (container, stream):
        container.seek(time, stream=stream)
        for frame in container.decode(stream):
            if frame.pts == time:
                return _pixels(path, frame)
            if frame.pts is None or frame.pts > time:
                return None
    return None


def _pixels(path: Path, frame: Any) -> NDArray[Any]:
    """Give a frame as RGB [H, W, 3] by its own colour matrix, in 16 bits where it has over 8."""
    if frame.is_corrupt:
        raise ImageError(f"{path} has a damaged frame at {frame.time} s; choose another")
    if frame.interlaced_frame:
        raise ImageError(
            f"{path} is interlaced, each frame shows two exposures; split it into fields first"
        )
    bits = max(component.bits for component in frame.format.components)
    values: NDArray[Any] = frame.to_ndarray(format="rgb48le" if bits > 8 else "rgb24")
    return values
