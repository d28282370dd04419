import numpy as np
import pytest
import tifffile
import torch

from toolkit.errors import ImageError
from toolkit.imaging import demosaic, read_image, write_dng

XTRANS = (
    (1, 0, 1, 1, 2, 1),
    (2, 1, 2, 0, 1, 0),
    (1, 0, 1, 1, 2, 1),
    (1, 2, 1, 1, 0, 1),
    (0, 1, 0, 2, 1, 2),
    (1, 2, 1, 1, 0, 1),
)
PATTERNS = [((0, 1), (1, 2)), ((1, 0), (2, 1)), ((2, 1), (1, 0)), ((1, 2), (0, 1))]


def tiled(period, shape):
    period = np.asarray(period)
    rows, columns = np.indices(shape)
    return period[rows % period.shape[0], columns % period.shape[1]]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_values_minus_black_over_white_in_every_pattern(tmp_path, mosaic, pattern):
    black = (64, 100, 90, 130)
    path = tmp_path / "shot.raw"
    write_dng(path, mosaic, pattern=pattern, black=black, white=4095, exposure_s=1 / 250)
    image = read_image(path)
    levels = tiled(np.reshape(black, (2, 2)), mosaic.shape)
    expected = (mosaic - levels) / (4095.0 - levels)
    assert image.pattern == pattern
    assert image.mosaic.dtype == torch.float32
    np.testing.assert_allclose(image.mosaic[0, 0], expected, atol=1e-6)
    np.testing.assert_allclose(
        image.rgb[0], demosaic(expected.astype(np.float32), pattern), atol=1e-6
    )
    assert image.exposure.tolist() == [1 / 250]
    assert (image.response, image.response_is_assumed, image.crop) == ("linear", False, None)


def test_noise_below_black_stays_negative(tmp_path, mosaic):
    mosaic[5, 7] = 10
    path = tmp_path / "shot.dng"
    write_dng(path, mosaic, black=64, white=4095)
    image = read_image(path)
    assert float(image.mosaic[0, 0, 5, 7]) == pytest.approx((10 - 64) / (4095 - 64))


def test_black_levels_of_a_larger_period(make_dng, mosaic):
    path = make_dng(mosaic, black=tuple(range(50, 66)), dims=(4, 4))
    levels = tiled(np.arange(50, 66).reshape(4, 4), mosaic.shape)
    expected = (mosaic - levels) / (4095.0 - levels)
    np.testing.assert_allclose(read_image(path).mosaic[0, 0], expected, atol=1e-6)


def test_crop_moves_the_pattern_and_the_black_levels(make_dng, mosaic):
    area, origin, size = (3, 5, 45, 61), (2, 3), (40, 30)
    black = (64, 65, 66, 67)
    pattern = ((1, 0), (2, 1))
    extra = [
        (50829, "I", 4, area, True),
        (50719, "H", 2, origin, True),
        (50720, "H", 2, size, True),
        (274, "H", 1, 6, True),
    ]
    path = make_dng(mosaic, pattern=pattern, black=black, dims=(2, 2), extra=extra)
    image = read_image(path)
    # Where on the sensor the picture begins: its values are found there and nowhere else.
    found = image.mosaic[0, 0].numpy()
    levels = tiled(np.reshape(black, (2, 2)), mosaic.shape)
    levels = np.roll(levels, (area[0], area[1]), axis=(0, 1))
    light = (mosaic - levels) / (4095.0 - levels)
    height, width = found.shape
    places = [
        (top, left)
        for top in range(mosaic.shape[0] - height + 1)
        for left in range(mosaic.shape[1] - width + 1)
        if np.abs(light[top : top + height, left : left + width] - found).max() < 1e-6
    ]
    assert len(places) == 1
    top, left = places[0]
    # libraw rounds the corner to a whole pattern period
    assert abs(top - (area[0] + origin[1])) <= 1
    assert abs(left - (area[1] + origin[0])) <= 1
    expected = [
        [pattern[(top + i - area[0]) % 2][(left + j - area[1]) % 2] for j in range(2)]
        for i in range(2)
    ]
    assert [list(row) for row in image.pattern] == expected
    assert image.crop is not None
    assert image.crop[2] > image.width
    assert image.crop[3] >= image.height


def test_orientation_does_not_turn_the_picture(tmp_path, mosaic):
    for orientation in (1, 3, 6, 8):
        path = tmp_path / f"{orientation}.dng"
        write_dng(path, mosaic, white=4095, orientation=orientation)
        image = read_image(path)
        assert (image.height, image.width) == mosaic.shape
        np.testing.assert_allclose(image.mosaic[0, 0], mosaic / 4095.0, atol=1e-6)


def test_xtrans(make_dng, mosaic):
    path = make_dng(mosaic, pattern=XTRANS, black=(64,))
    image = read_image(path)
    assert image.pattern == XTRANS
    light = (mosaic - 64) / (4095.0 - 64)
    np.testing.assert_allclose(image.mosaic[0, 0], light, atol=1e-6)
    measured = np.take_along_axis(image.rgb[0].numpy(), tiled(XTRANS, mosaic.shape)[None], 0)[0]
    np.testing.assert_allclose(measured, light, atol=1e-6)


def test_a_crop_moves_the_xtrans_pattern(make_dng, rng):
    values = rng.integers(300, 4000, (60, 72), dtype=np.uint16)
    extra = [
        (50829, "I", 4, (2, 4, 58, 70), True),
        (50719, "H", 2, (3, 5), True),
        (50720, "H", 2, (42, 36), True),
    ]
    image = read_image(make_dng(values, pattern=XTRANS, extra=extra))
    left, top, *_ = image.crop
    height, width = image.height, image.width
    begin = (2 + top, 4 + left)
    cut = values[begin[0] : begin[0] + height, begin[1] : begin[1] + width]
    np.testing.assert_allclose(image.mosaic[0, 0], cut / 4095.0, atol=1e-6)
    # The pattern of a DNG starts at the active area's corner.
    expected = np.roll(XTRANS, (-top, -left), axis=(0, 1))
    assert (top % 6, left % 6) != (0, 0)
    assert np.array_equal(image.pattern, expected)


def test_pruned_values_are_refused(tmp_path, mosaic):
    path = tmp_path / "pruned.dng"
    write_dng(path, mosaic, white=4095)
    with tifffile.TiffFile(path) as file:
        place = file.pages[0].tags[279].valueoffset  # StripByteCounts
    data = bytearray(path.read_bytes())
    data[place : place + 4] = (22).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(ImageError, match=r"pruned\.dng lacks a part of its sensor values"):
        read_image(path)


def test_linear_raw_has_no_mosaic(make_dng, rng):
    values = rng.integers(300, 4000, (24, 30, 3), dtype=np.uint16)
    image = read_image(make_dng(values, black=(64, 65, 66)))
    black = np.array([64, 65, 66])
    expected = ((values - black) / (4095.0 - black)).transpose(2, 0, 1)
    np.testing.assert_allclose(image.rgb[0], expected, atol=1e-6)
    assert image.mosaic is None
    assert image.pattern is None


def test_monochrome_raw_is_grey(make_dng, mosaic):
    path = make_dng(mosaic)
    data = path.read_bytes()
    cfa, linear = (
        b"\x06\x01\x03\x00\x01\x00\x00\x00" + code.to_bytes(2, "little") for code in (32803, 34892)
    )
    assert data.count(cfa) == 1
    path.write_bytes(data.replace(cfa, linear))
    image = read_image(path)
    assert image.mosaic is None
    for channel in range(3):
        np.testing.assert_allclose(image.rgb[0, channel], mosaic / 4095.0, atol=1e-6)


@pytest.mark.parametrize(
    ("ratio", "expected"),
    [((1, 100), 0.01), ((1, 1), 1.0), ((0, 1), None), ((1, 0), None), (None, None)],
)
def test_exposure_that_the_file_does_not_tell_is_none(make_dng, mosaic, ratio, expected):
    image = read_image(make_dng(mosaic, exposure=ratio))
    assert (None if image.exposure is None else image.exposure.item()) == expected


def test_clipped_spreads_as_far_as_demosaicing(tmp_path, mosaic):
    mosaic[10, 20] = 4095
    path = tmp_path / "shot.dng"
    write_dng(path, mosaic, white=4095)
    clipped = read_image(path).clipped[0, 0]
    expected = torch.zeros_like(clipped)
    expected[9:12, 19:22] = True
    assert torch.equal(clipped, expected)


def test_a_response_is_applied_to_the_mosaic(tmp_path, mosaic):
    path = tmp_path / "shot.dng"
    write_dng(path, mosaic, white=4095)
    image = read_image(path, response="srgb")
    brightness = mosaic / 4095.0
    expected = np.where(
        brightness <= 0.04045, brightness / 12.92, ((brightness + 0.055) / 1.055) ** 2.4
    )
    np.testing.assert_allclose(image.mosaic[0, 0], expected, atol=1e-6)
    assert image.response == "srgb"


@pytest.mark.parametrize("value", [0, 700])
def test_constant_frame_is_refused(tmp_path, value):
    path = tmp_path / "dark.dng"
    write_dng(path, np.full((24, 30), value, np.uint16), white=4095)
    with pytest.raises(ImageError, match=f"dark.dng has the value {value} everywhere"):
        read_image(path)


def test_values_far_over_white_are_refused_and_a_little_over_white_clipped(tmp_path, mosaic):
    path = tmp_path / "over.dng"
    mosaic[3, 3] = 4000
    write_dng(path, mosaic, white=3900)
    assert bool(read_image(path).clipped[0, 0, 3, 3])
    mosaic[3, 3] = 9000
    write_dng(path, mosaic, white=4095)
    with pytest.raises(ImageError, match="values up to 9000, far above its white level 4095"):
        read_image(path)


def test_black_over_white_is_refused(make_dng, mosaic):
    with pytest.raises(ImageError, match="black level 5000"):
        read_image(make_dng(mosaic, black=(5000,)))


def test_non_square_pixels_are_refused(make_dng, mosaic):
    path = make_dng(mosaic, extra=[(50718, "2I", 2, (2, 1, 1, 1), True)])  # DefaultScale
    with pytest.raises(ImageError, match="not square"):
        read_image(path)


def test_damage(tmp_path, mosaic, rng, check_damage):
    path = tmp_path / "shot.dng"
    write_dng(path, mosaic, black=64, white=4095, exposure_s=0.01)
    counts = check_damage(path, rng)
    assert counts["cut read"] == 0
    assert counts["flip refused"] > 0


def test_nothing_is_printed_about_a_damaged_file(tmp_path, mosaic, capfd):
    path = tmp_path / "shot.dng"
    write_dng(path, mosaic, white=4095)
    path.write_bytes(path.read_bytes()[:400])
    with pytest.raises(ImageError):
        read_image(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("IMG_1361.dng", "lacks a part of its sensor values"),
        ("exiftool_DNG.dng", "lacks a part of its sensor values"),
        ("exiftool_Nikon.nef", "lacks a part of its sensor values|damaged"),
        ("jpeg_named.nef", "RAW name but holds a processed JPEG"),
    ],
)
def test_real_damaged_files_are_refused(shared, name, reason):
    with pytest.raises(ImageError, match=reason) as caught:
        read_image(shared / "raw" / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_reading_keeps_the_mosaic_and_leaves_colours_for_later(tmp_path, rng, monkeypatch):
    path = tmp_path / "shot.dng"
    write_dng(path, rng.integers(64, 4000, (40, 60), dtype=np.uint16), black=64, white=4095)
    asked = []
    monkeypatch.setattr("toolkit.types.demosaic", lambda *_: asked.append(1))
    image = read_image(path)
    assert image.mosaic.shape == (1, 1, 40, 60)
    assert asked == []
    with pytest.raises(TypeError):  # from nothing, which the stand-in gives
        _ = image.rgb
    assert asked == [1]
