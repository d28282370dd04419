"""From photos of a checkerboard to a camera with its uncertainty."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from calibration.corners import View, find_boards
from calibration.lens_fit import (
    LensFit,
    board_points,
    fit_lens,
    left_out_rms,
    lens_covariance,
)
from toolkit.camera import Camera
from toolkit.errors import CalibrationError, ConfigError, ImageError
from toolkit.measurement import Caution

Array = NDArray[np.float64]

FEWEST_VIEWS = 3
MOST_NAMED = 4
"""Photos that an error's one line names."""
ADVISED_VIEWS = 8
"""Below this many views a caution is given."""
SAME_VIEW_SHARE = 0.01
"""Views whose corners moved less than this share of the picture's diagonal count as one."""
OUTLIER_FACTOR = 5.0
OUTLIER_FLOOR_PX = 1.0
"""A view is left out when its RMS exceeds the floor and the factor times the median."""
K3_GAIN = 0.99
"""k3 is kept when it lowers the left-out RMS below this share: a k3 that fits noise raises it."""
WORST_FOCAL_STD = 0.05
DOUBTFUL_FOCAL_STD = 0.01
"""Standard deviation of fx over fx from which a calibration is refused, or doubted."""
WORST_RMS_SHARE = 0.005
"""RMS over the picture's diagonal from which no lens of this model fits."""
POOR_COVERAGE = 0.3
"""Share of the picture the corners must surround; the lens is extrapolated elsewhere."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A camera, and what each photo said about it."""

    camera: Camera  # of the photos' size, with covariance
    rms_px: float
    board: tuple[int, int]  # inner corners along the long and the short side
    views: tuple[View, ...]  # one per photo, in the order given
    warnings: tuple[Caution, ...] = ()

    @property
    def used(self) -> tuple[View, ...]:
        """The views that took part."""
        return tuple(view for view in self.views if view.is_used)


def calibrate(
    images: Sequence[Path],
    *,
    board: tuple[int, int] | None = None,
    square: float | None = None,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> Calibration:
    """Calibrate a camera from photos of a checkerboard.

    Args:
        images: photos, RAW or not, of one camera at one focal length and focus.
        board: inner corners along the two sides, found from the photos when None.
        square: side of a square, metre; only the poses of the views need it (squares when None).
        on_photo: called after each photo is first read.

    Returns:
        The camera with its covariance, and every view with its corners and pose or the reason it
        was left out.

    Raises:
        ConfigError: no photos, or an impossible board or square.
        ImageError: when none of the photos can be read.
        CalibrationError: too few different views, or views that leave the focal length open.
    """
    check_request(images, board, square)
    views = find_boards(images, board=board, on_photo=on_photo)
    return calibrate_views(views, square=square)


def calibrate_views(views: Sequence[View], *, square: float | None = None) -> Calibration:
    """Calibrate from views whose corners are already found; see `calibrate`."""
    _check_views(views)
    kept, lens = _fit_without_outliers(views)
    used = [view for view in kept if view.is_used]
    size, board, corners = _shared(used)
    covariance = lens_covariance(board_points(board), corners, lens)
    camera = _camera(lens, covariance, size)
    _check_trust(camera, lens)
    return Calibration(
        camera=camera,
        rms_px=lens.rms_px,
        board=board,
        views=_with_poses(kept, lens, 1.0 if square is None else square),
        warnings=_cautions(camera, corners),
    )


def check_request(
    images: Sequence[Path], board: tuple[int, int] | None, square: float | None
) -> None:
    """Raise `ConfigError` for what no photo could mend; see `calibrate`."""
    if not images:
        raise ConfigError("no photos were given; name photos of a checkerboard")
    if board is not None and min(board) < 3:
        raise ConfigError(f"board {board[0]}x{board[1]} has too few inner corners; 3x3 at least")
    if square is not None and not (math.isfinite(square) and square > 0):
        raise ConfigError(f"square is {square} m; a positive length is needed")


def _check_views(views: Sequence[View]) -> None:
    if all(view.picture_size is None for view in views):
        raise ImageError(f"none of the {len(views)} photos can be read: {reasons(views)}")
    used = [view for view in views if view.is_used]
    different = _count_different(used)
    if different >= FEWEST_VIEWS:
        return
    text = f"{different} different usable views of a board among {len(views)} photos"
    if different < len(used):
        text += f" ({len(used)} show it, some from the same place)"
    raise CalibrationError(
        f"{text}, {FEWEST_VIEWS} are needed: {reasons(views) or 'all were used'};"
        " take 10 or more, tilted in different directions"
    )


def reasons(views: Sequence[View], most: int = MOST_NAMED) -> str:
    """Name the first views that are not used, each with its reason."""
    texts = [
        view.reason if view.reason.startswith(str(view.path)) else f"{view.path}: {view.reason}"
        for view in views
        if not view.is_used
    ]
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return "; ".join(texts[:most]) + more


def _count_different(views: Sequence[View]) -> int:
    """Count views of which no two show the board at the same place."""
    different: list[Array] = []
    for view in views:
        corners = view.corners
        if corners is None or view.picture_size is None:
            continue
        limit = SAME_VIEW_SHARE * math.hypot(*view.picture_size)
        if all(_distance(corners, other) > limit for other in different):
            different.append(corners)
    return len(different)


def _distance(corners: Array, other: Array) -> float:
    """Mean distance of two views' corners, px, whichever end of the board comes first."""
    turned = (np.linalg.norm(corners - o, axis=-1).mean() for o in (other, other[::-1]))
    return float(min(turned))


def _shared(used: Sequence[View]) -> tuple[tuple[int, int], tuple[int, int], list[Array]]:
    """Picture size and board, which all used views share, and their corners."""
    size, board = used[0].picture_size, used[0].board
    assert size is not None  # used views have both, for the type checker
    assert board is not None
    return size, board, [view.corners for view in used if view.corners is not None]


def _fit_without_outliers(views: Sequence[View]) -> tuple[tuple[View, ...], LensFit]:
    """Fit, set aside views that do not fit the rest, and fit again, at most twice."""
    kept, lens = tuple(views), _fit([view for view in views if view.is_used])
    for _ in range(2):
        limit = max(OUTLIER_FLOOR_PX, OUTLIER_FACTOR * float(np.median(lens.view_rms)))
        rms = iter(lens.view_rms)
        doubted = tuple(
            replace(view, reason=f"does not fit the other views ({error:.1f} px)")
            if view.is_used and (error := next(rms)) > limit
            else view
            for view in kept
        )
        used = [view for view in doubted if view.is_used]
        if len(used) == len(lens.view_rms) or _count_different(used) < FEWEST_VIEWS:
            break
        kept, lens = doubted, _fit(used)
    return kept, lens


def _fit(used: Sequence[View]) -> LensFit:
    """Fit k1 k2 p1 p2, and k3 too where views left out are then predicted better."""
    size, board, corners = _shared(used)
    points = board_points(board)
    with_k3 = len(used) > FEWEST_VIEWS + 1 and left_out_rms(
        points, corners, size, with_k3=True
    ) < K3_GAIN * left_out_rms(points, corners, size, with_k3=False)
    return fit_lens(points, corners, size, with_k3=with_k3)


def _camera(lens: LensFit, covariance: Array, size: tuple[int, int]) -> Camera:
    (fx, _, cx), (_, fy, cy) = lens.matrix[:2].tolist()
    return Camera(
        width=size[0],
        height=size[1],
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=tuple(lens.distortion.tolist()),
        covariance=torch.from_numpy(covariance),
    )


def focal_std(camera: Camera) -> float:
    """Give the larger relative standard deviation of the two focal lengths."""
    assert camera.covariance is not None  # a calibrated camera has one
    std = camera.covariance.diagonal()[:2].sqrt() / camera.parameters[:2]
    return float(std.max())


def _check_trust(camera: Camera, lens: LensFit) -> None:
    if lens.rms_px > WORST_RMS_SHARE * math.hypot(camera.width, camera.height):
        raise CalibrationError(
            f"no lens of this model fits the corners (RMS {lens.rms_px:.1f} px); check that the"
            " board is flat and that all photos are from one camera at one focal length"
        )
    if not focal_std(camera) < WORST_FOCAL_STD:  # also when it is NaN
        raise CalibrationError(
            f"the focal length stays open (standard deviation {100 * focal_std(camera):.0f} %);"
            " tilt the board by 20 to 45 degrees in several directions"
        )


def _with_poses(views: Sequence[View], lens: LensFit, square: float) -> tuple[View, ...]:
    """Complete the used views with their RMS and pose."""
    numbers = iter(zip(lens.view_rms, lens.rotation, lens.translation, strict=True))
    done = []
    for view in views:
        if view.is_used:
            rms, turn, shift = next(numbers)
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift * square
            view = replace(view, rms_px=float(rms), T_cam_board=pose)
        done.append(view)
    return tuple(done)


def _cautions(camera: Camera, corners: Sequence[Array]) -> tuple[Caution, ...]:
    """Say what the reader should know although the calibration holds."""
    cautions = []
    if len(corners) < ADVISED_VIEWS:
        text = f"only {len(corners)} views were used; 10 to 20 make the lens surer"
        cautions.append(Caution(code="few_views", message=text))
    if focal_std(camera) > DOUBTFUL_FOCAL_STD:
        text = f"the focal length is only known to {100 * focal_std(camera):.1f} %; tilt the board"
        cautions.append(Caution(code="focal_length_uncertain", message=text))
    share = _coverage(camera, corners)
    if share < POOR_COVERAGE:
        text = (
            f"the corners surround {100 * share:.0f} % of the picture; bring the board to its edges"
        )
        cautions.append(Caution(code="poor_coverage", message=text))
    if not bool(torch.isfinite(camera.unproject(_picture_corners(camera))).all()):
        text = "the distortion cannot be inverted in the picture's corners; bring the board there"
        cautions.append(Caution(code="distortion_folds", message=text))
    return tuple(cautions)


def _coverage(camera: Camera, corners: Sequence[Array]) -> float:
    """Area of the convex hull of all corners over that of the picture."""
    hull = cv2.convexHull(np.concatenate(corners).astype(np.float32))
    return float(cv2.contourArea(hull)) / (camera.width * camera.height)


def _picture_corners(camera: Camera) -> torch.Tensor:
    right, bottom = camera.width - 1.0, camera.height - 1.0
    places = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]]
    return torch.tensor(places, dtype=torch.float64)
