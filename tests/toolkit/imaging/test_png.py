import struct
import zlib

import numpy as np
import pytest
import torch
from PIL import Image

from toolkit.errors import EnvironmentFault, ImageError, ShapeError
from toolkit.imaging import read_image, write_png16
from toolkit.imaging.metadata import exif_block


def decode_srgb(brightness):
    return np.where(
        brightness <= 0.04045, brightness / 12.92, ((brightness + 0.055) / 1.055) ** 2.4
    )


@pytest.fixture
def bytes_rgb(rng):
    return rng.integers(0, 256, (12, 17, 3), dtype=np.uint8)


@pytest.fixture
def words_rgb(rng):
    return rng.integers(0, 65536, (12, 17, 3), dtype=np.uint16)


def test_eight_bits_are_taken_for_srgb(make_png, bytes_rgb):
    image = read_image(make_png(bytes_rgb))
    np.testing.assert_allclose(
        image.rgb[0], decode_srgb(bytes_rgb / 255).transpose(2, 0, 1), atol=1e-6
    )
    assert image.rgb.dtype == torch.float32
    assert (image.response, image.response_is_assumed) == ("srgb", True)
    assert image.exposure is None
    expected = (bytes_rgb == 255).any(axis=2)
    assert np.array_equal(image.clipped[0, 0], expected)


def test_sixteen_bits_keep_their_depth_and_are_taken_for_linear(make_png, words_rgb):
    words_rgb[0, 0] = (65535, 257, 0)
    image = read_image(make_png(words_rgb, depth=16))
    np.testing.assert_allclose(image.rgb[0], words_rgb.transpose(2, 0, 1) / 65535, atol=1e-7)
    assert (image.response, image.response_is_assumed) == ("linear", True)
    assert bool(image.clipped[0, 0, 0, 0])


@pytest.mark.parametrize(("depth", "white"), [(8, 255), (16, 65535)])
def test_grey_gives_three_equal_channels(make_png, bytes_rgb, depth, white):
    grey = bytes_rgb[..., 0].astype(np.uint16) * (white // 255)
    image = read_image(make_png(grey, depth=depth, kind=0), response="linear")
    for channel in range(3):
        np.testing.assert_allclose(image.rgb[0, channel], grey / white, atol=1e-6)
    assert not image.response_is_assumed


@pytest.mark.parametrize("kind", [4, 6])
def test_alpha_is_dropped_when_opaque_and_refused_when_not(make_png, bytes_rgb, kind):
    colour = bytes_rgb if kind == 6 else bytes_rgb[..., :1]
    values = np.concatenate([colour, np.full((12, 17, 1), 255, np.uint8)], axis=2)
    image = read_image(make_png(values, kind=kind), response="linear")
    expected = np.broadcast_to(colour / 255, (12, 17, 3)).transpose(2, 0, 1)
    np.testing.assert_allclose(image.rgb[0], expected, atol=1e-6)
    values[3, 4, -1] = 254
    with pytest.raises(ImageError, match="transparent"):
        read_image(make_png(values, kind=kind))


@pytest.mark.parametrize(("mode", "text"), [("P", "palette"), ("1", "under 8 bits")])
def test_palettes_and_few_bits_are_refused(tmp_path, bytes_rgb, mode, text):
    path = tmp_path / "few.png"
    Image.fromarray(bytes_rgb).convert(mode).save(path)
    with pytest.raises(ImageError, match=text):
        read_image(path)


def test_animation_is_refused(make_png, bytes_rgb):
    with pytest.raises(ImageError, match="animated"):
        read_image(make_png(bytes_rgb, before=[(b"acTL", struct.pack(">II", 2, 0))]))


def test_size_bomb_is_refused_before_decoding(make_png, bytes_rgb):
    with pytest.raises(ImageError, match=r"announces 100000 x 100000 pixels"):
        read_image(make_png(bytes_rgb, size=(100_000, 100_000)))


@pytest.mark.parametrize("rows", [1, 11])
def test_good_checksums_over_half_a_picture_are_no_help(make_png, bytes_rgb, rows):
    with pytest.raises(ImageError, match="damaged PNG"):
        read_image(make_png(bytes_rgb, rows=rows))


def test_orientation_is_not_applied_and_exposure_is_found(tmp_path, bytes_rgb):
    exif = Image.Exif()
    exif[274] = 6
    exif.get_ifd(34665)[33434] = 0.004
    path = tmp_path / "turned.png"
    Image.fromarray(bytes_rgb).save(path, exif=exif)
    image = read_image(path, response="linear")
    np.testing.assert_allclose(image.rgb[0], bytes_rgb.transpose(2, 0, 1) / 255, atol=1e-6)
    assert image.exposure.tolist() == [0.004]


def test_the_file_states_its_encoding(make_png, bytes_rgb, words_rgb):
    linear = make_png(bytes_rgb, before=[(b"gAMA", struct.pack(">I", 100_000))])
    image = read_image(linear)
    assert (image.response, image.response_is_assumed) == ("linear", False)
    srgb = make_png(words_rgb, depth=16, before=[(b"sRGB", b"\0")])
    image = read_image(srgb)
    assert (image.response, image.response_is_assumed) == ("srgb", False)
    np.testing.assert_allclose(
        image.rgb[0], decode_srgb(words_rgb / 65535).transpose(2, 0, 1), atol=1e-6
    )
    assert read_image(srgb, response="linear").response == "linear"


def test_damaged_exif_costs_only_the_exposure(make_png, bytes_rgb):
    block = bytearray(exif_block(0.01))
    block[8:] = b"\xff" * (len(block) - 8)
    image = read_image(make_png(bytes_rgb, before=[(b"eXIf", bytes(block))]))
    assert image.exposure is None


def test_written_light_comes_back(tmp_path, rng):
    light = rng.uniform(-0.1, 1.2, (3, 14, 9))
    path = tmp_path / "light.png"
    write_png16(path, light, exposure_s=1 / 320)
    image = read_image(path)
    np.testing.assert_allclose(image.rgb[0], light.clip(0, 1), atol=0.5 / 65535 + 1e-7)
    assert image.exposure.item() == pytest.approx(1 / 320, rel=1e-9)
    assert (image.response, image.response_is_assumed) == ("linear", False)
    assert np.array_equal(image.clipped[0, 0], (light >= 1 - 0.5 / 65535).any(axis=0))
    with Image.open(path) as other:
        assert other.size == (9, 14)
        assert other.getexif().get_ifd(34665)[33434] == pytest.approx(1 / 320)
    write_png16(path, torch.from_numpy(light).float())
    assert read_image(path).exposure is None


@pytest.mark.parametrize("shape", [(1, 3, 4, 4), (4, 4, 3), (4, 4)])
def test_writing_needs_three_planes(tmp_path, shape):
    with pytest.raises(ShapeError, match=r"\[3, H, W\]"):
        write_png16(tmp_path / "a.png", np.zeros(shape))


def test_writing_refuses_what_it_cannot_hold(tmp_path):
    with pytest.raises(ImageError, match="not finite"):
        write_png16(tmp_path / "a.png", np.full((3, 4, 4), np.nan))
    with pytest.raises(EnvironmentFault, match="cannot be written"):
        write_png16(tmp_path / "nowhere" / "a.png", np.zeros((3, 4, 4)))
    assert list(tmp_path.iterdir()) == []


def test_damage_is_never_missed(tmp_path, rng, check_damage):
    path = tmp_path / "a.png"
    write_png16(path, rng.random((3, 20, 30)), exposure_s=0.01)
    counts = check_damage(path, rng)
    assert counts["cut read"] == counts["flip read"] == 0


def test_a_header_without_picture(tmp_path):
    body = b"IEND"
    path = tmp_path / "a.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + b"\0\0\0\0" + body + struct.pack(">I", zlib.crc32(body))
    )
    with pytest.raises(ImageError, match="without a picture"):
        read_image(path)
