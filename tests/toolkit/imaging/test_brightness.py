import io

import numpy as np
import pytest
import simplejpeg
from PIL import Image

from toolkit.errors import ConfigError, ImageError
from toolkit.imaging import read_image, write_png16
from toolkit.imaging.brightness import read_brightness


@pytest.fixture
def coded():
    """A smooth picture [48, 64, 3] uint8 with a white patch."""
    y, x = np.mgrid[:48, :64]
    picture = np.stack([40 + 2 * x, 60 + 2 * y, 90 + x + y], axis=-1).astype(np.uint8)
    picture[:10, :10] = 255
    return picture


def test_a_jpeg_is_taken_as_it_is_stored(tmp_path, coded):
    path = tmp_path / "a.jpg"
    path.write_bytes(simplejpeg.encode_jpeg(coded, quality=98))
    seen = read_brightness(path)
    assert seen.size == (64, 48)
    assert seen.grey.dtype == np.uint8
    expected = coded @ [0.299, 0.587, 0.114]
    assert np.abs(seen.grey - expected).mean() < 2
    assert seen.clipped[2:8, 2:8].all()
    assert not seen.clipped[12:, 12:].any()


def test_a_grey_jpeg_is_read_too(tmp_path, coded):
    path = tmp_path / "a.jpg"
    path.write_bytes(simplejpeg.encode_jpeg(coded[..., 1:2].copy(), colorspace="GRAY", quality=98))
    assert np.abs(read_brightness(path).grey - coded[..., 1].astype(float)).mean() < 2


def test_orientation_is_left_alone_as_in_a_measurement(tmp_path, coded):
    block = Image.Exif()
    block[274] = 6  # turned by a quarter
    stream = io.BytesIO()
    Image.fromarray(coded).save(stream, "JPEG", exif=block.tobytes(), quality=98)
    path = tmp_path / "turned.jpg"
    path.write_bytes(stream.getvalue())
    assert read_brightness(path).size == (64, 48)
    image = read_image(path)
    assert (image.width, image.height) == (64, 48)


def test_dark_light_is_lifted_to_what_an_eye_takes_for_even(tmp_path):
    light = np.zeros((3, 40, 60))
    light[:, :, 15:], light[:, :, 30:], light[:, :, 45:] = 0.01, 0.04, 0.09
    path = tmp_path / "a.png"
    write_png16(path, light)
    seen = read_brightness(path)
    assert seen.grey.dtype == np.float32
    np.testing.assert_allclose(seen.grey[20, [5, 20, 35, 50]], [0, 85, 170, 255], atol=0.5)
    assert not seen.clipped.any()


def test_what_cannot_be_read_is_named(tmp_path, coded):
    path = tmp_path / "cut.jpg"
    whole = simplejpeg.encode_jpeg(coded, quality=98)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ImageError, match=r"cut\.jpg is a cut or damaged JPEG"):
        read_brightness(path)
    with pytest.raises(ImageError, match="does not exist"):
        read_brightness(tmp_path / "gone.jpg")


def test_a_video_is_no_photo(tmp_path):
    path = tmp_path / "a.avi"
    path.write_bytes(b"RIFF\0\0\0\0AVI LIST" + bytes(500))
    with pytest.raises(ConfigError, match="is a video"):
        read_brightness(path)
