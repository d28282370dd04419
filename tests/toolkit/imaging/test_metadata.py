import io
import struct

import pytest

from toolkit.imaging import exposure_time
from toolkit.imaging.metadata import exif_block, exposure_of_block, rational


def directory(entries, start, order):
    """Give the bytes of one TIFF directory at `start`; entries are (tag, type, count, value)."""
    body = struct.pack(f"{order}H", len(entries))
    data_at = start + 2 + 12 * len(entries) + 4
    data = b""
    for tag, kind, count, value in entries:
        body += struct.pack(f"{order}HHI", tag, kind, count)
        if len(value) <= 4:
            body += value.ljust(4, b"\0")
        else:
            body += struct.pack(f"{order}I", data_at + len(data))
            data += value
    return body + struct.pack(f"{order}I", 0) + data


def block(*, first=None, exif=None, order="<", kind=5):
    """Build EXIF with an exposure time in the first directory, the Exif directory, both or none."""

    def entry(ratio):
        return (33434, kind, 1, struct.pack(f"{order}{'II' if kind == 5 else 'ii'}", *ratio))

    entries = [] if first is None else [entry(first)]
    size = len(directory([*entries, (34665, 4, 1, b"\0\0\0\0")], 8, order))
    entries += [] if exif is None else [(34665, 4, 1, struct.pack(f"{order}I", 8 + size))]
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8)
    tail = b"" if exif is None else directory([entry(exif)], 8 + size, order)
    return head + directory(entries, 8, order) + tail


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("first", "exif", "expected"),
    [
        ((1, 50), None, 1 / 50),
        (None, (1, 60), 1 / 60),
        ((1, 50), (1, 60), 1 / 60),
        ((1, 50), (0, 1), 1 / 50),
        ((1, 50), (1, 0), 1 / 50),
        ((0, 0), None, None),
        (None, (1, 0), None),
        (None, (0, 1), None),
        (None, None, None),
        (None, (4_000_000_000, 1), None),
        (None, (1, 1), 1.0),
    ],
)
def test_either_directory(order, first, exif, expected):
    assert exposure_time(io.BytesIO(block(first=first, exif=exif, order=order))) == expected


def test_a_negative_time_is_none():
    assert exposure_time(io.BytesIO(block(exif=(-1, 100), kind=10))) is None


def test_damaged_blocks_never_raise(rng):
    good = block(first=(1, 50), exif=(1, 60))
    for _ in range(1500):
        data = bytearray(good)
        for _ in range(int(rng.integers(1, 4))):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        seconds = exposure_time(io.BytesIO(bytes(data[: int(rng.integers(1, len(data) + 1))])))
        assert seconds is None or 0 < seconds < 1e5


@pytest.mark.parametrize("seconds", [1 / 8000, 0.0123456789, 1.0, 30.0, 9999.5])
def test_written_times_are_read_again(seconds):
    assert exposure_of_block(exif_block(seconds)) == pytest.approx(seconds, rel=1e-8)
    assert exposure_of_block(b"Exif\0\0" + exif_block(seconds)) == pytest.approx(seconds, rel=1e-8)
    assert all(0 < part < 2**32 for part in rational(seconds))


@pytest.mark.parametrize("data", [None, b"", b"\0", b"II*\0", b"not a block at all"])
def test_no_block(data):
    assert exposure_of_block(data) is None
