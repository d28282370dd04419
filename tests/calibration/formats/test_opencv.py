"""Files as OpenCV's programs write them."""

import pytest

from calibration.formats.convert import import_camera
from toolkit.errors import ConfigError

# samples/cpp/tutorial_code/calib3d/camera_calibration
SAMPLE = """%YAML:1.0
---
calibration_time: "Wed 02 Nov 2011 07:56:46 PM CET"
nr_of_frames: 25
image_width: 640
image_height: 480
board_width: 9
board_height: 6
square_size: 50.
fix_aspect_ratio: 1.
# flags: +fix_aspectRatio +fix_principal_point +zero_tangent_dist
flags: 14
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.5746697944293521e+002, 0., 3.1950000000000000e+002, 0.,
       6.5746697944293521e+002, 2.3950000000000000e+002, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -4.1802327176423804e-001, 5.0715244063187526e-001, 0., 0.,
       -5.7843597214487474e-001 ]
avg_reprojection_error: 3.8441346462381640e-001
per_view_reprojection_errors: !!opencv-matrix
   rows: 2
   cols: 1
   dt: f
   data: [ 5.18280983e-01, 4.84866768e-01 ]
"""
# apps/interactive-calibration
INTERACTIVE = """<?xml version="1.0"?>
<opencv_storage>
<calibrationDate>"Thu 07 Apr 2016 04:23:03 PM MSK"</calibrationDate>
<framesCount>21</framesCount>
<cameraResolution>
  1280 720</cameraResolution>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    1.2519588293098975e+03 0. 6.6684948780852471e+02 0.
    1.2519588293098975e+03 3.6298123112613683e+02 0. 0. 1.</data></camera_matrix>
<camera_matrix_std_dev type_id="opencv-matrix">
  <rows>4</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    0. 1.2887048808572649e+01 2.8536856683866230e+00
    2.8341737483430314e+00</data></camera_matrix_std_dev>
<distortion_coefficients type_id="opencv-matrix">
  <rows>1</rows>
  <cols>5</cols>
  <dt>d</dt>
  <data>
    1.3569117181595716e-01 -8.2513063822554633e-01 0. 0.
    1.6412101575010554e+00</data></distortion_coefficients>
<avg_reprojection_error>2.8182165864e-01</avg_reprojection_error>
</opencv_storage>
"""
FISHEYE = """{
    "image_width": 1280,
    "image_height": 960,
    "fisheye_model": 1,
    "camera_matrix": {
        "type_id": "opencv-matrix",
        "rows": 3,
        "cols": 3,
        "dt": "d",
        "data": [ 561.25, 0.0, 641.5, 0.0, 562.5, 480.0, 0.0, 0.0, 1.0 ]
    },
    "distortion_coefficients": {
        "type_id": "opencv-matrix",
        "rows": 4,
        "cols": 1,
        "dt": "d",
        "data": [ -0.01, 0.02, -0.03, 0.004 ]
    }
}
"""


def write(folder, text, name="camera.yml"):
    path = folder / name
    path.write_text(text)
    return path


def test_file_of_the_calibration_sample(tmp_path):
    found = import_camera(write(tmp_path, SAMPLE))
    camera = found.camera
    assert (camera.width, camera.height, camera.model) == (640, 480, "pinhole")
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (
        657.46697944293521,
        657.46697944293521,
        319.5,
        239.5,
    )
    assert camera.distortion == (
        -0.41802327176423804,
        0.50715244063187526,
        0,
        0,
        -0.57843597214487474,
    )
    assert camera.covariance is None
    assert found.rms_px == pytest.approx(0.38441346)


def test_file_of_interactive_calibration(tmp_path):
    found = import_camera(write(tmp_path, INTERACTIVE))
    assert (found.camera.width, found.camera.height) == (1280, 720)
    assert found.camera.cx == 666.84948780852471
    assert found.camera.distortion[4] == 1.6412101575010554


def test_fisheye_is_told_by_its_flag(tmp_path):
    camera = import_camera(write(tmp_path, FISHEYE)).camera
    assert (camera.model, camera.distortion) == ("fisheye", (-0.01, 0.02, -0.03, 0.004))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("image_width: 640\n", ""), "image_width and image_height are missing"),
        (("image_width: 640\n", "image_width: 0\n"), "whole numbers of pixels"),
        (("camera_matrix:", "matrix:"), "camera_matrix is missing"),
        (("rows: 3\n   cols: 3\n   dt: d\n   data: [", "rows: 3\n   data: [ 1.,"), "9 numbers"),
        (("[ 6.5746697944293521e+002, 0.,", "[ 657., 3.,"), "skew of 3"),
        (("[ 6.5746697944293521e+002, 0.,", "[ -657., 0.,"), "positive fx"),
        (("[ 6.5746697944293521e+002, 0.,", "[ .Nan, 0.,"), "a finite number is needed"),
        (("[ -4.1802327176423804e-001,", "[ a,"), "something else than numbers"),
        (("[ -4.1802327176423804e-001,", "[ 1., 1.,"), "has 6 coefficients"),
        (("fisheye_model: 0", "fisheye_model: 1"), "4 numbers are needed"),
    ],
)
def test_what_is_missing_or_impossible_is_named(tmp_path, change, reason):
    assert change[0] in SAMPLE
    with pytest.raises(ConfigError, match=reason) as caught:
        import_camera(write(tmp_path, SAMPLE.replace(*change)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [12, 14])
def test_thin_prisms_are_refused_unless_they_are_none(tmp_path, count):
    terms = [-0.4, 0.5, 0.001, 0.002, -0.5, 0.1, 0.0, 0.0]
    rest = SAMPLE[SAMPLE.index("[ -4.18") : SAMPLE.index("avg_")]
    straight = SAMPLE.replace(rest, f"{[*terms, *[0.0] * (count - 8)]}\n")
    assert import_camera(write(tmp_path, straight)).camera.distortion == tuple(terms)
    bent = SAMPLE.replace(rest, f"{[*terms, 0.01, *[0.0] * (count - 9)]}\n")
    with pytest.raises(ConfigError, match="thin prism"):
        import_camera(write(tmp_path, bent))


def test_a_file_that_claims_to_be_huge_takes_no_room(tmp_path):
    claims = SAMPLE.replace("rows: 3\n   cols: 3", "rows: 30000\n   cols: 30000")
    assert import_camera(write(tmp_path, claims)).camera.cx == 319.5
    long = SAMPLE.replace(
        "[ 6.5746697944293521e+002", "[" + "1., " * 50 + "6.5746697944293521e+002"
    )
    with pytest.raises(ConfigError, match="at most 20 numbers"):
        import_camera(write(tmp_path, long))
