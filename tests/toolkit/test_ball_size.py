import math
from dataclasses import replace

import pytest
import torch

from toolkit import Camera
from toolkit.ball import Disc
from toolkit.ball_size import find_radius, size_in_view
from toolkit.disc import find_disc
from toolkit.errors import CalibrationError, MismatchError
from toolkit.synthetic import LambertBall, benchmark_scene
from toolkit.synthetic.still import true_disc

RADIUS = 0.036
LENS = (-0.12, 0.03, 1e-4, -2e-4)


def make_camera(**changes):
    settings = {"width": 1280, "height": 960, "fx": 1100.0, "fy": 1103.0, "cx": 640.0, "cy": 470.0}
    return Camera(**settings | changes)


def disc_at(camera, position, radius=RADIUS):
    scene = benchmark_scene(width_px=30, length_widths=3)
    return true_disc(
        replace(
            scene,
            camera=camera,
            ball_radius=radius,
            background=torch.zeros(3, camera.height, camera.width),
        ),
        position,
    )


@pytest.mark.parametrize("position", [(0.0, 0.0, 1.0), (0.2, -0.15, 0.7), (-0.3, 0.2, 0.9)])
@pytest.mark.parametrize(
    "lens",
    [{}, {"distortion": LENS}, {"model": "fisheye", "distortion": (-0.01, 0.02, -0.03, 0.004)}],
)
def test_radius_over_distance_through_any_lens(position, lens):
    camera = make_camera(**lens)
    found = size_in_view(disc_at(camera, position), camera)
    # a lens bends the ellipse a little, which the disc does not follow
    assert found.ratio == pytest.approx(RADIUS / math.hypot(*position), rel=2e-4 if lens else 1e-9)


def test_camera_errors_are_carried_on():
    camera = make_camera(distortion=LENS)
    disc = disc_at(camera, (0.2, -0.15, 0.7))
    found = size_in_view(disc, camera)
    step = torch.tensor([1, 1, 1, 1, 1e-3, 1e-3, 1e-4, 1e-4]).double()
    for index in range(8):
        change = torch.zeros(8).double()
        change[index] = step[index]
        ahead, back = (
            math.log(
                size_in_view(disc, camera.with_parameters(camera.parameters + way * change)).ratio
            )
            for way in (1, -1)
        )
        numeric = (ahead - back) / (2 * float(step[index]))
        assert float(found.J_camera[index]) == pytest.approx(numeric, rel=1e-3, abs=1e-6)
    assert found.camera_std == 0
    known = replace(camera, covariance=torch.diag((0.01 * step) ** 2))
    expected = (0.01 * step * found.J_camera).norm()
    assert size_in_view(disc, known).camera_std == pytest.approx(float(expected))


def test_a_disc_beyond_the_lens_is_refused():
    camera = make_camera(distortion=(-0.9, 0.0, 0.0, 0.0))
    disc = Disc(centre=(1200.0, 900.0), semi_axes=(40.0, 40.0), angle=0.0, std=0.01)
    with pytest.raises(MismatchError, match="no rays about"):
        size_in_view(disc, camera)


def sizes(camera, distances, errors=()):
    """Sizes of one ball straight ahead, each disc too large by so many px."""
    found = []
    for distance, error in zip(distances, errors or [0.0] * len(distances), strict=True):
        disc = disc_at(camera, (0.0, 0.0, distance))
        axes = tuple(axis + error for axis in disc.semi_axes)
        found.append(size_in_view(replace(disc, semi_axes=axes, std=0.02), camera))
    return found


def test_radius_from_known_distances():
    camera, distances = make_camera(), [0.6, 0.9, 1.4]
    found = find_radius(sizes(camera, distances), distances, 0.0, camera)
    assert found.radius == pytest.approx(RADIUS, rel=1e-6)
    assert found.contradicting == ()
    # at the least what a rim may err alike in the nearest picture
    assert found.std > 0.05 / 66 * RADIUS
    assert found.std < 0.15 / 28 * RADIUS


def test_what_errs_alike_does_not_shrink_with_the_number():
    camera = make_camera(covariance=torch.diag(torch.tensor([11.0, 11.03, 1, 1]).double() ** 2))
    one, many = (find_radius(sizes(camera, [0.8] * n), [0.8] * n, 0.004, camera) for n in (1, 10))
    assert many.std == pytest.approx(one.std, rel=0.03)
    focal_and_place = math.hypot(0.01 / math.sqrt(2), 0.004 / 0.8)
    assert one.std / RADIUS == pytest.approx(focal_and_place, rel=0.1)


def test_scatter_among_pictures_widens():
    camera, distances = make_camera(), [0.8] * 4
    calm = find_radius(sizes(camera, distances), distances, 0.0, camera)
    wild = find_radius(sizes(camera, distances, [0.25, -0.25, 0.25, -0.25]), distances, 0.0, camera)
    assert wild.contradicting == ()
    assert wild.radius == pytest.approx(RADIUS, rel=1e-3)
    assert wild.std > 1.3 * calm.std


def test_one_picture_that_contradicts_is_left_out():
    camera, distances = make_camera(), [0.8, 0.8, 1.0, 0.8]
    seen = sizes(camera, [0.8, 0.8, 0.8, 0.8])
    found = find_radius(seen, distances, 0.0, camera)
    assert found.contradicting == (2,)
    assert found.radius == pytest.approx(RADIUS, rel=1e-6)
    assert found.by_picture[2] == pytest.approx(RADIUS / 0.8)


def test_two_that_contradict_are_refused():
    camera = make_camera()
    with pytest.raises(
        CalibrationError, match=r"36\.00 .* 45\.00 .*; check the distances"
    ) as caught:
        find_radius(sizes(camera, [0.8, 0.8]), [0.8, 1.0], 0.0, camera)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("look", [None, lambda colour: LambertBall(colour=colour)])
def test_stated_error_holds_for_rendered_balls(sharp_ball, look):
    sharp, empty = sharp_ball(look, radius_px=30, distance_R=15)
    scene = benchmark_scene(width_px=60, length_widths=1, distance_R=15)
    found = size_in_view(find_disc(sharp.image, empty), scene.camera)
    true = scene.ball_radius / math.hypot(*sharp.position)
    assert abs(math.log(found.ratio / true)) < 2 * found.own_std
    assert found.own_std < 0.2 / 30
