"""What board photos show, and what is said when it is not the one that was named."""

import cv2
import numpy as np
import pytest

from calibration.board import BoardRequest
from calibration.checkers import are_crossings, shows
from calibration.corners import search_boards
from calibration.markers import (
    Layout,
    Markers,
    dictionary_named,
    find_charuco,
    find_markers,
    layout_of,
)

REQUEST = BoardRequest(
    kind="charuco", size=(5, 7), dictionary="DICT_6X6_250", square_m=0.04, marker_m=0.02
)


def charuco_photo(path, *, squares=(5, 7), legacy=False, keep=1.0, seed=0, share=0.6):
    """Write a board seen aslant, hidden to the right of `keep`; give its true corners."""
    board = cv2.aruco.CharucoBoard(squares, 1.0, share, dictionary_named("DICT_5X5_250"))
    board.setLegacyPattern(legacy)
    side = 60
    flat = board.generateImage((squares[0] * side, squares[1] * side))
    flat = cv2.copyMakeBorder(flat, side, side, side, side, cv2.BORDER_CONSTANT, value=255)
    height, width = flat.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32)
    generator = np.random.default_rng(seed)
    target = corners + generator.uniform(0, 60, (4, 2)).astype(np.float32) * [[1, 1]]
    H = cv2.getPerspectiveTransform(corners, target.astype(np.float32))
    size = (width + 60, height + 60)
    large = np.diag([4.0, 4, 1]) @ H  # four samples a pixel, as an eye has more
    seen = cv2.warpPerspective(flat, large, (4 * size[0], 4 * size[1]), borderValue=200)
    seen = cv2.resize(seen, size, interpolation=cv2.INTER_AREA)
    seen[:, int(keep * size[0]) :] = 120
    seen = cv2.GaussianBlur(seen, (0, 0), 0.8)
    seen = np.clip(20 + 0.8 * seen + generator.normal(0, 1.0, seen.shape), 0, 255)
    cv2.imwrite(str(path), seen.astype(np.uint8))
    points = board.getChessboardCorners()[:, :2] * side + side - 0.5
    true = cv2.perspectiveTransform(points[None].astype(np.float64), large)[0]
    return (true + 0.5) / 4 - 0.5


def codes(found):
    return [caution.code for caution in found.cautions]


@pytest.fixture
def charuco_photos(tmp_path):
    paths = [tmp_path / f"{i}.png" for i in range(3)]
    return paths, [charuco_photo(path, seed=i) for i, path in enumerate(paths)]


def test_a_charuco_board_is_known_by_sight(charuco_photos):
    paths, corners = charuco_photos
    found = search_boards(paths)
    assert found.board.kind == "charuco"
    assert found.board.squares == (5, 7)
    assert found.board.dictionary == "DICT_5X5_250"
    assert found.cautions == ()
    for view, true in zip(found.views, corners, strict=True):
        assert view.is_used, view.reason
        assert view.board == (4, 6)
        assert np.sqrt(((view.corners - true[view.ids]) ** 2).sum(-1).mean()) < 0.1
        np.testing.assert_array_equal(view.points[:, 0], view.ids % 4)
        np.testing.assert_array_equal(view.points[:, 1], view.ids // 4)


def test_a_part_of_a_charuco_board_is_enough(charuco_photos, tmp_path):
    paths, _ = charuco_photos
    part = tmp_path / "part.png"
    true = charuco_photo(part, keep=0.55, seed=7)
    view = search_boards([*paths, part]).views[3]
    assert view.is_used, view.reason
    assert 6 <= view.corner_count < 24
    assert view.board == (4, 6)
    assert view.grid.shape == (6, 4, 2)
    assert np.isfinite(view.grid).all(-1).sum() == view.corner_count
    assert np.abs(view.corners - true[view.ids]).max() < 0.25


def test_too_little_of_a_charuco_board_is_said(charuco_photos, tmp_path):
    paths, _ = charuco_photos
    part = tmp_path / "part.png"
    charuco_photo(part, keep=0.3, seed=7)
    view = search_boards([*paths, part]).views[3]
    assert view.reason.startswith("only ")
    assert "corners of the ChArUco board found, 6 in two rows are needed" in view.reason


@pytest.mark.parametrize(
    ("request_", "code", "text"),
    [
        (BoardRequest(kind="charuco", size=(7, 5)), "board_swapped", "the sides were swapped"),
        (BoardRequest(kind="charuco", size=(6, 8)), "board_size", "5x7 squares, not 6x8; what"),
        (
            BoardRequest(square_m=0.04, marker_m=0.032),
            "marker_size",
            "markers are 0.59 of a square wide, but the lengths given say 0.80",
        ),
    ],
)
def test_a_charuco_board_named_wrongly_is_used_as_it_is(charuco_photos, request_, code, text):
    found = search_boards(charuco_photos[0], board=request_)
    assert found.board.squares == (5, 7)
    assert all(view.corner_count == 24 for view in found.views)
    assert codes(found) == [code]
    assert text in found.cautions[0].message


def test_another_dictionary_is_said(charuco_photos):
    found = search_boards(charuco_photos[0], board=BoardRequest(dictionary="DICT_7X7_50"))
    assert found.board is None
    assert {view.reason for view in found.views} == {
        "no ChArUco board found; markers sought: DICT_7X7_50"
    }


@pytest.mark.parametrize(
    ("squares", "legacy"),
    [
        ((5, 7), False),  # with an odd number of rows both patterns are the same
        *(((columns, 4), legacy) for columns in (6, 7, 11) for legacy in (False, True)),
    ],
)
def test_the_layout_is_told_by_the_markers(tmp_path, squares, legacy):
    path = tmp_path / "board.png"
    true = charuco_photo(path, squares=squares, legacy=legacy)
    grey = cv2.imread(str(path), 0)
    markers = find_markers(grey, ["DICT_5X5_250"])
    layout = layout_of(markers)
    assert (layout.squares_x, layout.is_legacy) == (squares[0], legacy)
    assert layout.marker_share == pytest.approx(0.6, rel=0.05)
    corners, ids = find_charuco(grey, layout, markers)
    assert sorted(ids) == list(range((squares[0] - 1) * (squares[1] - 1)))
    assert np.abs(corners - true[ids]).max() < 0.3


def test_a_few_markers_leave_the_layout_open(charuco_photos):
    grey = cv2.imread(str(charuco_photos[0][0]), 0)
    grey[:, 150:] = 255
    assert layout_of(find_markers(grey, ["DICT_5X5_250"])) is None
    assert find_markers(np.full((200, 200), 255, dtype=np.uint8), ["DICT_5X5_250"]) is None


def test_one_marker_alone_gives_no_corner():
    layout = Layout(dictionary="DICT_5X5_250", squares_x=5, marker_share=0.6)
    empty = np.full((200, 200), 255, dtype=np.uint8)
    quad = np.array([[[10.0, 10], [50, 10], [50, 50], [10, 50]]])
    markers = Markers(dictionary="DICT_5X5_250", corners=quad, ids=np.array([0]))
    corners, ids = find_charuco(empty, layout, markers)
    assert corners.shape == (0, 2)
    assert len(ids) == 0


def test_a_size_is_shown_only_by_the_whole_board(photos):
    grey = 255 * np.sqrt(np.clip(photos.pictures[1].mean(0), 0, 1)).astype(np.float32)
    assert shows(grey, (9, 6))
    assert not shows(grey, (8, 6))
    assert not shows(grey, (9, 5))
    assert not shows(grey, (10, 7))


def test_a_circle_tells_a_crossing_from_a_rim_and_a_hidden_one():
    picture = np.full((100, 100), 230, dtype=np.uint8)
    picture[20:50, 20:50] = picture[50:80, 50:80] = 20
    places = np.array([[49.5, 49.5], [49.5, 19.5], [19.5, 19.5], [35.0, 35.0]])
    assert are_crossings(picture, places, 10).tolist() == [True, False, False, False]
    picture[:, 56:] = 120
    assert are_crossings(picture, places, 10).tolist() == [False] * 4


def test_squares_counted_for_corners_are_noticed(photos):
    found = search_boards(photos.paths[:3], board=(10, 7))
    assert found.board is None
    assert {view.reason for view in found.views} == {
        "no board of 10x7 inner corners found; the photos show 9x6: count inner corners,"
        " not squares"
    }


def test_another_board_is_named(photos):
    found = search_boards(photos.paths[:3], board=(8, 7))
    assert {view.reason for view in found.views} == {
        "no board of 8x7 inner corners found; the photos show 9x6: name that size"
    }


def test_a_swapped_board_is_explained(photos):
    found = search_boards(photos.paths[:2], board=(6, 9))
    assert codes(found) == ["board_swapped"]
    assert "6x9 is taken as 9x6, long side first" in found.cautions[0].message
    assert codes(search_boards(photos.paths[:2], board=(9, 6))) == []


def test_a_board_cut_off_by_the_picture_is_explained(photos, tmp_path):
    path = tmp_path / "cut.png"
    corners, picture = photos.corners[0], photos.pictures[0]
    right = int(np.sort(corners[:, 0])[-10])
    grey = 255 * np.sqrt(np.clip(picture.mean(0), 0, 1))
    grey[:, right:] = 90
    cv2.imwrite(str(path), grey.astype(np.uint8))
    view = search_boards([*photos.paths[1:4], path]).views[3]
    assert view.reason.startswith("no board of 9x6 inner corners found")
    assert "a checkerboard must be wholly in view" in view.reason


@pytest.mark.shared_data
def test_a_symmetric_board_is_cautioned_against_once(gopro_wide):
    found = search_boards(gopro_wide[:3])
    assert found.board.size == (8, 6)
    assert codes(found) == ["symmetric_board"]
    assert "looks the same after half a turn: harmless" in found.cautions[0].message


@pytest.mark.shared_data
def test_a_part_named_for_the_whole_is_said(opencv_left):
    found = search_boards(opencv_left[:3], board=(7, 6))
    assert "board_size" in codes(found)
    assert "the photos show 9x6 inner corners, not 7x6" in found.cautions[0].message


def test_millimetres_given_for_metres_are_noticed(photos):
    found = search_boards(photos.paths[:1], board=BoardRequest(size=(9, 6), square_m=25.0))
    assert codes(found) == ["square_size"]


@pytest.mark.shared_data
@pytest.mark.parametrize("request_", [None, BoardRequest(kind="charuco"), REQUEST])
def test_real_charuco_photos_give_24_corners_each(charuco, request_):
    found = search_boards(charuco, board=request_)
    assert [view.corner_count for view in found.views] == [24] * 4
    assert [view.reason for view in found.views] == [""] * 4
    assert found.board.squares == (5, 7)
    assert found.cautions == ()


def save_jpeg(path, picture, quality=92):
    """Write light as a JPEG, as cameras code it."""
    coded = 255 * np.clip(picture.mean(0), 0, 1) ** (1 / 2.2)
    cv2.imwrite(str(path), np.rint(coded).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return path


def test_spoilt_photos_among_good_ones_are_named(photos, tmp_path):
    """Out of focus, moved along x and along y, overexposed, saved twice, cut short, turned."""
    light = [picture.astype(np.float32) for picture in photos.pictures]
    good = [save_jpeg(tmp_path / f"{i}.jpg", picture) for i, picture in enumerate(light)]

    def spoilt(name, picture):
        return save_jpeg(tmp_path / name, np.stack(picture))

    soft = spoilt("soft.jpg", [cv2.GaussianBlur(c, (0, 0), 2.0) for c in light[0]])
    along = spoilt("along.jpg", [cv2.blur(c, (8, 1)) for c in light[1]])
    down = spoilt("down.jpg", [cv2.blur(c, (1, 8)) for c in light[2]])
    bright = spoilt("bright.jpg", 5 * light[3])
    twice = save_jpeg(tmp_path / "twice.jpg", light[4], quality=80)
    cut = tmp_path / "cut.jpg"
    cut.write_bytes(good[0].read_bytes()[:9000])
    turned = spoilt("turned.jpg", light[5].transpose(0, 2, 1)[:, ::-1])
    found = search_boards([*good, soft, along, down, bright, twice, cut, turned])
    assert [view.reason for view in found.views[:6]] == [""] * 6
    reasons = [view.reason for view in found.views[6:]]
    for reason in reasons[:3]:
        assert reason.startswith("blurred: its edges are")
    assert reasons[3].startswith("overexposed: ")
    assert reasons[4] == f"shows the board exactly where {good[4]} does, saved twice? counted once"
    assert "is a cut or damaged JPEG" in reasons[5]
    assert reasons[6].startswith("480x640 px, but most photos are 640x480; a program turned it")
