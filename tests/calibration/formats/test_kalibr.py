"""Camchains as Kalibr writes them."""

import pytest

from calibration.formats.convert import import_camera
from toolkit.errors import ConfigError

CAMCHAIN = """cam0:
  T_cam_imu:
  - [0.01779318, 0.99967549,-0.01822936, 0.07008565]
  - [-0.9998017, 0.01795239, 0.00860714,-0.01771023]
  - [0.00893160, 0.01807260, 0.99979678, 0.00399246]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 1.1556e-04]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -8.121e-05
cam1:
  T_cn_cnm1:
  - - 0.9994397899015358
    - 0.01583231520610129
    - 0.029486338477008038
    - -0.1982100882850154
  - [-0.014069141538300084, 0.9981545353408604, -0.05907269110882186, -0.003226884424352984]
  - [-0.03037716994712894, 0.05862475052124023, 0.9978181061738522, 0.0003909535695235701]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs:
  - -0.0016509958435871643
  - 0.02440114401500006
  - -0.03832583051
  - 0.0189
  distortion_model: equidistant
  intrinsics: [190.97847715128717, 190.9733070521226, 254.93170605935475, 256.8974428996504]
  resolution: [512, 512]
  rostopic: /cam1/image_raw
cam2:
  cam_overlaps: []
  camera_model: ds
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [-0.19963086018860057, 0.592, 317.552559595926, 316.17, 724.85, 546.5]
  resolution: [1440, 1080]
  rostopic: /cam2/image_raw
"""
ONE = """cam0:
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
"""


@pytest.fixture
def camchain(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(CAMCHAIN)
    return path


@pytest.mark.parametrize("name", ["cam0", "0"])
def test_radtan_is_opencvs_four_terms(camchain, name):
    found = import_camera(camchain, name=name)
    camera = found.camera
    assert (found.format, found.name) == ("kalibr", "cam0")
    assert (camera.width, camera.height, camera.model) == (752, 480, "pinhole")
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (461.629, 460.152, 362.68, 246.049)
    assert camera.distortion == (-0.27695497, 0.06712482, 0.00087538, 1.1556e-04)
    assert [caution for caution in found.cautions if "IMU" in caution]


def test_equidistant_is_opencvs_fisheye(camchain):
    camera = import_camera(camchain, name="cam1").camera
    assert (camera.width, camera.height, camera.model) == (512, 512, "fisheye")
    assert camera.distortion == (
        -0.0016509958435871643,
        0.02440114401500006,
        -0.03832583051,
        0.0189,
    )


def test_other_models_are_refused_by_name(camchain):
    with pytest.raises(ConfigError, match="cam2 is ds-none, which no camera"):
        import_camera(camchain, name="2")


def test_one_of_several_must_be_chosen(camchain):
    with pytest.raises(ConfigError, match=r"3 cameras, 'cam0', 'cam1', 'cam2'; choose one by"):
        import_camera(camchain)
    with pytest.raises(ConfigError, match="there is no camera 'cam7'"):
        import_camera(camchain, name="cam7")


def test_a_camera_alone_needs_no_name(tmp_path):
    (tmp_path / "c.yaml").write_text(ONE)
    found = import_camera(tmp_path / "c.yaml")
    assert found.camera.distortion == ()
    assert len(found.cautions) == 1


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("  resolution: [752, 480]\n", ""), "cam0 lacks resolution"),
        (("[752, 480]", "[752.5, 480]"), "whole numbers of pixels"),
        (("[461.629, 460.152, 362.680, 246.049]", "[461.629, 460.152]"), "4 numbers are needed"),
        (("461.629", "'461.629'"), "a finite number is needed"),
        (("distortion_model: none", "distortion_model: fov"), "pinhole-fov, which no camera"),
        (("camera_model: pinhole", "camera_model: !!python/object:os.system pinhole"), "line 2"),
        (("camera_model: pinhole", "camera_model: *other"), "begins a value with '\\*'"),
        (("  resolution", "resolution:"), "has no 'key: value'|otherwise|cam0 lacks"),
    ],
)
def test_what_is_missing_or_impossible_is_named(tmp_path, change, reason):
    assert change[0] in ONE
    (tmp_path / "c.yaml").write_text(ONE.replace(*change))
    with pytest.raises(ConfigError, match=reason) as caught:
        import_camera(tmp_path / "c.yaml")
    assert "\n" not in str(caught.value)
