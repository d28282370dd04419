import cv2
import numpy as np
import pytest
import torch

from calibration.formats.convert import FORMATS, export_camera, import_camera
from toolkit.camera import Camera
from toolkit.errors import ConfigError, MismatchError

SAME_PX = 1e-6
LENSES = {
    "no distortion": ("pinhole", ()),
    "four": ("pinhole", (-0.28, 0.09, 1e-5, -4e-4)),
    "five": ("pinhole", (-0.28, 0.09, 1e-5, -4e-4, 0.012)),
    "five, four of them used": ("pinhole", (-0.28, 0.09, 1e-5, -4e-4, 0.0)),
    "rational": ("rational", (0.3, -0.2, 1e-4, -2e-4, 0.01, 0.6, -0.1, 0.03)),
    "fisheye": ("fisheye", (-0.013, 0.05, -0.045, 0.0124)),
}
FILES = {
    "opencv": ("c.yml", "c.yaml", "c.xml", "c.json"),
    "ros": ("c.yaml",),
    "kalibr": ("c.yaml",),
    "colmap": ("c.txt",),
}
TRIPS = [
    (format, file, lens)
    for format, files in FILES.items()
    for file in files
    for lens in LENSES
    if not (format == "kalibr" and lens in ("five", "rational"))
]


def make_camera(lens: str = "four", **changes: object) -> Camera:
    model, distortion = LENSES[lens]
    settings = {"width": 1280, "height": 961, "fx": 1033 / 3, "fy": 345.5, "cx": 641 / 7}
    settings |= {"cy": 480.123456789012, "model": model, "distortion": distortion}
    return Camera(**settings | changes)


def random_points(count: int = 1000) -> torch.Tensor:
    generator = torch.Generator().manual_seed(5)
    place = torch.rand(count, 2, generator=generator, dtype=torch.float64) - 0.5
    depth = 1 + torch.rand(count, 1, generator=generator, dtype=torch.float64)
    return torch.cat([1.6 * place, torch.ones(count, 1)], dim=-1) * depth


def same_pixels(first: Camera, second: Camera) -> float:
    points = random_points()
    return float((first.project(points) - second.project(points)).abs().max())


@pytest.mark.parametrize(("format", "file", "lens"), TRIPS)
def test_round_trip_keeps_a_thousand_projections(tmp_path, format, file, lens):
    camera, path = make_camera(lens), tmp_path / file
    assert export_camera(camera, path, format=format) == ()
    back = import_camera(path)
    assert back.format == format  # told by the contents alone
    assert (back.camera.width, back.camera.height) == (1280, 961)
    assert back.camera.model == camera.model
    assert same_pixels(back.camera, camera) < SAME_PX


@pytest.mark.parametrize("lens", ["five", "rational"])
def test_kalibr_refuses_what_it_cannot_hold(tmp_path, lens):
    path = tmp_path / "camchain.yaml"
    with pytest.raises(MismatchError, match="Kalibr's radtan holds k1 k2 p1 p2") as caught:
        export_camera(make_camera(lens), path, format="kalibr")
    assert "\n" not in str(caught.value)
    assert not path.exists()


@pytest.mark.parametrize("format", FORMATS)
def test_a_lost_covariance_is_said(tmp_path, format):
    camera = make_camera(covariance=torch.eye(8).double())
    (caution,) = export_camera(camera, tmp_path / FILES[format][0], format=format)
    assert "covariance" in caution
    assert "no covariance" in import_camera(tmp_path / FILES[format][0]).cautions[-1]


@pytest.mark.parametrize(
    ("format", "file", "reason"),
    [
        ("opencv", "c.txt", r"ends in \.yml or \.yaml or \.xml or \.json"),
        ("colmap", "c.yaml", r"ends in \.txt"),
        ("matlab", "c.mat", "unknown; use one of opencv"),
    ],
)
def test_wrong_names_are_refused(tmp_path, format, file, reason):
    with pytest.raises(ConfigError, match=reason):
        export_camera(make_camera(), tmp_path / file, format=format)


def test_opencv_itself_reads_what_is_written(tmp_path):
    camera = make_camera("rational")
    for name in FILES["opencv"]:
        export_camera(camera, tmp_path / name, format="opencv")
        file = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_READ)
        matrix, lens = (
            file.getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients")
        )
        points = random_points().numpy()
        seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens)
        true = camera.project(random_points()).numpy()
        assert np.abs(seen[:, 0] - true).max() < SAME_PX


@pytest.mark.parametrize("format", ["ros", "kalibr"])
def test_numbers_are_written_for_old_yaml_too(tmp_path, format):
    """PyYAML takes 1e-05 for text, and 1.0e-05 for a number."""
    export_camera(make_camera(), tmp_path / "c.yaml", format=format)
    text = (tmp_path / "c.yaml").read_text()
    assert "1.0e-05" in text


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is recognised in it"),
        (b"fx = 533\n", "is recognised in it"),
        (b"\xff\xfe\x00\x01", "is no text"),
        (b"%YAML:1.0\n---\na: [1,\nb: }{", "cannot be parsed"),
        (b"{ 'a", "cannot be parsed"),
        (b"<?xml version='1.0'?>\n<opencv_storage><a>3", "cannot be parsed"),
        (b'{"a": ' + b"[" * 200_000, "nested more than 100 deep"),
        (b"<?xml version='1.0'?><opencv_storage>" + b"<a>" * 200_000, "nested more than"),
        (b"#" * 1_100_000, "larger than"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, content, reason):
    path = tmp_path / "camera.any"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=reason) as caught:
        import_camera(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_missing_files_are_named(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        import_camera(tmp_path / "none.yml")
    with pytest.raises(ConfigError, match="cannot be read"):
        import_camera(tmp_path)
    (tmp_path / "c.yml").write_text("%YAML:1.0")
    with pytest.raises(ConfigError, match="format 'mat' is unknown"):
        import_camera(tmp_path / "c.yml", format="mat")
