import os
import shutil
import sys

import numpy as np
import pytest
import tifffile
from PIL import Image

from toolkit.errors import ConfigError, ImageError
from toolkit.imaging import read_image, write_dng, write_png16
from toolkit.imaging.kinds import kind_of


def test_the_content_decides_not_the_name(tmp_path, mosaic, rng):
    picture = rng.integers(0, 256, (24, 30, 3), dtype=np.uint8)
    write_dng(tmp_path / "a.jpg", mosaic, white=4095)
    write_png16(tmp_path / "a.tif", picture.transpose(2, 0, 1) / 255)
    tifffile.imwrite(tmp_path / "a.dng", picture, photometric="rgb")
    Image.fromarray(picture).save(tmp_path / "a.png", "jpeg")
    shutil.copy(tmp_path / "a.jpg", tmp_path / "noname")
    kinds = {path.name: kind_of(path) for path in tmp_path.iterdir()}
    assert kinds == {
        "a.jpg": "raw", "a.tif": "png", "a.dng": "tiff", "a.png": "jpeg", "noname": "raw"
    }  # fmt: skip
    assert read_image(tmp_path / "a.jpg").mosaic is not None
    assert read_image(str(tmp_path / "a.png")).mosaic is None


def test_a_jpeg_must_not_pass_for_raw(tmp_path, rng):
    path = tmp_path / "shot.NEF"
    Image.fromarray(rng.integers(0, 256, (24, 30, 3), dtype=np.uint8)).save(path, "jpeg")
    with pytest.raises(ImageError, match=r"shot.NEF has a RAW name but holds a processed JPEG"):
        read_image(path)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"FUJIFILMCCD-RAW 0201", "raw"),
        (b"\0\0\0\x18ftypcrx \0\0\0\1", "raw"),
        (b"IIU\0\x18\0\0\0", "raw"),
        (b"II*\0\x10\0\0\0CR\2\0", "raw"),
        (b"\0\0\0\x18ftypmp42", "video"),
        (b"\0\0\0\x14ftypqt  ", "video"),
        (b"RIFF\0\0\0\0AVI LIST", "video"),
        (b"\x1aE\xdf\xa3", "video"),
        ((b"G" + b"\0" * 187) * 3, "video"),
        (b"\0\0\0\x08wide\0\0\0\0mdat", "video"),
    ],
)
def test_kinds_by_their_first_bytes(tmp_path, content, kind):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert kind_of(path) == kind


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "is empty"),
        (b"GIF89a", "a GIF picture"),
        (b"RIFF\0\0\0\0WEBPVP8 ", "a WebP picture"),
        (b"\0\0\0\x18ftypheic", "a HEIF or AVIF picture"),
        (b"#?RADIANCE\n", "a Radiance picture"),
        ("schema = 'straße'\n".encode() * 40, "a text file"),
        (b"\0\1\2\3", "of an unknown kind or damaged"),
        (b"\xff", "of an unknown kind or damaged"),
    ],
)
def test_other_content_is_named_in_one_line(tmp_path, content, text):
    path = tmp_path / "shot.png"
    path.write_bytes(content)
    with pytest.raises(ImageError, match=text) as caught:
        read_image(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, text in [
        ("", "is a folder"),
        ("no.png", "does not exist"),
        ("pipe", "not a regular"),
    ]:
        with pytest.raises(ImageError, match=text):
            read_image(tmp_path / name)
    with pytest.raises(ImageError):
        read_image("a\0b.png")
    with pytest.raises(ImageError):
        read_image("a" * 5000)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux allows such names")
def test_names_may_be_any_bytes(tmp_path, mosaic):
    for name in (b"\xff.dng", "é [x] %d|concat:.dng".encode()):
        path = tmp_path / os.fsdecode(name)
        write_dng(path, mosaic, white=4095)
        assert read_image(path).mosaic is not None


def test_a_still_has_no_frames(tmp_path):
    path = tmp_path / "a.png"
    write_png16(path, np.zeros((3, 4, 5)))
    with pytest.raises(ConfigError, match="leave --frame 0 out"):
        read_image(path, frame=0)


def test_reading_prints_nothing_and_leaves_stderr_alone(tmp_path, capfd):
    path = tmp_path / "a.png"
    write_png16(path, np.zeros((3, 4, 5)))
    read_image(path)
    os.write(2, b"still here")
    assert capfd.readouterr() == ("", "still here")
