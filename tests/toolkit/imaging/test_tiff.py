import struct

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, TiffImagePlugin

from toolkit.errors import ImageError
from toolkit.imaging import read_image


@pytest.fixture
def colours(rng):
    return rng.random((20, 31, 3))


def write(path, values, **options):
    options.setdefault("photometric", "rgb" if values.ndim == 3 else "minisblack")
    tifffile.imwrite(path, values, **options)
    return path


@pytest.mark.parametrize(
    ("dtype", "white", "response", "assumed"),
    [
        (np.uint8, 255, "srgb", True),
        (np.uint16, 65535, "linear", True),
        (np.float16, 1, "linear", False),
        (np.float32, 1, "linear", False),
        (np.float64, 1, "linear", False),
    ],
)
@pytest.mark.parametrize("packing", [None, "deflate"])
def test_depths(tmp_path, colours, dtype, white, response, assumed, packing):
    stored = (colours * white).astype(dtype)
    path = write(tmp_path / "a.tif", stored, compression=packing)
    image = read_image(path, response="linear")
    np.testing.assert_allclose(
        image.rgb[0], (stored / white).transpose(2, 0, 1), atol=1e-6, rtol=1e-5
    )
    image = read_image(path)
    assert (image.response, image.response_is_assumed) == (response, assumed)


def test_grey_planes_tiles_strips_and_alpha(tmp_path, colours):
    stored = (colours * 65535).astype(np.uint16)
    expected = (stored / 65535).transpose(2, 0, 1)
    opaque = np.dstack([stored, np.full((20, 31), 65535, np.uint16)])
    files = [
        write(tmp_path / "strips.tif", stored, rowsperstrip=3),
        write(tmp_path / "tiles.tif", stored, tile=(16, 16)),
        write(tmp_path / "planes.tif", stored.transpose(2, 0, 1), planarconfig="separate"),
        write(tmp_path / "alpha.tif", opaque, extrasamples=["unassalpha"]),
        write(tmp_path / "big.tif", stored, byteorder=">"),
        write(tmp_path / "large.tif", stored, bigtiff=True),
    ]
    for path in files:
        np.testing.assert_allclose(read_image(path).rgb[0], expected, atol=1e-6, err_msg=path.name)
    grey = read_image(write(tmp_path / "grey.tif", stored[..., 0]))
    np.testing.assert_allclose(grey.rgb[0, 1], stored[..., 0] / 65535, atol=1e-6)
    opaque[2, 3, 3] = 7
    with pytest.raises(ImageError, match="transparent"):
        read_image(write(tmp_path / "alpha.tif", opaque, extrasamples=["unassalpha"]))


@pytest.mark.parametrize("packing", ["raw", "tiff_lzw", "tiff_adobe_deflate", "packbits"])
@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_orientation_is_not_applied(tmp_path, colours, packing, orientation):
    stored = (colours * 255).astype(np.uint8)
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[274] = orientation
    path = tmp_path / "a.tif"
    Image.fromarray(stored).save(path, "tiff", compression=packing, tiffinfo=tags)
    image = read_image(path, response="linear")
    np.testing.assert_allclose(image.rgb[0], stored.transpose(2, 0, 1) / 255, atol=1e-6)


def test_lzw_of_sixteen_bits_keeps_its_depth(tmp_path, colours):
    stored = (colours * 65535).astype(np.uint16)
    path = tmp_path / "a.tif"
    assert cv2.imwrite(str(path), stored[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    np.testing.assert_allclose(
        read_image(path).rgb[0], stored.transpose(2, 0, 1) / 65535, atol=1e-6
    )


def test_exposure(tmp_path, colours):
    path = write(
        tmp_path / "a.tif", colours.astype(np.float32), extratags=[(33434, "2I", 1, (1, 640), True)]
    )
    assert read_image(path).exposure.tolist() == [1 / 640]


def test_floats_beyond_white_are_clipped_and_unscaled_ones_refused(tmp_path, colours):
    light = colours.astype(np.float32)
    light[4, 5, 1] = 1.5
    image = read_image(write(tmp_path / "a.tif", light))
    assert image.clipped.sum() == 1
    assert bool(image.clipped[0, 0, 4, 5])
    with pytest.raises(ImageError, match="values up to 300; scale it so that sensor white is 1"):
        read_image(write(tmp_path / "a.tif", light * 200))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path, colours, value):
    light = colours.astype(np.float32)
    light[4, 5, 1] = value
    with pytest.raises(ImageError, match="not finite"):
        read_image(write(tmp_path / "a.tif", light))


def test_pages_are_not_dropped(tmp_path, colours):
    stored = (colours * 255).astype(np.uint8)
    path = tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as file:
        for _ in range(3):
            file.write(stored, photometric="rgb", metadata=None)
    with pytest.raises(ImageError, match="has 3 pages"):
        read_image(path)


def test_a_thumbnail_is_no_second_page(tmp_path, colours):
    stored = (colours * 65535).astype(np.uint16)
    path = tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as file:
        file.write(stored, photometric="rgb", metadata=None)
        file.write(stored[::4, ::4], photometric="rgb", metadata=None, subfiletype=1)
    assert (read_image(path).height, read_image(path).width) == stored.shape[:2]


@pytest.mark.parametrize(
    ("dtype", "options", "text"),
    [
        (np.uint8, {"photometric": "miniswhite"}, "neither grey nor RGB"),
        (np.uint32, {}, "32 bits"),
        (np.int16, {}, "16 bits of a kind"),
        (bool, {}, "1 bits"),
    ],
)
def test_unsupported_kinds_are_refused(tmp_path, colours, dtype, options, text):
    path = write(tmp_path / "a.tif", (colours[..., 0] * 2).astype(dtype), **options)
    with pytest.raises(ImageError, match=text):
        read_image(path)


def test_size_bomb_is_refused_before_decoding(tmp_path, colours):
    path = write(tmp_path / "a.tif", colours.astype(np.float32))
    with tifffile.TiffFile(path) as file:
        places = [file.pages[0].tags[code].valueoffset for code in (256, 257)]
    data = bytearray(path.read_bytes())
    for place in places:
        data[place : place + 4] = struct.pack("<I", 200_000)
    path.write_bytes(data)
    with pytest.raises(ImageError, match="announces 200000 x 200000"):
        read_image(path)


@pytest.mark.parametrize("packing", ["none", "deflate", "lzw", "lzw16"])
def test_damage(tmp_path, colours, rng, check_damage, packing):
    stored = (colours * 255).astype(np.uint8)
    path = tmp_path / "a.tif"
    if packing == "lzw":
        Image.fromarray(stored).save(path, compression="tiff_lzw")
    elif packing == "lzw16":
        cv2.imwrite(str(path), stored.astype(np.uint16) * 200, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    else:
        write(path, stored, compression=None if packing == "none" else packing)
    counts = check_damage(path, rng)
    assert counts["cut read"] == 0
    assert counts["flip refused"] > 0
