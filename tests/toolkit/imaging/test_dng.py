import numpy as np
import pytest
import rawpy
import tifffile

from toolkit.errors import ConfigError, EnvironmentFault, ShapeError
from toolkit.imaging import write_dng

GBRG = ((1, 2), (0, 1))


def test_rawpy_gives_back_every_value_and_tag(tmp_path, mosaic):
    path = tmp_path / "shot.dng"
    write_dng(
        path,
        mosaic,
        pattern=GBRG,
        black=(60, 61, 62, 63),
        white=4095,
        exposure_s=1 / 800,
        orientation=6,
        camera_matrix=[[0.8, -0.2, 0.0], [-0.5, 1.3, 0.1], [0.0, 0.2, 0.6]],
    )
    with rawpy.imread(str(path)) as raw:
        assert np.array_equal(raw.raw_image, mosaic)
        assert np.array_equal(raw.raw_image_visible, mosaic)
        letters = raw.color_desc.decode()
        for row in range(2):
            for column in range(2):
                index = raw.raw_color(row, column)
                assert "RGB".index(letters[index]) == GBRG[row][column]
                assert raw.black_level_per_channel[index] == 60 + 2 * row + column
        assert raw.white_level == 4095
        assert raw.other.shutter_speed == pytest.approx(1 / 800, rel=1e-6)
        assert raw.sizes.flip == 6
    with tifffile.TiffFile(path) as file:
        ratios = np.reshape(file.pages[0].tags[50721].value, (9, 2))
        np.testing.assert_allclose((ratios[:, 0] / ratios[:, 1])[3:6], [-0.5, 1.3, 0.1])
    assert [p.name for p in tmp_path.iterdir()] == ["shot.dng"]


def test_sixteen_bits(tmp_path, rng):
    values = rng.integers(0, 65536, (30, 40), dtype=np.uint16)
    path = tmp_path / "shot.dng"
    write_dng(path, values, white=65535)
    with rawpy.imread(str(path)) as raw:
        assert np.array_equal(raw.raw_image, values)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"pattern": ((0, 1), (2, 2))}, ShapeError, "one R"),
        ({"pattern": ((0, 1, 1, 2),)}, ShapeError, "not 2 x 2"),
        ({"black": (1, 2)}, ShapeError, "2 values"),
        ({"black": 5000}, ConfigError, "black < white"),
        ({"white": 70000}, ConfigError, "white <= 65535"),
        ({"exposure_s": 0.0}, ConfigError, "exposure time 0.0 s"),
        ({"exposure_s": float("nan")}, ConfigError, "exposure time nan s"),
        ({"camera_matrix": [[1.0, 0.0]]}, ShapeError, "camera_matrix"),
    ],
)
def test_impossible_values_are_refused_and_leave_no_file(tmp_path, mosaic, change, error, text):
    wanted = {"black": 0, "white": 4095, **change}
    with pytest.raises(error, match=text):
        write_dng(tmp_path / "shot.dng", mosaic, **wanted)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "values", [np.zeros((30, 30)), np.zeros((30, 30, 3), np.uint16), np.zeros((30, 21), np.uint16)]
)
def test_a_mosaic_is_uint16_and_flat(tmp_path, values):
    with pytest.raises(ShapeError, match="uint16"):
        write_dng(tmp_path / "shot.dng", values, white=4095)


def test_missing_folder(tmp_path, mosaic):
    with pytest.raises(EnvironmentFault, match="cannot be written"):
        write_dng(tmp_path / "nowhere" / "shot.dng", mosaic)
