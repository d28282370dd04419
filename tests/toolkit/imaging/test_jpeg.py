import numpy as np
import pytest
import simplejpeg
from PIL import Image

from toolkit.errors import ImageError
from toolkit.imaging import read_image


@pytest.fixture
def smooth(rng):
    rows, columns = np.indices((64, 90))
    picture = np.stack([rows * 3, columns * 2, rows + columns], axis=-1)
    return (picture + rng.integers(0, 20, picture.shape)).astype(np.uint8)


def save(path, values, *, mode=None, **options):
    exif = Image.Exif()
    exif[274] = 6
    exif[33434] = 0.02
    exif.get_ifd(34665)[33434] = 0.008
    picture = Image.fromarray(values)
    (picture.convert(mode) if mode else picture).save(
        path, "jpeg", exif=exif, quality=95, **options
    )
    return path


def test_pixels_stay_where_they_are(tmp_path, smooth):
    path = save(tmp_path / "a.jpg", smooth)
    image = read_image(path, response="linear")
    assert tuple(image.rgb.shape) == (1, 3, 64, 90)
    stored = simplejpeg.decode_jpeg(path.read_bytes())
    np.testing.assert_allclose(image.rgb[0], stored.transpose(2, 0, 1) / 255, atol=1e-6)
    assert image.exposure.tolist() == [0.008]


def test_srgb_is_assumed(tmp_path, smooth):
    image = read_image(save(tmp_path / "a.jpg", smooth))
    assert (image.response, image.response_is_assumed) == ("srgb", True)


def test_grey(tmp_path, smooth):
    image = read_image(save(tmp_path / "a.jpg", smooth[..., 0]), response="linear")
    assert float((image.rgb[0, 0] - image.rgb[0, 2]).abs().max()) == 0
    assert float(abs(image.rgb[0, 0].numpy() - smooth[..., 0] / 255).mean()) < 0.02


def test_printing_colours_are_refused(tmp_path, smooth):
    with pytest.raises(ImageError, match="CMYK JPEG"):
        read_image(save(tmp_path / "a.jpg", smooth, mode="CMYK"))


def test_size_bomb_is_refused_before_decoding(tmp_path, smooth):
    data = bytearray(save(tmp_path / "a.jpg", smooth).read_bytes())
    at = data.index(b"\xff\xc0") + 5
    assert data[at : at + 4] == bytes([0, 64, 0, 90])
    data[at : at + 4] = b"\xea\x60\xea\x60"
    path = tmp_path / "bomb.jpg"
    path.write_bytes(data)
    with pytest.raises(ImageError, match="announces 60000 x 60000 pixels"):
        read_image(path)


@pytest.mark.parametrize("progressive", [False, True])
def test_a_cut_file_is_never_half_a_picture(tmp_path, smooth, rng, check_damage, progressive):
    path = save(tmp_path / "a.jpg", smooth, progressive=progressive)
    counts = check_damage(path, rng)
    assert counts["cut read"] <= 1  # the last two bytes are only the end mark
    assert counts["flip refused"] > 10


def test_the_text_tells_what_to_do(tmp_path, smooth):
    path = save(tmp_path / "a.jpg", smooth)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ImageError, match=r"a\.jpg is a cut or damaged JPEG \(.+\); copy it again"):
        read_image(path)
