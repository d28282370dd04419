import tomllib

import pytest
import torch

from toolkit.camera import Camera
from toolkit.camera_file import fit_camera, read_camera, write_camera
from toolkit.errors import ConfigError, EnvironmentFault, MismatchError
from toolkit.toml_text import to_toml
from toolkit.types import LinearImage

BIG = {"width": 1280, "height": 960, "covariance": None}
NOTES = {"rms_px": 0.18, "views": 3, "images": ["a.jpg", 'odd "name".jpg']}


def make_camera(**changes):
    spread = torch.randn(8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    spread = torch.tensor([2, 2, 1, 1, 1e-3, 1e-2, 1e-5, 1e-5]).double()[:, None] * spread
    settings = {
        "width": 640,
        "height": 480,
        "fx": 533.25,
        "fy": 533.5,
        "cx": 342.125,
        "cy": 1 / 3,
        "distortion": (-0.28, 0.09, 1e-17, -4e-4),
        "covariance": spread @ spread.T,
    }
    return Camera(**settings | changes)


def valid_table():
    return {
        "width": 640,
        "height": 480,
        "model": "pinhole",
        "fx": 533,
        "fy": 533.5,
        "cx": 342.1,
        "cy": 235.0,
        "distortion": [],
    }


def written(path, table):
    path.write_text(to_toml("camera", table))
    return path


def test_a_camera_comes_back_bit_for_bit(tmp_path):
    camera, path = make_camera(), tmp_path / "camera.toml"
    write_camera(path, camera, **NOTES)
    back = read_camera(path)
    assert torch.equal(back.parameters, camera.parameters)
    assert torch.equal(back.covariance, camera.covariance)
    assert (back.width, back.height, back.model) == (640, 480, "pinhole")
    table = tomllib.loads(path.read_text())
    assert table["schema"] == "toolkit.camera/1"
    assert {key: table[key] for key in NOTES} == NOTES


def test_only_size_model_intrinsics_and_distortion_are_required(tmp_path):
    camera = read_camera(written(tmp_path / "camera.toml", valid_table()))
    assert camera == Camera(width=640, height=480, fx=533.0, fy=533.5, cx=342.1, cy=235.0)
    assert isinstance(camera.fx, float)


@pytest.mark.parametrize("key", list(valid_table()))
def test_a_missing_key_is_named(tmp_path, key):
    table = valid_table()
    del table[key]
    with pytest.raises(ConfigError, match=rf"camera\.toml: {key} missing"):
        read_camera(written(tmp_path / "camera.toml", table))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"focal": 3.0}, "unknown key 'focal'"),
        ({"width": 640.5}, "'width' is 640.5"),
        ({"fx": "533"}, "'fx' is '533'"),
        ({"fx": True}, "'fx' is True"),
        ({"fx": -5.0}, "positive fx"),
        ({"fx": 10**400}, "hundreds of digits"),
        ({"model": "spherical"}, "camera model 'spherical' is unknown"),
        ({"distortion": [0.1]}, "1 distortion coefficients"),
        ({"distortion": [0.1, "b", 0.0, 0.0]}, "'b' stands where a number is needed"),
        ({"covariance": [[1.0]]}, "covariance is not 4x4"),
        ({"covariance": [1.0, 2.0, 3.0, 4.0]}, "covariance is not 4x4"),
        ({"covariance": [[1.0, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "symmetric"),
        ({"covariance": [[1.0, 2, 0, 0], [2, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "eigenvalue"),
        ({"covariance": [[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "eigenvalue"),
        ({"rms_px": -1.0}, "rms_px is -1.0"),
        ({"views": -1}, "views must be a count"),
        ({"images": [3]}, "images a list of names"),
    ],
)
def test_bad_values_are_named(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=rf"camera\.toml.*{message}"):
        read_camera(written(tmp_path / "camera.toml", valid_table() | changes))


@pytest.mark.parametrize(
    "line", ["fx = nan", "fx = inf", "rms_px = nan", "distortion = [nan,0,0,0]"]
)
def test_nan_is_refused_on_reading(tmp_path, line):
    key = line.split()[0]
    table = {name: value for name, value in valid_table().items() if name != key}
    path = tmp_path / "camera.toml"
    path.write_text(to_toml("camera", table) + line + "\n")
    with pytest.raises(ConfigError, match="finite"):
        read_camera(path)


def test_nan_in_the_covariance_is_refused_both_ways(tmp_path):
    path = tmp_path / "camera.toml"
    bad = make_camera(covariance=torch.full((8, 8), torch.nan))
    with pytest.raises(ConfigError, match="'covariance' holds nan"):
        write_camera(path, bad, **NOTES)
    assert not path.exists()
    path.write_text(
        to_toml("camera", valid_table()) + f"covariance = {[['nan'] * 4] * 4}".replace("'", "")
    )
    with pytest.raises(ConfigError, match="covariance holds a value that is not a finite number"):
        read_camera(path)


def test_another_kind_of_file_is_refused(tmp_path):
    path = tmp_path / "ball.toml"
    path.write_text(to_toml("ball", valid_table()))
    with pytest.raises(ConfigError, match=r"schema 'toolkit\.ball/1'"):
        read_camera(path)


def test_a_failed_write_leaves_the_older_file(tmp_path):
    path = tmp_path / "camera.toml"
    write_camera(path, make_camera(), **NOTES)
    before = path.read_bytes()
    with pytest.raises(ConfigError):
        write_camera(path, make_camera(), **NOTES | {"rms_px": float("nan")})
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["camera.toml"]
    with pytest.raises(EnvironmentFault, match="cannot be written"):
        write_camera(tmp_path / "absent" / "camera.toml", make_camera(), **NOTES)


def picture(width, height, crop=None):
    return LinearImage(
        rgb=torch.zeros(1, 3, height, width),
        clipped=torch.zeros(1, 1, height, width, dtype=torch.bool),
        crop=crop,
    )


def test_fit_camera_keeps_a_camera_of_the_same_size():
    camera = make_camera(**BIG)
    assert fit_camera(camera, picture(1280, 960)) is camera


def test_fit_camera_follows_a_known_crop():
    camera = make_camera(**BIG)
    fitted = fit_camera(camera, picture(1200, 900, crop=(48, 30, 1280, 960)))
    assert fitted == camera.cropped(48, 30, 1200, 900)


@pytest.mark.parametrize("size", [(640, 480), (427, 320), (320, 241), (2560, 1920)])
def test_fit_camera_follows_a_whole_number_scale(size):
    camera = make_camera(**BIG)
    assert fit_camera(camera, picture(*size)) == camera.resized(*size)


@pytest.mark.parametrize("size", [(840, 630), (640, 360), (1280, 720), (1278, 960), (640, 500)])
def test_fit_camera_refuses_other_sizes(size):
    with pytest.raises(MismatchError, match=r"1280x960.*calibrate from the same kind of file"):
        fit_camera(make_camera(**BIG), picture(*size))


def test_fit_camera_explains_a_turned_picture():
    with pytest.raises(MismatchError, match="turned by 90 degrees"):
        fit_camera(make_camera(**BIG), picture(960, 1280))
