"""What only the photos together tell: which of them are blurred, clipped, alike or of another size.

Each check gives the reason to the views that it sets aside, and leaves the others as they are.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.checkers import most_common, spacing
from calibration.view import View

BLUR_FACTOR, BLUR_FLOOR_PX = 1.6, 0.8
"""A view is blurred when its edges are wider than the factor times, and by the floor over, the
median of the set. Good views of two real sets reach 1.2 and 1.45 times."""
BLENDED_SHARE = 0.45
"""Width of the edges over the smallest square from which a view is blurred whatever the others."""
MOST_CLIPPED = 0.3
"""Share of a board's inner part that may have met white; half of it is paper."""
MOST_SHIFTED = 0.4
"""How far white may then reach into the dark squares, over the width of the edges.

Rendered: 0.11 unclipped; 0.31 exposed twice as long as white allows, where corners err by a third
more; 0.49 three times, where they err twice as far. White that only just clips does no harm.
"""
SAME_PHOTO_SHARE = 3e-4
"""Mean distance of corners over the picture's diagonal below which two photos are one, saved twice.

0.24 px at 640x480: a JPEG saved anew moves corners by less, a hand by far more.
"""


def check_together(views: Sequence[View]) -> tuple[View, ...]:
    """Apply every check in turn."""
    return _without_twins(_without_blurred(_without_clipped(_of_one_size(views))))


def _of_one_size(views: Sequence[View]) -> tuple[View, ...]:
    sizes = [view.picture_size for view in views if view.is_used and view.picture_size]
    usual = most_common(sizes)
    return tuple(
        replace(view, reason=_other_size(view.picture_size, usual))
        if view.is_used and usual and view.picture_size and view.picture_size != usual
        else view
        for view in views
    )


def _other_size(size: tuple[int, int], usual: tuple[int, int]) -> str:
    text = f"{size[0]}x{size[1]} px, but most photos are {usual[0]}x{usual[1]}; "
    if size == usual[::-1]:
        return text + "a program turned it when it was saved: copy it again from the camera"
    return text + "calibrate each kind of file on its own"


def _without_clipped(views: Sequence[View]) -> tuple[View, ...]:
    return tuple(
        replace(
            view,
            reason=f"overexposed: {100 * view.clipped_share:.0f} % of the board met white, and its"
            f" edges moved by {view.edge_shift_px:.1f} px; expose less",
        )
        if view.is_used
        and view.clipped_share is not None
        and view.edge_shift_px is not None
        and view.edge_px is not None
        and view.clipped_share > MOST_CLIPPED
        and view.edge_shift_px > MOST_SHIFTED * max(view.edge_px)
        else view
        for view in views
    )


def _without_blurred(views: Sequence[View]) -> tuple[View, ...]:
    widths = {id(view): max(view.edge_px) for view in views if view.is_used and view.edge_px}
    if not widths:
        return tuple(views)
    usual = float(np.nanmedian(list(widths.values())))
    limit = max(BLUR_FACTOR * usual, usual + BLUR_FLOOR_PX)
    checked = []
    for view in views:
        width = widths.get(id(view), 0.0)
        if width > limit:
            text = f"blurred: its edges are {width:.1f} px wide, those of the others {usual:.1f} px"
            view = replace(view, reason=text)
        elif width > BLENDED_SHARE * _spacing(view):
            text = f"blurred: its edges are {width:.1f} px wide, its squares {_spacing(view):.1f}"
            view = replace(view, reason=f"{text} px; focus, hold still, or come nearer")
        checked.append(view)
    return tuple(checked)


def _spacing(view: View) -> float:
    return spacing(view.grid) if view.corner_count else math.inf


def _without_twins(views: Sequence[View]) -> tuple[View, ...]:
    checked: list[View] = []
    for view in views:
        twin = _twin(view, checked) if view.is_used else None
        if twin is not None:
            reason = f"shows the board exactly where {twin} does, saved twice? counted once"
            view = replace(view, reason=reason)
        checked.append(view)
    return tuple(checked)


def _twin(view: View, others: Sequence[View]) -> Path | None:
    grid = view.grid
    limit = SAME_PHOTO_SHARE * math.hypot(*(view.picture_size or (0, 0)))
    for other in others:
        if not other.is_used or other.board != view.board:
            continue
        gaps = np.linalg.norm(grid - other.grid, axis=-1)
        shared = np.isfinite(gaps)
        if 2 * shared.sum() > view.corner_count and gaps[shared].mean() < limit:
            return other.path
    return None
