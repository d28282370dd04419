"""See from the first photos what board they show, so that the rest is searched for it alone."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.board import BoardRequest, Kind
from calibration.checkers import Grey, glance, holds_markers, shows, size_of
from calibration.markers import COMMON, Layout, find_markers, layout_of
from calibration.workers import in_parallel
from toolkit.errors import ConfigError, ImageError
from toolkit.imaging.brightness import read_brightness

AGREEING = 2
"""Photos that must be read alike; misread ones hardly ever are."""
USUAL = (9, 6)
"""The board most people print, ours included: seeking it first takes a tenth of any other glance.
"""
MOST_GLANCES = 6
"""Photos that are looked at, at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """What the first photos show."""

    kind: Kind
    size: tuple[int, int] | None = None  # of a checkerboard, where photos agree or one was read
    is_sure: bool = False  # whether they agree
    layout: Layout | None = None  # of a ChArUco board


def survey(photos: Sequence[Path], request: BoardRequest) -> Survey:
    """Look at as few photos as tell what board they show."""
    if request.kind == "charuco":
        return Survey(kind="charuco", layout=_see_layout(photos, request))
    size = (max(request.size), min(request.size)) if request.size else USUAL
    if _shown_at_once(photos, size):
        return Survey(kind="checker", size=size, is_sure=True)
    votes: Counter[tuple[int, int]] = Counter()
    marked = 0
    step = AGREEING if request.size is None else 1
    for first in range(0, min(len(photos), MOST_GLANCES), step):
        for seen, is_marked in in_parallel(_glance, photos[first : first + step]):
            marked += is_marked
            if seen is not None and not is_marked:
                votes[seen] += 1
        if max([marked, *votes.values()]) >= AGREEING:
            break
        if request.size is not None and votes[request.size] + votes[request.size[::-1]]:
            break  # one photo that shows what was said is enough
    if request.kind is None and marked >= max(votes.values(), default=0):
        layout = _see_layout(photos, request)
        if layout is not None:
            return Survey(kind="charuco", layout=layout)
    if not votes:
        return Survey(kind="checker")
    size = max(votes, key=lambda pair: (votes[pair], pair))
    return Survey(kind="checker", size=size, is_sure=votes[size] >= AGREEING)


def _shown_at_once(photos: Sequence[Path], size: tuple[int, int]) -> bool:
    grey = next((grey for path in photos if (grey := _grey(path)) is not None), None)
    return grey is not None and shows(grey, size)


def _glance(path: Path) -> tuple[tuple[int, int] | None, bool]:
    """Size of the board a photo seems to show, and whether its white squares are printed on."""
    grey = _grey(path)
    corners = None if grey is None else glance(grey)
    if corners is None or grey is None:
        return None, False
    return size_of(corners), holds_markers(grey, corners)


def _see_layout(photos: Sequence[Path], request: BoardRequest) -> Layout | None:
    """The layout of markers that two photos agree on, or most; its marker share is their median."""
    names = COMMON if request.dictionary is None else (request.dictionary,)
    seen: list[Layout] = []
    for path in photos[:MOST_GLANCES]:
        grey = _grey(path)
        markers = None if grey is None else find_markers(grey, names)
        layout = None if markers is None else layout_of(markers)
        if layout is None:
            continue
        seen.append(layout)
        names = (layout.dictionary,)
        if _alike(seen, layout) >= AGREEING:
            break
    if not seen:
        return None
    usual = max(seen, key=lambda layout: _alike(seen, layout))
    shares = [layout.marker_share for layout in seen if _pattern(layout) == _pattern(usual)]
    return Layout(
        dictionary=usual.dictionary,
        squares_x=usual.squares_x,
        marker_share=float(np.median(shares)),
        is_legacy=usual.is_legacy,
    )


def _alike(seen: Sequence[Layout], layout: Layout) -> int:
    return sum(_pattern(other) == _pattern(layout) for other in seen)


def _pattern(layout: Layout) -> tuple[str, int, bool]:
    return layout.dictionary, layout.squares_x, layout.is_legacy


def _grey(path: Path) -> Grey | None:
    """A photo in grey; None where it cannot be read, which the search itself reports."""
    try:
        return read_brightness(path).grey
    except (ImageError, ConfigError):
        return None
