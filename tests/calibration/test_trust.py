from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from calibration.advice import advice_text, advise
from calibration.bootstrap import bootstrap_covariance
from calibration.coverage import count_cells, facing, tilt_counts
from calibration.halves import compare_halves
from calibration.intrinsics import calibrate_views, check_request, write_calibration
from calibration.lens_fit import fit_lens, gather, residuals
from calibration.lens_models import PINHOLE_4
from calibration.lens_start import first_fit
from calibration.projection_doubt import projection_difference, projection_std
from calibration.robust_choice import corners_of
from calibration.trust import Evidence, Halves, gates_of
from toolkit.camera import Camera
from toolkit.camera_file import read_camera
from toolkit.errors import ConfigError

FULL = np.full((5, 5), 4)
EVERY = {"left": 3, "right": 2, "up": 2, "down": 4}


def evidence(**changes):
    variance = torch.tensor([0.5, 0.5, 1, 1, 1e-6, 1e-6, 1e-8, 1e-8]).double()
    camera = Camera(
        width=640,
        height=480,
        fx=560.0,
        fy=556.0,
        cx=331.0,
        cy=236.0,
        distortion=(-0.2, 0.06, 0.0, 0.0),
        covariance=torch.diag(variance),
    )
    settings = {
        "camera": camera,
        "views": 12,
        "grid": FULL,
        "tilts": EVERY,
        "lean": np.array([[30.0, 0.0], [0.0, -20.0]]),
        "rms_px": 0.15,
        "held_out_px": 0.2,
        "halves": Halves(rms_px=0.1, most_px=0.4, expected_px=0.1),
    }
    return Evidence(**settings | changes)


def failed(**changes):
    return {gate.code: gate.text for gate in gates_of(evidence(**changes)) if not gate.is_passed}


def test_a_good_calibration_passes_every_gate_and_needs_no_advice():
    assert failed() == {}
    assert advise(FULL, EVERY, 12, gates_of(evidence())) == ()
    assert advice_text(()) == ""


@pytest.mark.parametrize(
    ("changes", "code", "text"),
    [
        ({"views": 5}, "few_views", "only 5 views"),
        ({"held_out_px": 0.9}, "held_out_error", "to 0.90 px, 0.40 px is good"),
        ({"rms_px": 9.0}, "no_lens_fits", "no lens of this model fits the corners (RMS 9.0 px)"),
        ({"tilts": EVERY | {"left": 0, "up": 0}}, "few_tilts", "it faces left, up too"),
        ({"lean": np.array([[1.0, 2.0]])}, "faces_camera", "leans by 2 degrees"),
        (
            {"halves": Halves(rms_px=2.0, most_px=5.0, expected_px=0.3)},
            "halves_differ",
            "differ by 2.00 px over the picture (expected 0.30 px); the views contradict",
        ),
        ({"grid": np.eye(5, dtype=int)}, "poor_coverage", "in 5 of the picture's 5 x 5 cells, 15"),
    ],
)
def test_each_gate_says_what_is_wrong_with_its_numbers(changes, code, text):
    assert text in failed(**changes)[code]
    assert "halves_differ" not in failed(halves=None)


def test_the_focal_length_is_doubted_and_then_refused():
    def gates(std):
        camera = evidence().camera
        covariance = camera.covariance.clone()
        covariance[0, 0] = (std * camera.fx) ** 2
        return failed(camera=replace(camera, covariance=covariance))

    assert "1.0 %, 0.5 % is good" in gates(0.01)["focal_length_uncertain"]
    assert "focal_length_open" not in gates(0.01)
    assert "(standard deviation 8 %)" in gates(0.08)["focal_length_open"]
    assert "focal_length_open" in gates(float("nan"))


def test_cells_count_corners_from_edge_to_edge():
    corners = [np.array([[-0.4, -0.4], [639.4, 479.4], [0.0, 479.0]]), np.array([[320.0, 240.0]])]
    grid = count_cells(corners, (640, 480))
    expected = np.zeros((5, 5), dtype=int)
    expected[0, 0] = expected[4, 4] = expected[4, 0] = expected[2, 2] = 1
    np.testing.assert_array_equal(grid, expected)


@pytest.mark.parametrize(
    ("axis", "angle", "side"),
    [("y", 20, "left"), ("y", -20, "right"), ("x", 20, "down"), ("x", -20, "up")],
)
def test_a_turned_board_faces_that_side(axis, angle, side):
    turn = np.radians(angle) * np.array([axis == "x", axis == "y", 0.0])
    rotation = cv2.Rodrigues(turn)[0]
    lean = facing(rotation[None])
    assert np.linalg.norm(lean) == pytest.approx(20)
    # the face of an unturned board looks at the camera, along -z; a turn moves it to that side
    towards = -rotation[:, 2]
    moved = {"left": -towards[0], "right": towards[0], "up": -towards[1], "down": towards[1]}
    assert moved[side] > 0.3
    counts = tilt_counts(lean)
    assert counts == {name: int(name == side) for name in counts}
    np.testing.assert_allclose(facing((rotation @ np.diag([-1.0, 1.0, -1.0]))[None]), lean)


def test_advice_names_empty_places_and_missing_tilts():
    grid = FULL.copy()
    grid[:2, :2] = grid[:2, 3:] = 0
    tilts = EVERY | {"left": 0}
    gates = gates_of(evidence(grid=grid * 0 + np.eye(5, dtype=int) * 0, tilts=tilts))
    advice = advise(grid, tilts, 12, gates)
    assert [one.place for one in advice[:2]] == ["top left", "top right"]
    assert advice[0].tilt == "left"
    text = advice_text(advice)
    assert text.startswith("two more views: board top left, tilted left; board top right, tilted")


def test_few_views_are_advised_to_be_more():
    advice = advise(FULL, EVERY, 4, gates_of(evidence(views=4)))
    assert len(advice) == 4
    assert len({one.place for one in advice}) == 4
    assert {one.tilt for one in advice} == set(EVERY)


def test_uncertainty_over_the_picture_is_the_scatter_of_drawn_lenses():
    camera = evidence().camera
    spread = projection_std(camera, 24, 18)
    assert spread.shape == (18, 24)
    generator = np.random.default_rng(0)
    root = np.linalg.cholesky(camera.covariance.numpy())
    squares = 0
    for _ in range(400):
        shift = torch.from_numpy(root @ generator.standard_normal(8))
        squares = (
            squares
            + projection_difference(camera, camera.with_parameters(camera.parameters + shift)) ** 2
        )
    scatter = np.sqrt(squares / 400).reshape(18, 24)
    np.testing.assert_allclose(scatter, spread, rtol=0.2)
    assert spread[0, 0] > 2 * spread[9, 12]
    assert np.isnan(projection_std(replace(camera, covariance=None))).all()


def test_a_turned_camera_projects_alike():
    camera = evidence().camera
    moved = camera.with_parameters(camera.parameters + torch.tensor([0, 0, 0.01, 0, 0, 0, 0, 0]))
    assert np.nanmax(projection_difference(camera, moved)) < 0.01  # a centre is almost a turn
    longer = camera.with_parameters(camera.parameters * torch.tensor([1.01, 1.01] + [1.0] * 6))
    assert np.nanmax(projection_difference(camera, longer)) > 2


def test_a_fisheye_has_a_map_too():
    camera = Camera(
        width=640,
        height=480,
        fx=300.0,
        fy=300.0,
        cx=320.0,
        cy=240.0,
        distortion=(-0.02, 0.004, 0.0, 0.0),
        model="fisheye",
        covariance=torch.diag(torch.tensor([1, 1, 1, 1, 1e-6, 1e-6, 1e-8, 1e-8]).double()),
    )
    spread = projection_std(camera)
    assert np.isfinite(spread).all()
    assert spread.max() > 0.5


def test_halves_of_one_camera_agree_and_a_zoom_between_them_is_seen(
    make_views, tilted_poses, camera
):
    poses = tilted_poses(12)
    result = calibrate_views(make_views(poses))
    assert result.halves.rms_px < 3 * result.halves.expected_px + 0.05
    zoomed = make_views(poses, camera=replace(camera, fx=575.0, fy=571.0))
    mixed = [zoomed[i] if i % 2 else view for i, view in enumerate(make_views(poses))]
    corners = corners_of(mixed)
    fit = fit_lens(corners, first_fit(corners, PINHOLE_4))
    assert compare_halves(corners, fit, result.camera).rms_px > 3
    assert compare_halves(corners.only(np.arange(12) < 5), fit, result.camera) is None


def test_the_bootstrap_scatters_as_the_covariance_says(make_views, tilted_poses):
    views = make_views(tilted_poses(20), noise=0.1)
    corners = corners_of(views)
    fit = fit_lens(corners, first_fit(corners, PINHOLE_4))
    drawn = bootstrap_covariance(corners, fit, 60)
    plain = calibrate_views(views).camera.covariance.numpy()
    ratio = np.sqrt(np.diag(drawn)[:4] / np.diag(plain)[:4])
    assert ((ratio > 0.5) & (ratio < 2)).all()
    np.testing.assert_array_equal(drawn, bootstrap_covariance(corners, fit, 60))


def test_the_larger_of_bootstrap_and_covariance_is_told(make_views, tilted_poses):
    views = make_views(tilted_poses(9), noise=0.1)
    plain, drawn = calibrate_views(views), calibrate_views(views, bootstrap=40)
    factor = max(1.0, *drawn.bootstrap_ratio)
    torch.testing.assert_close(drawn.camera.covariance, factor**2 * plain.camera.covariance)
    assert plain.bootstrap_ratio is None
    with pytest.raises(ConfigError, match="3 bootstrap draws are too few"):
        check_request([Path("a.png")], None, None, bootstrap=3)


def test_misread_corners_are_set_aside_and_named(make_views, tilted_poses, camera):
    views = make_views(tilted_poses(10))
    bent = views[3].corners.copy()
    bent[[5, 20]] += [11.0, -4.0]
    views[3] = replace(views[3], corners=bent)
    result = calibrate_views(views)
    assert len(result.used) == 10
    (note,) = [one for one in result.warnings if one.code == "corners_set_aside"]
    assert note.message == "2 misread corners were set aside, in v3.png"
    assert result.camera.fx == pytest.approx(camera.fx, rel=2e-3)
    assert result.rms_px < 0.2


def test_a_view_that_does_not_fit_stays_where_nothing_else_covers_its_place(
    make_views, tilted_poses, monkeypatch
):
    views = make_views(tilted_poses(10))
    cells = [count_cells([view.corners], (640, 480)) > 0 for view in views]
    alone = [bool((one & (sum(cells, start=0 * one.astype(int)) == 1)).any()) for one in cells]
    odd = alone.index(True)
    noise = np.random.default_rng(0).normal(0, 3, (54, 2))
    views[odd] = replace(views[odd], corners=views[odd].corners + noise)
    left = calibrate_views(views)
    assert not left.views[odd].is_used
    covered = count_cells([view.corners for view in views], (640, 480)) > 0
    monkeypatch.setattr("calibration.trust.COVERED_CELLS", int(covered.sum()))
    kept = calibrate_views(views)
    assert kept.views[odd].is_used
    (note,) = [one for one in kept.warnings if one.code == "odd_view_kept"]
    assert note.message.startswith(f"v{odd}.png: does not fit the other views, but nothing else")


def test_a_forced_model_is_the_only_one_compared(make_views, tilted_poses):
    views = make_views(tilted_poses(9))
    for family, count in (("pinhole", 3), ("rational", 1), ("fisheye", 1)):
        result = calibrate_views(views, model=family)
        assert result.camera.model == family
        assert {score.family for score in result.model_scores} == {family}
        assert len({score.model for score in result.model_scores}) == count
        assert result.camera.covariance.shape == (4 + len(result.camera.distortion),) * 2
    with pytest.raises(ConfigError, match="model 'spherical' is unknown"):
        check_request([Path("a.png")], None, None, "spherical")


def test_the_bend_of_a_board_is_told_point_by_point(make_views, tilted_poses):
    views = make_views(tilted_poses(12), noise=0.03)
    assert calibrate_views(views).board_shape is None
    corners = corners_of(views)
    start = first_fit(corners, PINHOLE_4)
    bend = np.array([0.03, 0.0, 0.0])
    seen = residuals(corners, replace(start, is_bent=True, bend=bend)) + corners.seen
    bent = [replace(view, corners=pixels) for view, pixels in zip(views, seen, strict=True)]
    shape = calibrate_views(bent).board_shape
    assert shape.shape == (6, 9)
    u = (np.arange(9) - 4) / 4
    wanted = 0.03 * u**2 - (0.03 * u**2).mean()
    np.testing.assert_allclose(shape, np.tile(wanted, (6, 1)), atol=5e-3)


def test_the_camera_file_says_how_it_was_got(make_views, tilted_poses, tmp_path):
    result = calibrate_views(make_views(tilted_poses(9)))
    path = tmp_path / "camera.toml"
    write_calibration(path, result)
    assert torch.equal(read_camera(path).covariance, result.camera.covariance)
    text = path.read_text()
    assert "held_out_px" in text
    assert "pinhole 4, flat board: held-out" in text
    path.write_text(text.replace("gates = [", "gates = [3, "))
    with pytest.raises(ConfigError, match="gates must be a list of texts"):
        read_camera(path)


def test_gathered_views_of_different_length_weigh_what_they_show():
    points = np.zeros((4, 3))
    points[:, :2] = [[0, 0], [1, 0], [0, 1], [1, 1]]
    corners = gather([points, points[:3]], [points[:, :2], points[:3, :2]], (10, 10))
    assert corners.weight.tolist() == [[1, 1, 1, 1], [1, 1, 1, 0]]
