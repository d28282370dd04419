from dataclasses import replace

import numpy as np
import pytest

from calibration.board import Board
from calibration.view import View
from calibration.view_checks import check_together

GOOD = (2.4, 2.6)


@pytest.fixture
def views(make_views, tilted_poses):
    sharp = np.random.default_rng(2).uniform(0.85, 1.2, 12)
    return [
        replace(view, edge_px=(GOOD[0] * s, GOOD[1] * s), edge_shift_px=0.3, clipped_share=0.05)
        for view, s in zip(make_views(tilted_poses(12)), sharp, strict=True)
    ]


def used(views):
    return [view.is_used for view in check_together(views)]


def test_good_views_are_kept_as_they_are(views):
    assert check_together(views) == tuple(views)


@pytest.mark.parametrize("edges", [(5.5, 2.5), (2.5, 5.5), (9.0, 9.0)])
def test_blur_in_either_direction_is_named(views, edges):
    views[3] = replace(views[3], edge_px=edges)
    checked = check_together(views)
    assert [view.is_used for view in checked] == [i != 3 for i in range(12)]
    width = max(edges)
    assert checked[3].reason.startswith(f"blurred: its edges are {width:.1f} px wide, those of the")


def test_a_set_that_is_blurred_throughout_is_named_too(views):
    blurred = [replace(view, edge_px=(30.0, 30.0)) for view in views]
    checked = check_together(blurred)
    assert not any(view.is_used for view in checked)
    assert "; focus, hold still, or come nearer" in checked[0].reason


def test_white_that_moved_the_edges_is_named_and_white_that_did_not_is_kept(views):
    views[0] = replace(views[0], clipped_share=0.5, edge_shift_px=0.4)
    views[1] = replace(views[1], clipped_share=0.5, edge_shift_px=1.9)
    views[2] = replace(views[2], clipped_share=0.1, edge_shift_px=1.9)
    checked = check_together(views)
    assert [view.is_used for view in checked[:3]] == [True, False, True]
    assert checked[1].reason == (
        "overexposed: 50 % of the board met white, and its edges moved by 1.9 px; expose less"
    )


def test_another_size_and_a_turned_picture_are_told_apart(views):
    views[5] = replace(views[5], picture_size=(320, 240))
    views[6] = replace(views[6], picture_size=(480, 640))
    checked = check_together(views)
    assert checked[5].reason.startswith("320x240 px, but most photos are 640x480; calibrate each")
    assert "a program turned it when it was saved" in checked[6].reason
    assert sum(view.is_used for view in checked) == 10


def test_the_same_photo_saved_twice_counts_once(views):
    noise = np.random.default_rng(1).normal(0, 0.05, (54, 2))
    views[7] = replace(views[2], path=views[7].path, corners=views[2].corners + noise)
    views[8] = replace(views[3], path=views[8].path, corners=views[3].corners + 1.0)
    checked = check_together(views)
    assert [view.is_used for view in checked] == [i != 7 for i in range(12)]
    assert checked[7].reason.startswith(f"shows the board exactly where {views[2].path} does")


def test_parts_of_a_board_are_compared_where_they_overlap(make_views, tilted_poses):
    whole = make_views(tilted_poses(1))[0]
    target = Board(kind="charuco", columns=9, rows=6)

    def part(name, ids, shift=0.0):
        return replace(
            whole, path=whole.path.with_name(name), target=target, ids=ids,
            corners=whole.corners[ids] + shift,
        )  # fmt: skip

    first, second, third = np.arange(30), np.arange(10, 40), np.arange(40, 54)
    views = [part("a", first), part("b", second), part("c", third), part("d", second, 2.0)]
    assert used(views) == [True, False, True, True]


def test_views_that_are_out_already_keep_their_reason():
    views = [View(path=name, reason="cannot be read") for name in ("a", "b")]
    assert check_together(views) == tuple(views)
