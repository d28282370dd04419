import cv2
import numpy as np
import pytest
import torch
from kornia.geometry.calibration import distort_points, undistort_points
from torch.func import jacfwd, vmap

from toolkit.camera import Camera
from toolkit.errors import ConfigError

LENSES = {
    "none": (),
    "four": (-0.28, 0.09, 1.3e-3, -4e-4),
    "five": (-0.28, 0.09, 1.3e-3, -4e-4, -0.011),
    "rational": (0.31, -0.12, 6e-4, -9e-4, 0.02, 0.66, -0.07, 0.03),
}
LENS = pytest.mark.parametrize("distortion", LENSES.values(), ids=LENSES.keys())
JIT_WARNS = pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")


def make_camera(distortion=(), **changes):
    settings = {
        "width": 1280,
        "height": 960,
        "fx": 1071.3,
        "fy": 1068.9,
        "cx": 652.4,
        "cy": 471.8,
        "model": "rational" if len(distortion) == 8 else "pinhole",
    } | changes
    return Camera(distortion=tuple(distortion), **settings)


def test_a_centred_camera_looks_along_the_middle_of_its_picture():
    camera = Camera.centred(641, 480, 600.0, (0.1,) * 8)
    middle = camera.project(torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64))[0]
    assert middle.tolist() == [320, 239.5]
    assert (camera.fx, camera.fy, camera.model) == (600, 600, "rational")
    assert Camera.centred(641, 480, 600.0).model == "pinhole"


def matrix(camera):
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


def random_points(count=500):
    """Points in front of the camera, spread over a little more than its picture."""
    generator = torch.Generator().manual_seed(3)
    spread = torch.rand(count, 3, generator=generator, dtype=torch.float64)
    depth = 0.5 + 9 * spread[:, 2:]
    return torch.cat([(spread[:, :2] - 0.5) * torch.tensor([1.3, 1.0]) * depth, depth], dim=-1)


def random_pixels(camera, count=500):
    generator = torch.Generator().manual_seed(4)
    return torch.rand(count, 2, generator=generator, dtype=torch.float64) * torch.tensor(
        [camera.width, camera.height]
    )


@LENS
def test_project_agrees_with_opencv(distortion):
    camera, points = make_camera(distortion), random_points()
    expected = cv2.projectPoints(
        points.numpy(), np.zeros(3), np.zeros(3), matrix(camera), np.array(distortion)
    )[0][:, 0]
    np.testing.assert_allclose(camera.project(points).numpy(), expected, atol=1e-6, rtol=0)


@LENS
def test_unproject_agrees_with_opencv(distortion):
    camera = make_camera(distortion)
    pixels = random_pixels(camera)
    tight = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-14)
    expected = cv2.undistortPoints(
        pixels.numpy()[:, None], matrix(camera), np.array(distortion), criteria=tight
    ).reshape(-1, 2)
    rays = camera.unproject(pixels)
    np.testing.assert_allclose(
        (rays[:, :2] / rays[:, 2:]).numpy() * camera.fx, expected * camera.fx, atol=1e-6, rtol=0
    )


@JIT_WARNS
@pytest.mark.parametrize("distortion", [LENSES["five"], LENSES["rational"]])
def test_agrees_with_kornia(distortion):
    camera, points = make_camera(distortion), random_points()
    ideal = points[:, :2] / points[:, 2:] @ torch.diag(
        torch.tensor([camera.fx, camera.fy], dtype=torch.float64)
    ) + torch.tensor([camera.cx, camera.cy], dtype=torch.float64)
    K, coefficients = (
        torch.from_numpy(matrix(camera)),
        torch.tensor(distortion, dtype=torch.float64),
    )
    seen = distort_points(ideal[None], K[None], coefficients[None])[0]
    torch.testing.assert_close(camera.project(points), seen, atol=1e-6, rtol=0)
    back = undistort_points(seen[None], K[None], coefficients[None], num_iters=200)[0]
    torch.testing.assert_close(back, ideal, atol=1e-5, rtol=0)


@LENS
def test_round_trips(distortion):
    camera = make_camera(distortion)
    pixels = random_pixels(camera)
    rays = camera.unproject(pixels)
    torch.testing.assert_close(rays.norm(dim=-1), torch.ones(len(rays), dtype=torch.float64))
    torch.testing.assert_close(camera.project(rays * 7.5), pixels, atol=1e-8, rtol=0)


@JIT_WARNS
@LENS
def test_jacobians_agree_with_automatic_ones(distortion):
    camera = make_camera(distortion)
    points, pixels = random_points(40), random_pixels(camera, 40)
    torch.testing.assert_close(
        camera.J_project(points), vmap(jacfwd(camera.project))(points), atol=1e-8, rtol=1e-9
    )
    # the inverse of a function is not differentiated itself: its J follows from the function's
    rays, J = camera.unproject_and_J(pixels)
    assert torch.equal(rays, camera.unproject(pixels))
    torch.testing.assert_close(camera.J_project(rays) @ J, torch.eye(2).double().expand(40, 2, 2))
    across = torch.zeros(40, 1, 2, dtype=torch.float64)
    torch.testing.assert_close(rays[:, None] @ J, across, atol=1e-15, rtol=0)


@LENS
def test_what_the_parameters_change_agrees_with_differences(distortion):
    camera = make_camera(distortion)
    points = random_points(40)
    J = camera.J_parameters(points)
    assert J.shape == (40, 2, len(camera.parameters))
    for index in range(len(camera.parameters)):
        step = torch.zeros_like(camera.parameters)
        step[index] = 1e-5 * max(1.0, abs(float(camera.parameters[index])))
        ahead, back = (
            camera.with_parameters(camera.parameters + sign * step).project(points)
            for sign in (1, -1)
        )
        slope = (ahead - back) / (2 * step[index])
        torch.testing.assert_close(J[..., index], slope, atol=1e-5, rtol=1e-6)


def test_leading_axes_dtype_and_neighbours_do_not_matter():
    camera = make_camera(LENSES["five"])
    pixels = random_pixels(camera, 24).reshape(2, 3, 4, 2)
    rays = camera.unproject(pixels)
    assert rays.shape == (2, 3, 4, 3)
    assert camera.J_unproject(pixels).shape == (2, 3, 4, 3, 2)
    assert camera.J_project(rays).shape == (2, 3, 4, 2, 3)
    torch.testing.assert_close(camera.unproject(pixels[1, 2, 3]), rays[1, 2, 3], atol=0, rtol=0)
    assert camera.project(rays.float()).dtype == torch.float32


@pytest.mark.parametrize(
    ("distortion", "x"),
    [
        ((-0.3, 0, 0, 0), 0.8),  # barrel: r(1 - 0.3 r^2) never exceeds 0.703
        ((-0.3, 0, 0, 0), 4.0),  # far out Newton finds the mirror image beyond the fold
        ((-0.3, 0.02, 0, 0), 2.0),  # here a second rising branch lies beyond it
        ((-0.3, 0.02, 0, 0), -9.0),
        ((0.1, 0, 0, 0, 0, 0.9, 0, 0), 60.0),
        ((0, 0, 0, 0, 0, -0.25, 0, 0), -9.0),  # below the pole of the rational lens only
    ],
)
def test_rays_that_no_lens_could_bend_there_are_nan_or_true(distortion, x):
    camera = make_camera(distortion, fx=100.0, fy=100.0, cx=0.0, cy=0.0)
    ray = camera.unproject(torch.tensor([[100 * x, 0.0]], dtype=torch.float64))
    radius = torch.linspace(0, 50, 5_000_001, dtype=torch.float64)
    k1, k2, _, _, k3, k4, k5, k6 = (*distortion, *(0.0,) * (8 - len(distortion)))
    s = radius**2
    below = 1 + k4 * s + k5 * s**2 + k6 * s**3
    seen = radius * (1 + k1 * s + k2 * s**2 + k3 * s**3) / below
    rises = torch.cat([torch.tensor([True]), (seen[1:] > seen[:-1]) & (below[1:] > 0)])
    reach = seen[: int((~rises).long().argmax()) or None]
    if abs(x) < float(reach.max()):
        nearest = float(radius[int((reach - abs(x)).abs().argmin())])
        assert float((ray[0, 0] / ray[0, 2]).abs()) == pytest.approx(nearest, abs=2e-5)
        assert bool(ray[0, 0].sign() == torch.tensor(x).sign())
    else:
        assert bool(ray.isnan().all())


def test_undistorting_reaches_close_to_the_fold():
    camera = make_camera((-0.3, 0, 0, 0))
    fold = 1 / 0.9**0.5
    radius = torch.linspace(0, 0.995 * fold, 200, dtype=torch.float64)
    points = torch.stack([0.6 * radius, -0.8 * radius, torch.ones_like(radius)], dim=-1)
    rays = camera.unproject(camera.project(points))
    torch.testing.assert_close(rays / rays[:, 2:], points, atol=1e-7, rtol=0)


@LENS
def test_cropping_moves_pixels_and_nothing_else(distortion):
    camera, points = make_camera(distortion), random_points()
    cropped = camera.cropped(130, 57, 800, 600)
    assert (cropped.width, cropped.height) == (800, 600)
    shift = torch.tensor([130.0, 57.0], dtype=torch.float64)
    torch.testing.assert_close(cropped.project(points), camera.project(points) - shift)


@LENS
def test_resizing_scales_pixel_areas(distortion):
    camera, points = make_camera(distortion), random_points()
    scale = torch.tensor([0.5, 0.25], dtype=torch.float64)
    resized = camera.resized(640, 240)
    # the outer edge of the top-left pixel, at (-0.5, -0.5), stays where it is
    expected = (camera.project(points) + 0.5) * scale - 0.5
    torch.testing.assert_close(resized.project(points), expected)


def test_resizing_scales_the_covariance():
    spread = torch.randn(8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    camera = make_camera(LENSES["four"], covariance=spread @ spread.T)
    resized = camera.resized(640, 240)
    sizes = torch.tensor([0.5, 0.25, 0.5, 0.25, 1, 1, 1, 1], dtype=torch.float64)
    expected = (sizes[:, None] * spread) @ (sizes[:, None] * spread).T
    torch.testing.assert_close(resized.covariance, expected)


def test_parameters_go_out_and_come_back():
    camera = make_camera(LENSES["five"])
    assert camera.parameters.shape == (9,)
    moved = camera.with_parameters(camera.parameters + 0.25)
    torch.testing.assert_close(
        moved.parameters - camera.parameters, torch.full((9,), 0.25).double()
    )
    assert moved.width == camera.width


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"model": "spherical"},
            "model 'spherical' is unknown; use one of pinhole, rational, fisheye",
        ),
        ({"distortion": (0.1, 0.2)}, "2 distortion coefficients"),
        ({"distortion": (0.1,) * 8}, "8 distortion coefficients"),
        ({"fx": float("nan")}, "not a finite number"),
        ({"cy": float("inf")}, "not a finite number"),
        ({"distortion": (0.0, 0.0, 0.0, float("nan"))}, "not a finite number"),
        ({"fy": -3.0}, "positive fx, fy"),
        ({"fx": 0.0}, "positive fx, fy"),
        ({"width": 0}, "positive fx, fy, width and height"),
    ],
)
def test_bad_parameters_are_refused(changes, message):
    settings = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(ConfigError, match=message):
        Camera(**settings | changes)
