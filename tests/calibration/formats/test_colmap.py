"""cameras.txt as COLMAP writes it."""

import pytest
import torch

from calibration.formats.convert import import_camera
from toolkit.errors import ConfigError

CAMERAS = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 7
1 SIMPLE_PINHOLE 3072 2304 2559.81 1536 1152
2 PINHOLE 3072 2304 2560.56 2560.5 1536.5 1152.25
3 SIMPLE_RADIAL 3072 2304 2559.69 1536 1152 -0.0218531
4 RADIAL 3072 2304 2559.69 1536 1152 -0.0218531 0.003
5 OPENCV 1920 1080 1500.5 1501.5 960 540 -0.1 0.02 0.001 -0.002
6 FULL_OPENCV 1920 1080 1500.5 1501.5 960 540 0.3 -0.2 1e-4 -2e-4 0.01 0.6 -0.1 0.03
7 OPENCV_FISHEYE 1920 1080 800.5 801.5 960 540 -0.01 0.02 -0.03 0.004
8 RADIAL_FISHEYE 1920 1080 800.5 960 540 -0.01 0.02
9 FOV 1920 1080 800.5 801.5 960 540 0.9
"""


@pytest.fixture
def cameras(tmp_path):
    path = tmp_path / "cameras.txt"
    path.write_text(CAMERAS)
    return path


@pytest.mark.parametrize(
    ("name", "model", "focal", "distortion"),
    [
        ("1", "pinhole", (2559.81, 2559.81), ()),
        ("2", "pinhole", (2560.56, 2560.5), ()),
        ("3", "pinhole", (2559.69, 2559.69), (-0.0218531, 0, 0, 0)),
        ("4", "pinhole", (2559.69, 2559.69), (-0.0218531, 0.003, 0, 0)),
        ("5", "pinhole", (1500.5, 1501.5), (-0.1, 0.02, 0.001, -0.002)),
        ("6", "rational", (1500.5, 1501.5), (0.3, -0.2, 1e-4, -2e-4, 0.01, 0.6, -0.1, 0.03)),
        ("7", "fisheye", (800.5, 801.5), (-0.01, 0.02, -0.03, 0.004)),
        ("8", "fisheye", (800.5, 800.5), (-0.01, 0.02, 0, 0)),
    ],
)
def test_every_model_is_read(cameras, name, model, focal, distortion):
    found = import_camera(cameras, name=name)
    camera = found.camera
    assert (found.format, found.name, camera.model) == ("colmap", name, model)
    assert ((camera.fx, camera.fy), camera.distortion) == (focal, distortion)


def test_the_first_pixels_centre_is_at_one_half_there(cameras):
    """A ray along the axis meets pixel (cx, cy) of COLMAP, half a pixel further than ours."""
    camera = import_camera(cameras, name="2").camera
    ahead = camera.project(torch.tensor([0.0, 0, 1]).double())
    assert (ahead + 0.5).tolist() == [1536.5, 1152.25]
    # the middle of the picture lies at half its width there, between two pixels here
    middle = import_camera(cameras, name="1").camera
    assert (middle.cx, middle.cy) == ((3072 - 1) / 2, (2304 - 1) / 2)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("1 FOV 1920 1080 800.5 801.5 960 540 0.9", "camera 1 has the model 'FOV', which no"),
        ("1 PINHOLE 1920 1080 800.5 960 540", "3 parameters; PINHOLE has 4: fx fy cx cy"),
        ("1 PINHOLE 1920 1080 800.5 a 960 540", "'a' stands where a number is needed"),
        ("1 PINHOLE 1920 1080 800.5 nan 960 540", "a finite number is needed"),
        ("1 PINHOLE 1920 0 800.5 801 960 540", "whole numbers of pixels"),
        ("1 PINHOLE 1920 1080 -800.5 801 960 540", "positive fx"),
        ("1 PINHOLE 19", "is no line CAMERA_ID MODEL"),
    ],
)
def test_bad_lines_are_named(tmp_path, line, reason):
    (tmp_path / "cameras.txt").write_text(line + "\n")
    with pytest.raises(ConfigError, match=reason) as caught:
        import_camera(tmp_path / "cameras.txt", format="colmap")
    assert "\n" not in str(caught.value)


def test_no_camera_is_said(tmp_path):
    (tmp_path / "cameras.txt").write_text("# Number of cameras: 0\n")
    with pytest.raises(ConfigError, match="there is no camera in it"):
        import_camera(tmp_path / "cameras.txt", format="colmap")
