"""Files of known content for the readers."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile

BAYER = ((0, 1), (1, 2))
XTRANS = (
    (1, 0, 1, 1, 2, 1),
    (2, 1, 2, 0, 1, 0),
    (1, 0, 1, 1, 2, 1),
    (1, 2, 1, 1, 0, 1),
    (0, 1, 0, 2, 1, 2),
    (1, 2, 1, 1, 0, 1),
)
SHARED = Path(__file__).resolve().parents[3].parent / "shared/data"


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def mosaic(rng):
    return rng.integers(300, 4000, (48, 66), dtype=np.uint16)


@pytest.fixture
def shared():
    if not SHARED.is_dir():
        pytest.skip(f"the real pictures are not at {SHARED}")
    return SHARED


@pytest.fixture
def make_dng(tmp_path):
    """Write a DNG freely, including what no sane camera writes."""

    def make(
        values, *, pattern=BAYER, black=(0,), dims=(1, 1), white=4095, exposure=(1, 100), extra=()
    ):
        flat = bytes(c for row in pattern for c in row)
        tags = [
            (33421, "H", 2, (len(pattern), len(pattern[0])), True),
            (33422, "B", len(flat), flat, True),
            (50710, "B", 3, bytes([0, 1, 2]), True),
            (50711, "H", 1, 1, True),
        ]
        is_mosaic = values.ndim == 2
        tags = (tags if is_mosaic else []) + [
            (271, "s", 0, "Maker", True),
            (272, "s", 0, "Model", True),
            (50706, "B", 4, bytes([1, 4, 0, 0]), True),
            (50707, "B", 4, bytes([1, 1, 0, 0]), True),
            (50708, "s", 0, "Maker Model", True),
            (50713, "H", 2, dims, True),
            (50714, "H", len(black), tuple(black), True),
            (50717, "I", 1, white, True),
            (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
            (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),
            (50778, "H", 1, 21, True),
        ]
        if exposure is not None:
            tags.append((33434, "2I", 1, exposure, True))
        path = tmp_path / "free.dng"
        tifffile.imwrite(
            path,
            values,
            photometric=32803 if is_mosaic else 34892,
            extratags=[*tags, *extra],
            metadata=None,
            software=False,
            rowsperstrip=values.shape[0],
        )
        return path

    return make


@pytest.fixture
def make_png(tmp_path):
    """Write a PNG chunk by chunk."""

    def chunk(name, content):
        body = name + content
        return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))

    def make(values, *, size=None, depth=8, kind=2, extra=b"", rows=None, before=()):
        height, width = size or values.shape[:2]
        lines = values.reshape(values.shape[0], -1)[:rows]
        stored = lines.astype(">u2" if depth == 16 else np.uint8)
        packed = zlib.compress(b"".join(b"\0" + line.tobytes() for line in stored))
        path = tmp_path / "free.png"
        path.write_bytes(
            b"\x89PNG\r\n\x1a\n"
            + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0))
            + b"".join(chunk(name, content) for name, content in before)
            + chunk(b"IDAT", packed)
            + chunk(b"IEND", b"")
        )
        return path

    return make


@pytest.fixture
def check_damage(tmp_path):
    """Cut and flip a good file: it must be refused, or give a full picture."""
    from toolkit.errors import ImageError
    from toolkit.imaging import read_image

    def check(good, rng, cuts=40, flips=60):
        data = good.read_bytes()
        whole = read_image(good)
        path = tmp_path / f"damaged{good.suffix}"
        texts = []
        counts = {"cut refused": 0, "cut read": 0, "flip refused": 0, "flip read": 0}
        for kind, count in (("cut", cuts), ("flip", flips)):
            for _ in range(count):
                at = int(rng.integers(1, len(data)))
                if kind == "cut":
                    path.write_bytes(data[:at])
                else:
                    # headers are short and matter most: half of the flips hit the first 600 bytes
                    at = at if rng.random() < 0.5 else at % 600
                    path.write_bytes(data[:at] + bytes([data[at] ^ 0xA5]) + data[at + 1 :])
                try:
                    image = read_image(path)
                except ImageError as error:
                    texts.append(str(error))
                    counts[f"{kind} refused"] += 1
                else:
                    if kind == "cut":
                        assert bool((image.rgb == whole.rgb).all())
                    assert bool(image.rgb.isfinite().all())
                    counts[f"{kind} read"] += 1
        assert all(str(path) in text and "\n" not in text for text in texts)
        return counts

    return check
