import math

import cv2
import numpy as np
import pytest
import torch
from torch.func import jacfwd, vmap

from toolkit.camera import Camera
from toolkit.camera_file import read_camera, write_camera
from toolkit.errors import ConfigError

LENSES = {
    "equidistant": (0.0, 0.0, 0.0, 0.0),
    "barrel": (-0.045, 0.011, -0.006, 0.0009),
    "pincushion": (0.09, 0.02, -0.004, 0.001),
}
LENS = pytest.mark.parametrize("distortion", LENSES.values(), ids=LENSES.keys())
JIT_WARNS = pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")


def make_camera(distortion=LENSES["barrel"], **changes):
    settings = {"width": 1280, "height": 960, "fx": 571.3, "fy": 568.9, "cx": 652.4, "cy": 471.8}
    return Camera(distortion=distortion, model="fisheye", **settings | changes)


def random_points(count=400, widest=80.0):
    generator = np.random.default_rng(3)
    theta = np.radians(widest) * np.sqrt(generator.uniform(size=count))
    turn = generator.uniform(0, 2 * np.pi, count)
    across = [np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)]
    return torch.from_numpy((np.stack(across) * generator.uniform(0.5, 9, count)).T.copy())


def matrix(camera):
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


@LENS
def test_project_agrees_with_opencv(distortion):
    camera, points = make_camera(distortion), random_points()
    none = np.zeros((3, 1))
    expected, J = cv2.fisheye.projectPoints(
        points.numpy()[:, None], none, none, matrix(camera), np.array(distortion)
    )
    np.testing.assert_allclose(camera.project(points).numpy(), expected[:, 0], atol=1e-9, rtol=0)
    # its columns: f, c, k1 to k4, rotation, translation, skew
    np.testing.assert_allclose(
        camera.J_parameters(points).numpy(), J[:, :8].reshape(-1, 2, 8), atol=1e-8
    )


@LENS
def test_undistort_agrees_with_opencv(distortion):
    camera = make_camera(distortion)
    pixels = camera.project(random_points(widest=60.0))
    tight = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-15)
    expected = cv2.fisheye.undistortPoints(
        pixels.numpy()[:, None], matrix(camera), np.array(distortion), criteria=tight
    )[:, 0]
    difference = camera.fx * (camera.undistort(pixels).numpy() - expected)
    np.testing.assert_allclose(difference, 0, atol=1e-9)


@LENS
def test_pixels_come_back_from_their_rays_almost_to_the_edge_of_the_half_space(distortion):
    camera, points = make_camera(distortion), random_points(widest=89.0)
    rays = camera.unproject(camera.project(points))
    unit = points / points.norm(dim=-1, keepdim=True)
    torch.testing.assert_close(rays, unit, atol=1e-11, rtol=0)


def test_the_middle_and_its_neighbourhood_are_exact():
    camera = make_camera()
    radius = torch.logspace(-12, 0, 200, dtype=torch.float64)
    points = torch.stack([0.6 * radius, 0.8 * radius, torch.ones_like(radius)], dim=-1)
    points = torch.cat([torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64), points])
    assert camera.project(points)[0].tolist() == [camera.cx, camera.cy]
    theta = np.arctan(radius.numpy())
    k1, k2, k3, k4 = camera.distortion
    seen = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    across = (camera.project(points)[1:, 0].numpy() - camera.cx) / camera.fx
    np.testing.assert_allclose(across, 0.6 * seen, rtol=1e-12, atol=3e-16 * camera.cx)
    torch.testing.assert_close(
        camera.unproject(camera.project(points[:1])), torch.tensor([[0.0, 0.0, 1.0]]).double()
    )


@JIT_WARNS
@LENS
def test_jacobians_agree_with_automatic_ones(distortion):
    camera, points = make_camera(distortion), random_points(60)
    near = torch.tensor([[1e-9, 0.0, 1.0], [0.03, 0.01, 1.0]], dtype=torch.float64)
    points = torch.cat([points, near])
    torch.testing.assert_close(
        camera.J_project(points), vmap(jacfwd(camera.project))(points), atol=1e-8, rtol=1e-9
    )
    rays, J = camera.unproject_and_J(camera.project(points))
    identity = torch.eye(2).double().expand(len(points), 2, 2)
    torch.testing.assert_close(camera.J_project(rays) @ J, identity)


def test_pixels_that_show_no_ray_in_front_are_nan():
    camera = make_camera(LENSES["equidistant"], fx=100.0, fy=100.0, cx=0.0, cy=0.0)
    edge = 100 * math.pi / 2
    inside, outside = camera.unproject(
        torch.tensor([[edge - 0.1, 0.0], [0.0, -edge - 0.1]]).double()
    )
    assert bool(inside.isfinite().all())
    assert bool(outside.isnan().all())
    folded = make_camera((-0.3, 0.0, 0.0, 0.0), fx=100.0, fy=100.0, cx=0.0, cy=0.0)
    turn = (1 / 0.9) ** 0.5  # 1 - 0.9 theta^2 = 0
    reach = 100 * turn * (1 - 0.3 * turn**2)
    pixels = torch.tensor([[0.999 * reach, 0.0], [1.001 * reach, 0.0]]).double()
    inside, outside = folded.unproject(pixels)
    assert math.atan2(inside[0], inside[2]) < turn
    assert bool(outside.isnan().all())


def test_a_pixel_alone_is_as_in_a_batch():
    camera = make_camera()
    pixels = camera.project(random_points(24)).reshape(2, 3, 4, 2)
    assert torch.equal(camera.unproject(pixels)[1, 2, 3], camera.unproject(pixels[1, 2, 3]))


def test_a_fisheye_comes_back_from_its_file(tmp_path):
    covariance = torch.diag(torch.tensor([1.0, 1.0, 0.5, 0.5, 1e-6, 1e-6, 1e-7, 1e-8]).double())
    camera, path = make_camera(covariance=covariance), tmp_path / "camera.toml"
    write_camera(path, camera, rms_px=0.2, views=9, images=["a.png"])
    back = read_camera(path)
    assert back.model == "fisheye"
    assert torch.equal(back.parameters, camera.parameters)
    assert torch.equal(back.covariance, covariance)


@pytest.mark.parametrize("count", [0, 3, 5])
def test_a_fisheye_has_four_coefficients(count):
    with pytest.raises(ConfigError, match="a fisheye camera has"):
        make_camera((0.0,) * count)
