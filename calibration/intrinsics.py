"""From photos of a calibration board to a camera with its uncertainty."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from calibration.advice import Advice, advice_text, advise
from calibration.board import BoardRequest
from calibration.bootstrap import bootstrap_covariance
from calibration.choose_lens import Tried
from calibration.corners import View, search_boards
from calibration.coverage import count_cells, facing, tilt_counts
from calibration.different_views import count_different
from calibration.halves import compare_halves
from calibration.lens_doubt import Doubt, lens_doubt
from calibration.lens_fit import LensFit, residuals, view_rms
from calibration.lens_models import FAMILIES
from calibration.plain_trust import gate_lines, score_text
from calibration.projection_doubt import projection_std
from calibration.robust_choice import Kept, choose_robustly
from calibration.trust import FEWEST_VIEWS, Evidence, Gate, Halves, gates_of
from toolkit.camera import Camera
from toolkit.camera_file import write_camera
from toolkit.errors import CalibrationError, ConfigError, ImageError
from toolkit.measurement import Caution

Array = NDArray[np.float64]

MOST_NAMED = 4
"""Photos that an error's one line names."""
FEWEST_DRAWS = 20
"""Of a bootstrap; fewer tell a standard deviation to no better than a sixth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelScore:
    """One lens that was tried."""

    model: str  # in words: pinhole 5
    family: str  # as camera.toml calls it
    terms: int  # distortion coefficients fitted
    is_bent: bool  # whether the board's bend was fitted
    rms_px: float
    held_out_px: float  # error of views left out of the fit
    is_taken: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A camera, what each photo said about it, and how far it can be trusted."""

    camera: Camera  # of the photos' size, with covariance
    rms_px: float
    held_out_px: float  # error of views left out of the fit; their poses are fitted
    board: tuple[int, int]  # inner corners along the long and the short side
    views: tuple[View, ...]  # one per photo, in the order given
    model_scores: tuple[ModelScore, ...]
    board_shape: Array | None  # [R, C] height of the board's points, squares; None: taken as flat
    grid: NDArray[np.int64]  # [5, 5] corners in each cell of the picture
    tilts: dict[str, int]  # views whose board faces left, right, up, down
    halves: Halves | None  # None of fewer than six views
    gates: tuple[Gate, ...]
    advice: tuple[Advice, ...]
    corner_std_px: float  # scatter of a corner's coordinate
    bootstrap_ratio: tuple[float, ...] | None  # bootstrap's over the covariance's std, fx fy cx cy
    warnings: tuple[Caution, ...] = ()

    @property
    def used(self) -> tuple[View, ...]:
        """The views that took part."""
        return tuple(view for view in self.views if view.is_used)

    @property
    def advice_text(self) -> str:
        """Which photos to add, in one line; empty when none is needed."""
        return advice_text(self.advice)

    def projection_std(self, columns: int = 24, rows: int = 18) -> Array:
        """Give what the lens's uncertainty does over the picture, px [rows, columns]."""
        return projection_std(self.camera, columns, rows)


def calibrate(
    images: Sequence[Path],
    *,
    board: tuple[int, int] | None = None,
    square: float | None = None,
    model: str = "auto",
    bootstrap: int = 0,
    on_photo: Callable[[Path], None] = lambda path: None,
) -> Calibration:
    """Calibrate a camera from photos of a checkerboard.

    Args:
        images: photos, RAW or not, of one camera at one focal length and focus.
        board: inner corners along the two sides, found from the photos when None.
        square: side of a square, metre; only the poses of the views need it (squares when None).
        model: "auto" compares all lenses; "pinhole", "rational" and "fisheye" those of that kind.
        bootstrap: draws of the views by which the covariance is checked; 0 for none.
        on_photo: called after each photo is first read.

    Returns:
        The camera with its covariance, and every view with its corners and pose or the reason it
        was left out.

    Raises:
        ConfigError: no photos, or an impossible board, square, model or number of draws.
        ImageError: when none of the photos can be read.
        CalibrationError: too few different views, or views that leave the focal length open.
    """
    check_request(images, board, square, model, bootstrap)
    request = BoardRequest(size=board, square_m=square)
    found = search_boards(images, board=request, on_photo=on_photo)
    return calibrate_views(
        found.views, square=square, model=model, bootstrap=bootstrap, cautions=found.cautions
    )


def calibrate_views(
    views: Sequence[View],
    *,
    square: float | None = None,
    model: str = "auto",
    bootstrap: int = 0,
    cautions: Sequence[Caution] = (),
) -> Calibration:
    """Calibrate from views whose corners are already found; see `calibrate`.

    Args:
        views: one per photo.
        square: side of a square, metre.
        model: one of `FAMILIES`.
        bootstrap: draws of the views; 0 for none.
        cautions: what else the reader should know, put before what is found here.
    """
    _check_views(views)
    kept = choose_robustly(views, model)
    corners, taken = kept.corners, kept.choice.taken
    doubt = lens_doubt(corners, kept.choice)
    covariance, ratio = doubt.covariance, None
    if bootstrap:
        covariance, ratio = _widen(doubt, bootstrap_covariance(corners, taken.fit, bootstrap))
    camera = _camera(taken.fit, covariance, corners.picture_size)
    evidence = _evidence(camera, kept)
    gates = gates_of(evidence)
    _refuse(gates)
    advice = advise(evidence.grid, evidence.tilts, corners.views, gates)
    return Calibration(
        camera=camera,
        rms_px=taken.rms_px,
        held_out_px=taken.held_out.rms_px,
        board=_board(kept.views),
        views=_with_poses(kept, 1.0 if square is None else square),
        model_scores=tuple(_score(one, taken) for one in kept.choice.tried),
        board_shape=_shape(kept),
        grid=evidence.grid,
        tilts=dict(evidence.tilts),
        halves=evidence.halves,
        gates=gates,
        advice=advice,
        corner_std_px=doubt.corner_px,
        bootstrap_ratio=ratio,
        warnings=(*cautions, *kept.cautions, *_cautions(gates)),
    )


def write_calibration(path: Path, result: Calibration) -> None:
    """Write camera.toml with how the lens was got; see `toolkit.camera_file.write_camera`."""
    names = [view.path.name for view in result.used]
    write_camera(
        path,
        result.camera,
        rms_px=result.rms_px,
        held_out_px=result.held_out_px,
        views=len(names),
        images=names,
        model_scores=[score_text(score) for score in result.model_scores],
        gates=gate_lines(result),
    )


def check_request(
    images: Sequence[Path],
    board: tuple[int, int] | None,
    square: float | None,
    model: str = "auto",
    bootstrap: int = 0,
) -> None:
    """Raise `ConfigError` for what no photo could mend; see `calibrate`."""
    if not images:
        raise ConfigError("no photos were given; name photos of a checkerboard")
    if board is not None and min(board) < 3:
        raise ConfigError(f"board {board[0]}x{board[1]} has too few inner corners; 3x3 at least")
    if square is not None and not (math.isfinite(square) and square > 0):
        raise ConfigError(f"square is {square} m; a positive length is needed")
    if model not in FAMILIES:
        raise ConfigError(f"model '{model}' is unknown; use one of {', '.join(FAMILIES)}")
    if bootstrap and bootstrap < FEWEST_DRAWS:
        raise ConfigError(f"{bootstrap} bootstrap draws are too few; 0 or at least {FEWEST_DRAWS}")


def _check_views(views: Sequence[View]) -> None:
    if all(view.picture_size is None for view in views):
        raise ImageError(f"none of the {len(views)} photos can be read: {reasons(views)}")
    used = [view for view in views if view.is_used]
    different = count_different(used)
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


def _board(views: Sequence[View]) -> tuple[int, int]:
    board = next(view.board for view in views if view.is_used)
    assert board is not None  # used views have one, for the type checker
    return board


def _camera(fit: LensFit, covariance: Array, size: tuple[int, int]) -> Camera:
    fx, fy, cx, cy, *distortion = fit.lens.tolist()
    return Camera(
        width=size[0],
        height=size[1],
        model=fit.model.family,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=tuple(distortion),
        covariance=torch.from_numpy(covariance),
    )


def _widen(doubt: Doubt, drawn: Array) -> tuple[Array, tuple[float, ...]]:
    """Widen the covariance where the bootstrap scatters more; give their ratio for fx fy cx cy."""
    std = np.sqrt(np.diagonal(doubt.covariance))
    ratio = np.sqrt(np.diagonal(drawn)) / np.where(std > 0, std, np.inf)
    # one factor for all: the terms of a distortion undo each other, which must stay so
    factor = max(1.0, float(ratio[:4].max()))
    return factor**2 * doubt.covariance, tuple(ratio[:4].tolist())


def _evidence(camera: Camera, kept: Kept) -> Evidence:
    taken, corners = kept.choice.taken, kept.corners
    lean = facing(taken.fit.rotation)
    seen = [view.corners for view in kept.views if view.is_used and view.corners is not None]
    return Evidence(
        camera=camera,
        views=corners.views,
        grid=count_cells(seen, corners.picture_size),
        tilts=tilt_counts(lean),
        lean=lean,
        rms_px=taken.rms_px,
        held_out_px=taken.held_out.rms_px,
        halves=compare_halves(corners, taken.fit, camera),
    )


def _refuse(gates: Sequence[Gate]) -> None:
    for gate in gates:
        if gate.is_refusal and not gate.is_passed:
            raise CalibrationError(gate.text)


def _cautions(gates: Sequence[Gate]) -> tuple[Caution, ...]:
    """Say what the reader should know although the calibration holds."""
    return tuple(Caution(code=gate.code, message=gate.text) for gate in gates if not gate.is_passed)


def _score(one: Tried, taken: Tried) -> ModelScore:
    return ModelScore(
        model=one.fit.model.name,
        family=one.fit.model.family,
        terms=len(one.fit.model.fitted),
        is_bent=one.fit.is_bent,
        rms_px=one.rms_px,
        held_out_px=one.held_out.rms_px,
        is_taken=one is taken,
    )


def _shape(kept: Kept) -> Array | None:
    """Heights of the whole board's points, less the plane through most of them."""
    fit = kept.choice.taken.fit
    if not fit.is_bent:
        return None
    view = next(view for view in kept.views if view.is_used)
    columns, rows = _board(kept.views)
    every = replace(view, ids=None).points
    u, v = kept.corners.board_axes(every)
    height = np.stack([u * u, u * v, v * v], axis=-1) @ fit.bend
    plane = np.column_stack([u, v, np.ones_like(u)])
    height = height - plane @ np.linalg.lstsq(plane, height, rcond=None)[0]
    return np.asarray(height.reshape(rows, columns))


def _with_poses(kept: Kept, square: float) -> tuple[View, ...]:
    """Complete the used views with their RMS and pose."""
    fit = kept.choice.taken.fit
    rms = view_rms(kept.corners, residuals(kept.corners, fit))
    numbers = iter(zip(rms, fit.rotation, fit.translation, strict=True))
    done = []
    for view in kept.views:
        if view.is_used:
            error, rotation, shift = next(numbers)
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, shift * square
            view = replace(view, rms_px=float(error), T_cam_board=pose)
        done.append(view)
    return tuple(done)
