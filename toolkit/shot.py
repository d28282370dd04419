"""From files and what the user knows to a measurement: all inputs of a shot, gathered and checked.

What the caller says beats the rig, and the rig beats what the picture's file tells.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from toolkit.alpha import AlphaEstimator
from toolkit.camera import Camera
from toolkit.camera_file import fit_camera, read_camera
from toolkit.candidates import AUTO, Candidates, make_candidates, what_is_needed
from toolkit.errors import ConfigError, ImageError, StreakError
from toolkit.files import sha256
from toolkit.imaging import read_background, read_image
from toolkit.known_ball import know_ball
from toolkit.measurement import Candidate, Caution, InputFile, Inputs, Measurement
from toolkit.pipeline import STAGES, measure
from toolkit.rig import Colour, Rig, read_rig
from toolkit.selection import Selection, select_estimator
from toolkit.shot_checks import Roi, check_numbers, check_readout, check_roi, check_size
from toolkit.types import LinearImage

DEFAULT_ESTIMATOR = "uniform"
DEFAULT_STAGE = "sweep"
RIG_NAME, CAMERA_NAME = "rig.toml", "camera.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotInputs:
    """All that one measurement needs, read and checked."""

    image: LinearImage
    background: LinearImage
    camera: Camera  # of the picture as read
    ball_radius: float  # metre
    ball_radius_std: float  # metre
    exposure: float | None  # second
    exposure_std: float  # second
    readout: float  # second from the first row's start to the last row's; 0: all rows at once
    stage: str  # at which to stop
    estimator_name: str  # or "auto", which tries all candidates
    candidates: Candidates
    roi: Roi | None  # left, top, width, height px
    inputs: Inputs
    files: tuple[Path, ...]  # all that was read: no result may replace one of them
    provenance: Mapping[str, str]  # "measured" where somebody or the file says so, else "assumed"
    read_time: float  # second it took to read the files

    @property
    def estimator(self) -> AlphaEstimator | None:
        """The estimator named; None where it is to be chosen."""
        return None if self.estimator_name == AUTO else self.candidates.ready[0][1]


def load_shot(
    shot: str | Path,
    *,
    rig: str | Path | None = None,
    camera: str | Path | None = None,
    background: Sequence[str | Path] = (),
    ball_radius: float | None = None,
    ball_radius_std: float | None = None,
    exposure: float | None = None,
    readout: float | None = None,
    response: str | Path | None = None,
    estimator: str | None = None,
    options: Mapping[str, str] | None = None,
    ball_colours: Sequence[Colour] = (),
    ball: str | Path | None = None,
    ball_image: str | Path | None = None,
    roi: Roi | None = None,
    frame: int | None = None,
    stage: str = DEFAULT_STAGE,
) -> ShotInputs:
    """Read a shot and everything that is needed to measure it.

    A rig.toml in the shot's folder is used by itself, and so is a camera.toml where neither the
    caller nor the rig names a camera.

    Args:
        shot: the picture, or a video together with `frame`.
        rig: a rig.toml.
        camera: a camera.toml.
        background: pictures of the same scene without the ball.
        ball_radius: metre.
        ball_radius_std: its standard deviation, metre; else that of the ball.toml the radius is
            from; 0 when nobody says.
        exposure: second; else the rig's, else that of the file.
        readout: second from the start of the first row's exposure to that of the last row's; 0, all
            rows at once, when nobody says.
        response: "linear", "srgb", the name of a curve, or a response.toml.
        estimator: name of the estimator; "uniform" when nobody says.
        options: text by field name of the estimator, as `--set` writes it.
        ball_colours: linear R,G,B of the ball, sensor white = 1, one for each pigment.
        ball: a ball.toml; colours and radius given otherwise beat those it holds.
        ball_image: a sharp picture of the ball in the same light, over the same background.
        roi: left, top, width, height of the part that holds the streak, px.
        frame: which picture of a video.
        stage: the last one of the measurement, of `pipeline.STAGES`.

    Raises:
        ConfigError: naming everything that is missing, or a value that is impossible.
        PluginError: when the estimator is unknown or broken.
        ImageError: when a picture cannot be read.
        CalibrationError: when the sharp picture shows no disc that can be used.
        MismatchError: when shot, background and camera do not belong together.
    """
    said = Rig(
        camera=None if camera is None else Path(camera),
        response=response,
        ball_radius=ball_radius,
        ball_radius_std=ball_radius_std,
        ball_colours=tuple(ball_colours),
        ball=None if ball is None else Path(ball),
        ball_image=None if ball_image is None else Path(ball_image),
        exposure=exposure,
        readout=readout,
        background=tuple(Path(path) for path in background),
        estimator=estimator,
        options=options or {},
    )
    _check_stage(stage)
    shot = Path(shot)
    if shot.is_dir() or not shot.exists():
        trouble = "is a folder" if shot.is_dir() else "does not exist"
        raise ImageError(f"{shot} {trouble}; give the path of a picture or video")
    rig_file = _find_rig(shot, None if rig is None else Path(rig))
    settings = said if rig_file is None else said.over(read_rig(rig_file))
    return _read_shot(_plan(shot, rig_file, settings), roi, frame, stage)


def measure_shot(shot: ShotInputs) -> Measurement:
    """Measure a shot that `load_shot` has read.

    Raises:
        StreakError: when no trustworthy measurement is possible; the text says why.
    """
    start = time.perf_counter()
    name, estimator = shot.candidates.ready[0]
    tried: tuple[Candidate, ...] = ()
    if shot.estimator_name == AUTO:
        chosen = _select(shot)
        name, estimator = chosen.name, chosen.estimator
        tried = (*chosen.candidates, *shot.candidates.unsuited)
    selected = time.perf_counter()
    measurement = measure(
        shot.image,
        shot.background,
        camera=shot.camera,
        ball_radius=shot.ball_radius,
        ball_radius_std=shot.ball_radius_std,
        exposure=shot.exposure,
        exposure_std=shot.exposure_std,
        estimator=estimator,
        roi=shot.roi,
        stage=shot.stage,
        readout=shot.readout,
    )
    seconds = {"read": shot.read_time, "measure": time.perf_counter() - selected}
    if tried:
        seconds["select"] = selected - start
    return replace(
        measurement,
        inputs=shot.inputs,
        estimator=name,
        candidates=tried,
        provenance={**measurement.provenance, **shot.provenance},
        warnings=(*_cautions(shot), *_choice(tried), *measurement.warnings),
        timing_s={**measurement.timing_s, **seconds},
    )


def refuse_shot(shot: ShotInputs, reason: str) -> Measurement:
    """Give the result of a shot that cannot be measured."""
    return replace(
        Measurement.refused(reason),
        inputs=shot.inputs,
        estimator=shot.estimator_name,
        provenance=shot.provenance,
        warnings=_cautions(shot),
        timing_s={"read": shot.read_time},
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """What to read, once nothing is missing any more."""

    shot: Path
    rig: Path | None
    camera: Path
    ball_radius: float
    ball_radius_std: float | None
    estimator_name: str
    candidates: Candidates
    settings: Rig

    @property
    def files(self) -> tuple[Path, ...]:
        """All that is read."""
        response = self.settings.response
        curve = None if response is None else Path(response)
        own = (self.shot, self.rig, self.camera, curve if curve and curve.is_file() else None)
        named = (path for path in own if path is not None)
        return (*named, *self.settings.background, *self.candidates.files)


def _check_stage(stage: str) -> None:
    if stage not in STAGES:
        raise ConfigError(f"stage '{stage}' is unknown; use one of {', '.join(STAGES)}")


def _find_rig(shot: Path, rig: Path | None) -> Path | None:
    beside = shot.parent / RIG_NAME
    return rig or (beside if beside.is_file() else None)


def _plan(shot: Path, rig: Path | None, settings: Rig) -> _Plan:
    """Check what is known before any picture is read; everything missing is named at once.

    Only then a sharp picture of the ball is looked at, where the estimator has a field for it.
    """
    beside = shot.parent / CAMERA_NAME
    camera = settings.camera or (beside if beside.is_file() else None)
    ball = know_ball(settings)
    radius = ball.radius
    name = settings.estimator or DEFAULT_ESTIMATOR
    needed = what_is_needed(name, ball, settings.options)
    missing = [
        *([] if camera else [f"a camera: --camera F, or {CAMERA_NAME} beside the shot"]),
        *([] if settings.background else ["a picture without the ball: --background F"]),
        *(["the ball's radius: --radius METRES"] if radius is None else []),
        *needed,
    ]
    if camera is None or radius is None or missing:
        raise ConfigError(f"{shot} cannot be measured without {'; and '.join(missing)}")
    check_numbers(radius, settings)
    return _Plan(
        shot=shot,
        rig=rig,
        camera=camera,
        ball_radius=float(radius),
        ball_radius_std=ball.radius_std,
        estimator_name=name,
        candidates=make_candidates(name, ball, settings.options),
        settings=settings,
    )


def _read_shot(plan: _Plan, roi: Roi | None, frame: int | None, stage: str) -> ShotInputs:
    start = time.perf_counter()
    settings = plan.settings
    camera = read_camera(plan.camera)
    image = read_image(plan.shot, response=settings.response, frame=frame)
    background = read_background(settings.background, response=settings.response)
    check_size(plan.shot, image, settings.background[0], background)
    check_roi(roi, image)
    exposure, readout = _exposure(settings, image), float(settings.readout or 0.0)
    check_readout(readout, exposure)
    return ShotInputs(
        image=image,
        background=background,
        camera=fit_camera(camera, image),
        ball_radius=plan.ball_radius,
        ball_radius_std=float(plan.ball_radius_std or 0.0),
        exposure=exposure,
        exposure_std=float(settings.exposure_std or 0.0),
        readout=readout,
        stage=stage,
        estimator_name=plan.estimator_name,
        candidates=plan.candidates,
        roi=roi,
        inputs=Inputs(
            shot=_fingerprint(plan.shot),
            background=tuple(_fingerprint(path) for path in settings.background),
            camera=_fingerprint(plan.camera),
            ball=tuple(_fingerprint(path) for path in plan.candidates.files),
        ),
        files=plan.files,
        provenance=_provenance(plan, image),
        read_time=time.perf_counter() - start,
    )


def _exposure(settings: Rig, image: LinearImage) -> float | None:
    if settings.exposure is not None:
        return float(settings.exposure)
    return None if image.exposure is None else float(image.exposure[0])


def _provenance(plan: _Plan, image: LinearImage) -> dict[str, str]:
    settings = plan.settings
    sources = {
        "camera": True,
        "response": not image.response_is_assumed,
        "ball_radius": True,
        "ball_radius_std": plan.ball_radius_std is not None,
    }
    if _exposure(settings, image) is not None:
        sources |= {
            "exposure": True,
            "exposure_std": settings.exposure_std is not None,
            "readout": settings.readout is not None,
        }
    return {key: "measured" if known else "assumed" for key, known in sources.items()}


def _cautions(shot: ShotInputs) -> tuple[Caution, ...]:
    if not shot.image.response_is_assumed:
        return ()
    text = (
        f"the response '{shot.image.response}' is only assumed, and a wrong one shifts the result; "
        "use RAW, or name it with --response"
    )
    return (Caution(code="response_assumed", message=text),)


def _select(shot: ShotInputs) -> Selection:
    """Choose the estimator; where none will do, say also what the others would have needed."""
    try:
        return select_estimator(
            shot.image, shot.background, shot.candidates.ready, shot.camera, shot.roi
        )
    except StreakError as error:
        others = "; ".join(f"{c.estimator} {c.reason}" for c in shot.candidates.unsuited)
        raise StreakError(f"{error}; not tried: {others}" if others else str(error)) from None


def _choice(tried: tuple[Candidate, ...]) -> tuple[Caution, ...]:
    """Say which estimator was chosen, and how the others did."""
    if not tried:
        return ()
    best, *others = tried
    rest = "; ".join(
        f"{other.estimator}: {other.reason}"
        if other.score is None
        else f"{other.estimator} {other.score:.2f}"
        for other in others
    )
    text = (
        f"estimator '{best.estimator}' was chosen: it misses pixels it was not shown by "
        f"{best.score or 0:.2f} times their noise variance; the others: {rest or 'none'}"
    )
    return (Caution(code="estimator-chosen", message=text),)


def _fingerprint(path: Path) -> InputFile:
    return InputFile(path=str(path), sha256=sha256(path))
