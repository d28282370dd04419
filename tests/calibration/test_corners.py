import cv2
import numpy as np
import pytest

from calibration.corners import find_boards, find_corners, most_common
from toolkit.imaging import write_dng, write_png16


def perceptual(picture):
    return (255 * np.sqrt(picture.mean(0) / 0.8)).astype(np.float32)


def distance(found, true):
    return float(np.sqrt(((found - true) ** 2).sum(-1).mean()))


def test_corners_are_found_to_a_tenth_of_a_pixel_in_the_true_order(photos):
    views = find_boards(photos.paths)
    assert [view.path for view in views] == photos.paths
    for view, true in zip(views, photos.corners, strict=True):
        assert view.is_used, view.reason
        assert view.board == (9, 6)
        assert view.corners.shape == (54, 2)
        assert distance(view.corners, true) < 0.06
        assert np.abs(view.corners - true).max() < 0.2


@pytest.mark.parametrize("board", [(9, 6), (6, 9)])
def test_a_given_board_is_found_whichever_side_is_named_first(photos, board):
    (view,) = find_boards(photos.paths[:1], board=board)
    assert view.board == (9, 6)
    assert distance(view.corners, photos.corners[0]) < 0.06


def test_a_turned_picture_keeps_the_first_corner(photos):
    grey, true = perceptual(photos.pictures[1]), photos.corners[1]
    (upright,) = find_corners(grey, (9, 6))
    (turned,) = find_corners(np.ascontiguousarray(np.rot90(grey, 2)), (9, 6))
    (aside,) = find_corners(np.ascontiguousarray(np.rot90(grey)), (9, 6))
    right, bottom = grey.shape[1] - 1, grey.shape[0] - 1
    assert distance(upright.reshape(-1, 2), true) < 0.06
    assert distance([right, bottom] - turned.reshape(-1, 2), true) < 0.06
    x, y = aside.reshape(-1, 2).T
    assert distance(np.stack([right - y, x], axis=-1), true) < 0.06


@pytest.mark.parametrize("factor", [3, 6])
def test_a_large_picture_is_searched_small_and_refined_at_full_size(photos, factor):
    grey = cv2.resize(
        perceptual(photos.pictures[2]), None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC
    )
    (found,) = find_corners(grey, (9, 6))
    true = (photos.corners[2] + 0.5) * factor - 0.5
    assert distance(found.reshape(-1, 2), true) < 0.06 * factor


def test_a_raw_photo_gives_the_corners_of_the_developed_one(photos, tmp_path):
    linear = 0.3 * photos.pictures[3]  # darker than a viewer would accept
    mosaic = linear[1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = linear[0, ::2, ::2], linear[2, 1::2, 1::2]
    path = tmp_path / "board.dng"
    write_dng(path, np.round(64 + mosaic * (4095 - 64)).astype(np.uint16), black=64, white=4095)
    (view,) = find_boards([path], board=(9, 6))
    assert view.picture_size == (640, 480)
    assert distance(view.corners, photos.corners[3]) < 0.1


def test_photos_that_cannot_serve_are_named_and_the_rest_is_used(photos, tmp_path):
    text = tmp_path / "notes.png"
    text.write_text("no picture")
    copy = tmp_path / "copy.png"
    copy.write_bytes(photos.paths[0].read_bytes())
    empty = tmp_path / "empty.png"
    noise = np.random.default_rng(0).uniform(0.3, 0.5, (3, 480, 640))
    write_png16(empty, noise)
    half = tmp_path / "half.png"
    write_png16(
        half, cv2.resize(photos.pictures[4].transpose(1, 2, 0), (320, 240)).transpose(2, 0, 1)
    )
    missing = tmp_path / "missing.png"
    paths = [*photos.paths[:2], text, copy, empty, half, missing, tmp_path]
    views = find_boards(paths)
    assert [view.path for view in views] == paths
    assert [view.is_used for view in views] == [True, True, *[False] * 6]
    reasons = [view.reason for view in views[2:]]
    assert "notes.png" in reasons[0]
    assert reasons[1] == f"the same file as {photos.paths[0]}, counted once"
    assert reasons[2] == "no board of 9x6 inner corners found"
    assert reasons[3].startswith("320x240 px, but most photos are 640x480; calibrate each kind")
    assert reasons[4] == "cannot be read (No such file or directory)"
    assert reasons[5] == "cannot be read (Is a directory)"


def test_every_photo_is_reported_as_it_is_read(photos):
    seen = []
    find_boards(photos.paths[:2], board=(9, 6), on_photo=seen.append)
    assert seen == photos.paths[:2]


def test_the_most_common_size_wins_and_the_larger_of_equals():
    assert most_common([(9, 6), (7, 4), (9, 6), (10, 7)]) == (9, 6)
    assert most_common([(7, 4), (9, 6), (9, 6), (7, 4)]) == (9, 6)
    assert most_common([]) is None


@pytest.mark.shared_data
@pytest.mark.parametrize("count", [3, 13])
def test_misread_real_views_are_sought_again(opencv_left, count):
    # left04 and left12 are each read with another size by at least one of the two searches
    paths = [path for path in opencv_left if path.stem in ("left04", "left12", "left13")]
    views = find_boards(paths if count == 3 else opencv_left)
    assert [view.reason for view in views] == [""] * count
    assert {view.board for view in views} == {(9, 6)}


@pytest.mark.shared_data
@pytest.mark.parametrize("name", ["GOPR0034", "GOPR0068"])
def test_no_corner_stays_where_a_detector_misplaced_it(gopro_wide, name):
    """One quick detector or another puts a corner of each beside its place, out of its window."""
    (view,) = find_boards([path for path in gopro_wide if path.stem == name], board=(8, 6))
    grid = view.grid
    for lines in (grid, grid.swapaxes(0, 1)):
        bends = np.linalg.norm(np.diff(lines, 2, axis=0), axis=-1)
        assert (bends < 0.25 * np.linalg.norm(lines[1:-1] - lines[:-2], axis=-1)).all()
