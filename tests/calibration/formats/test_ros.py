"""Files as ROS's camera_calibration and camera drivers write them."""

import pytest

from calibration.formats.convert import import_camera
from toolkit.errors import ConfigError

OST = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [526.6908296825479, 0, 312.3333507245396, 0, 525.7542623070541,
         246.2279496394374, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.01864117263397289, -0.0807953154457166, 0.0006701578887838996, -1e-05, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [516.2001953125, 0, 310.3634868958034, 0, 0, 514.0494995117188,
         246.8852026000968, 0, 0, 0, 1, 0]
"""
MESSAGE = """header:
  stamp:
    sec: 12
  frame_id: "camera: front"
height: 720
width: 1280
distortion_model: rational_polynomial
D:
- 0.3
- -0.2
- 0.0001
- -0.0002
- 0.01
- 0.6
- -0.1
- 0.03
K: [640.5, 0.0, 639.25, 0.0, 641.5, 359.75, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [640.5, 0.0, 639.25, 0.0, 0.0, 641.5, 359.75, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
roi:
  x_offset: 0
  do_rectify: false
---
"""


def read(folder, text):
    path = folder / "ost.yaml"
    path.write_text(text)
    return import_camera(path)


def test_file_of_camera_calibration(tmp_path):
    found = read(tmp_path, OST)
    camera = found.camera
    assert (found.format, found.name) == ("ros", "narrow_stereo")
    assert (camera.width, camera.height, camera.model) == (640, 480, "pinhole")
    assert (camera.fx, camera.fy) == (526.6908296825479, 525.7542623070541)
    assert (camera.cx, camera.cy) == (312.3333507245396, 246.2279496394374)
    assert camera.distortion == (
        0.01864117263397289,
        -0.0807953154457166,
        0.0006701578887838996,
        -1e-05,
        0,
    )
    assert "rectification" in found.cautions[0]


def test_message_as_it_is_printed(tmp_path):
    found = read(tmp_path, MESSAGE)
    camera = found.camera
    assert (camera.width, camera.height, camera.model) == (1280, 720, "rational")
    assert camera.distortion == (0.3, -0.2, 0.0001, -0.0002, 0.01, 0.6, -0.1, 0.03)
    assert len(found.cautions) == 1  # nothing is rectified


def test_equidistant_is_a_fisheye(tmp_path):
    text = OST.replace("plumb_bob", "equidistant").replace("cols: 5", "cols: 4")
    camera = read(tmp_path, text.replace("-1e-05, 0]", "-1e-05]")).camera
    assert (camera.model, len(camera.distortion)) == ("fisheye", 4)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("plumb_bob", "thin_prism"), "distortion_model is 'thin_prism', which no camera"),
        (("plumb_bob", "equidistant"), "4 numbers are needed"),
        (("image_width: 640\n", ""), "image_width missing"),
        (("[526.6908296825479", "[0"), "not calibrated"),
        (("[526.6908296825479, 0", "[526.6908296825479, 2.5"), "skew of 2.5"),
        (("246.2279496394374, 0, 0, 1]", "246.2279496394374, 0, 1]"), "9 numbers are needed"),
        (("246.2279496394374, 0, 0, 1]", "246.2279496394374, 0, 0, 1"), "never closed|no list"),
        (("image_height: 480", "image_height: tall"), "a finite number is needed"),
        (("camera_name: narrow_stereo", "image_width: 3"), "a second time"),
        (("camera_name: narrow_stereo", "\timage: 3"), "tab"),
    ],
)
def test_what_is_missing_or_impossible_is_named(tmp_path, change, reason):
    assert change[0] in OST
    with pytest.raises(ConfigError, match=reason) as caught:
        read(tmp_path, OST.replace(*change))
    assert "\n" not in str(caught.value)
