"""Choose a lens although some views or corners are misread: they are set aside and named."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.choose_lens import Choice, Tried, choose_again, choose_lens, polished
from calibration.corners import View
from calibration.coverage import count_cells, facing, tilt_counts
from calibration.lens_fit import Corners, gather, residuals
from calibration.trust import FEWEST_VIEWS, covers
from toolkit.measurement import Caution

Array = NDArray[np.float64]

VIEW_FACTOR, VIEW_FLOOR_PX = 4.0, 0.4
"""A view is left out when others miss it by more than the floor and this times the median."""
CORNER_FACTOR, CORNER_FLOOR_PX = 8.0, 0.5
"""A corner is set aside when it is off by more than the floor and this times the scatter."""
MOST_CORNERS = 0.15
"""Share of a view's corners that can be set aside; of a view with more, none: the view is odd."""
ROUNDS = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kept:
    """The views, those left out with their reason, and the lens chosen from the others."""

    views: tuple[View, ...]
    corners: Corners  # of the used views
    choice: Choice
    cautions: tuple[Caution, ...]


def corners_of(views: Sequence[View]) -> Corners:
    """Gather the corners of the used views."""
    used = [view for view in views if view.is_used and view.corners is not None]
    size = used[0].picture_size
    assert size is not None  # used views have one, for the type checker
    return gather(
        [v.points for v in used], [v.corners for v in used if v.corners is not None], size
    )


def choose_robustly(views: Sequence[View], family: str) -> Kept:
    """Choose a lens, setting aside what does not fit the rest, the worst first.

    A view stays although it does not fit where the places and tilts of the others would no longer
    pass their gates: a caution says so then.

    Raises:
        CalibrationError: when the views do not determine a lens.
    """
    kept, corners = tuple(views), corners_of(views)
    choice = choose_lens(corners, family)
    for _ in range(ROUNDS):
        lighter = _set_aside(corners, choice)
        odd = _odd_views(lighter, choice)
        odd = [number for number in odd if not _is_needed(kept, choice, number)][:1]
        if not odd and (lighter.weight == corners.weight).all():
            break
        errors = np.sqrt(choice.taken.held_out.squares)
        kept = _leave_out(kept, {number: float(errors[number]) for number in odd})
        still = np.array([number not in odd for number in range(corners.views)])
        corners = lighter.only(still)
        choice = choose_again(corners, choice, still)
    choice = polished(corners, choice)
    return Kept(views=kept, corners=corners, choice=choice, cautions=_notes(kept, corners, choice))


def _best(choice: Choice) -> Tried:
    """The lens that predicts left-out views best, whatever its terms."""
    return min(choice.tried, key=lambda one: float(np.median(one.held_out.squares)))


def _set_aside(corners: Corners, choice: Choice) -> Corners:
    """Give no weight to corners that lie where no other says they should."""
    error = np.linalg.norm(residuals(corners, _best(choice).fit), axis=-1)
    seen = np.where(corners.weight > 0, error, np.nan)
    middle = np.nanmedian(seen, axis=1)
    scatter = np.maximum(middle, np.median(middle))[:, None] / 1.18  # the median of a Rayleigh
    far = (error > np.maximum(CORNER_FLOOR_PX, CORNER_FACTOR * scatter)) & (corners.weight > 0)
    few = far.sum(axis=1) <= MOST_CORNERS * corners.weight.sum(axis=1)
    return corners.weighing(np.where(far & few[:, None], 0.0, corners.weight))


def _odd_views(corners: Corners, choice: Choice) -> list[int]:
    """Views that the others predict much worse than most, the worst first."""
    error = _best(choice).held_out.error * corners.weight[..., None]
    count = np.maximum(corners.weight.sum(axis=1), 1)
    rms = np.sqrt((error**2).sum(axis=(1, 2)) / count)
    limit = max(VIEW_FLOOR_PX, VIEW_FACTOR * float(np.median(rms)))
    return [int(number) for number in np.argsort(-rms) if rms[number] > limit]


def _is_needed(views: Sequence[View], choice: Choice, number: int) -> bool:
    """Whether without one used view the others are too few or no longer cover what they did."""
    used = [view for view in views if view.is_used]
    if len(used) <= FEWEST_VIEWS:
        return True
    lean = facing(choice.taken.fit.rotation)
    others = [index for index in range(len(used)) if index != number]
    return _cover(used, lean) and not _cover([used[i] for i in others], lean[others])


def _cover(used: Sequence[View], lean: Array) -> bool:
    size = used[0].picture_size
    assert size is not None  # used views have one, for the type checker
    seen = [view.corners for view in used if view.corners is not None]
    return covers(count_cells(seen, size), tilt_counts(lean))


def _leave_out(views: Sequence[View], errors: dict[int, float]) -> tuple[View, ...]:
    """Give the reason to used views by their number among the used."""
    left, number = [], -1
    for view in views:
        number += view.is_used
        if view.is_used and number in errors:
            text = f"does not fit the other views ({errors[number]:.1f} px)"
            view = replace(view, reason=text)
        left.append(view)
    return tuple(left)


def _notes(views: Sequence[View], corners: Corners, choice: Choice) -> tuple[Caution, ...]:
    """Name corners set aside, and views kept although they do not fit."""
    used, notes = [view for view in views if view.is_used], []
    count = [
        view.corner_count - int((w > 0).sum()) for view, w in zip(used, corners.weight, strict=True)
    ]
    if any(count):
        names = ", ".join(str(view.path) for view, n in zip(used, count, strict=True) if n)
        text = f"{sum(count)} misread corners were set aside, in {names}"
        notes.append(Caution(code="corners_set_aside", message=text))
    odd = _odd_views(corners, choice)
    if odd:
        names = ", ".join(str(used[number].path) for number in odd)
        text = f"{names}: does not fit the other views, but nothing else covers what it shows"
        notes.append(Caution(code="odd_view_kept", message=f"{text}; take more photos there"))
    return tuple(notes)
