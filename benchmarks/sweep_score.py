"""How far measurements of rendered shots are from the truth, in many processes, and summed up."""

import json
import math
import multiprocessing
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from toolkit import AlphaEstimator, LinearImage, Measurement, ToolkitError, measure
from toolkit.synthetic import RenderedShot

Array = NDArray[np.float64]
Row = dict[str, Any]
"""One shot as plain numbers; "refused" is None where it was measured."""
Task = TypeVar("Task")
Result = TypeVar("Result")

AXES = ("x", "y", "z", "speed")
COVERED = 1.96
"""Standard deviations of an interval that should hold 95 % of the truths."""
WIDE = 0.1
"""Share of the speed beyond which its bound puts a shot in a group of its own."""
SURE = 0.95
"""Probability from which a sign counts as decided."""
WORST = 8
"""Shots named for their large errors."""


def score(
    shot: RenderedShot,
    estimator: AlphaEstimator,
    *,
    image: LinearImage | None = None,
    background: LinearImage | None = None,
    **options: Any,
) -> Row:
    """Measure a shot, or another picture of it, and compare the result with the truth.

    Args:
        shot: with the truth.
        estimator: of the ball's opacity.
        image: instead of the shot's own.
        background: instead of the shot's own.
        options: of `measure`.
    """
    scene = shot.scene
    since = time.perf_counter()
    try:
        result = measure(
            shot.image if image is None else image,
            shot.background if background is None else background,
            camera=scene.camera,
            ball_radius=scene.ball_radius,
            exposure=scene.exposure,
            estimator=estimator,
            readout=scene.readout,
            **options,
        )
    except ToolkitError as refusal:
        return {"refused": str(refusal)}
    except Exception as fault:  # counted as what it is, so that the other shots are still seen
        return {"refused": f"CRASH {type(fault).__name__}: {fault}"}
    seconds = time.perf_counter() - since
    return compare(shot, result) | {"seconds": seconds}


def compare(shot: RenderedShot, result: Measurement) -> Row:
    """Compare a measurement with the truth, on the branch of the sign nearest to it."""
    truth = shot.position_at(result.time_s).numpy(), shot.velocity_at(result.time_s).numpy()
    found = np.array(result.velocity_m_s)
    sign = 1.0 if found @ truth[1] >= 0 else -1.0
    speed = float(np.linalg.norm(truth[1]))
    error = np.concatenate([np.array(result.position_m) - truth[0], sign * found - truth[1]])
    bound = result.bound
    row: Row = {
        "refused": None,
        "stage": result.stage,
        "cautions": [caution.code for caution in result.warnings],
        "true_speed": speed,
        "error": [*error[:3].tolist(), result.speed_m_s - speed],
        "std": [*result.position_std_m, result.speed_std_m_s],
        "bound": None if bound is None else [*bound.position_std_m, bound.speed_std_m_s],
        "upper": result.speed_upper_m_s,
        "is_true_sign": sign > 0,
        "sign_probability": result.sign.probability,
        "chi2_per_dof": result.fit.chi2_per_dof,
        "nees": None,
    }
    if result.state_covariance is not None and result.speed_std_m_s is not None:
        turn = np.array([1.0, 1, 1, sign, sign, sign])
        covariance = turn[:, None] * np.array(result.state_covariance) * turn
        row["nees"] = float(error @ np.linalg.solve(covariance, error))
    return row


def in_processes(
    work: Callable[[Task], Result], tasks: Iterable[Task], workers: int
) -> Iterator[Result]:
    """Do the tasks in their order, each on one thread, in `workers` processes."""
    if workers <= 1:
        single_threaded()
        yield from map(work, tasks)
        return
    with multiprocessing.get_context("spawn").Pool(workers, single_threaded) as pool:
        yield from pool.imap(work, tasks)


def single_threaded() -> None:
    """Let this process use one thread."""
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)


def save_rows(path: Path, rows: list[Row]) -> None:
    """Write the rows as JSON, one a line."""
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def load_rows(path: Path) -> list[Row]:
    """Read what `save_rows` wrote."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def column(rows: list[Row], name: str) -> Array:
    """Give one entry of all rows as numbers; NaN for what is not known."""
    values = [row[name] for row in rows]
    width = max((len(value) for value in values if isinstance(value, list)), default=0)
    empty = [None] * width if width else None
    return np.array([empty if value is None else value for value in values], dtype=np.float64)


def is_wide(row: Row) -> bool:
    """Say whether the speed of a shot cannot be known to a tenth of it."""
    limit = (row["bound"] or row["std"])[3]
    return limit is None or not limit <= WIDE * row["true_speed"]


def is_still(row: Row) -> bool:
    """Say whether only an upper limit was given for the speed."""
    return row["std"][3] is None


def summary(rows: list[Row]) -> str:
    """Sum up rows in a table."""
    measured = [row for row in rows if row["refused"] is None]
    known = [row for row in measured if not is_wide(row)]
    wide = [row for row in measured if is_wide(row)]
    parts = [
        f"{len(rows)} shots: {len(measured)} measured, of which {len(known)} with a speed that can "
        f"be known to {100 * WIDE:.0f} %",
        *_table(known),
        *_wide(wide),
        *_signs(measured),
        *_counts("refused", Counter(gist(r["refused"]) for r in rows if r["refused"])),
        *_counts("caution", Counter(code for row in measured for code in row["cautions"])),
        *_worst(measured),
    ]
    if measured:
        seconds = column(measured, "seconds")
        parts.append(
            f"seconds a measurement: median {np.median(seconds):.2f}, most {seconds.max():.2f}"
        )
    return "\n".join(parts)


def over_bound(rows: list[Row]) -> Array:
    """Give the errors over their bounds [N, 4]; NaN where there is none."""
    return column(rows, "error") / column(rows, "bound")


def rms(values: Array) -> Array:
    """Root of the mean of the squares over the rows that are known."""
    return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))


def _table(rows: list[Row]) -> list[str]:
    if not rows:
        return []
    error, std = column(rows, "error"), column(rows, "std")
    nees = column(rows, "nees")
    nees = nees[np.isfinite(nees)]
    sigmas = error / std
    has_bound = any(row["bound"] for row in rows)
    lines = {
        "rms error / bound": rms(over_bound(rows)) if has_bound else None,
        "rms error / stated sigma": rms(sigmas),
        "median |error| / sigma (0.67)": np.nanmedian(np.abs(sigmas), axis=0),
        "bias, stated sigmas": np.nanmean(sigmas, axis=0),
        "share within 95 % interval": (np.abs(sigmas) < COVERED).mean(axis=0),
        "median stated sigma / bound": np.nanmedian(std / column(rows, "bound"), axis=0)
        if has_bound
        else None,
    }
    count = len(rows)
    return [
        f"{'':32}" + "".join(f"{axis:>9}" for axis in AXES),
        *(f"{name:32}" + _cells(values) for name, values in lines.items()),
        f"mean NEES of six {nees.mean():.2f} +- {math.sqrt(12 / max(1, len(nees))):.2f} "
        f"(median {np.median(nees):.2f}, 5.35 expected); bias is known to "
        f"{1 / math.sqrt(count):.2f}, a share of 0.95 to {math.sqrt(0.0475 / count):.3f}",
        f"efficiency (bound / rms error), all four: {1 / rms(over_bound(rows)).max():.2f}; "
        f"{sum(not row['bound'] for row in rows)} without a bound"
        if has_bound
        else "no bound in these results",
    ]


def _cells(values: Array | None) -> str:
    if values is None:
        return f"{'-':>9}" * len(AXES)
    return "".join(f"{value:9.3f}" for value in values)


def _wide(rows: list[Row]) -> list[str]:
    if not rows:
        return []
    inside = np.abs(column(rows, "error")) < COVERED * column(rows, "std")
    still = [row for row in rows if is_still(row)]
    inside[:, 3] |= [is_still(r) and r["true_speed"] <= (r["upper"] or 0) for r in rows]
    return [
        f"{len(rows)} with a speed that cannot be known so well, {len(still)} of them with an "
        "upper limit alone",
        f"{'share within 95 % interval':32}" + _cells(inside.mean(axis=0)),
    ]


def _signs(rows: list[Row]) -> list[str]:
    """What is said of the motion's sign, where anything is."""
    told = [row for row in rows if row["sign_probability"] != 0.5]
    if not told:
        return []
    chance = np.array([row["sign_probability"] for row in told])
    is_true = np.array([row["is_true_sign"] for row in told])
    given = np.where(is_true, chance, 1 - chance)
    sure = chance > SURE
    return [
        f"sign: odds told for {len(told)} shots; more than {SURE} for {sure.sum()}, of which "
        f"{(is_true & sure).sum()} right; mean probability given to the true one {given.mean():.3f}"
    ]


def gist(reason: str) -> str:
    """A reason without its numbers, so that equal ones can be counted."""
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", reason)[:150]


def _counts(name: str, counter: Counter[str]) -> list[str]:
    return [f"{name:9}{count:5} x {text}" for text, count in counter.most_common()]


def _worst(rows: list[Row]) -> list[str]:
    """The seeds with the largest error of any kind, in bounds or else in stated sigmas."""
    if not rows:
        return []
    stated = column(rows, "std")
    bound = column(rows, "bound") if any(row["bound"] for row in rows) else stated
    scale = np.where(np.isfinite(bound), bound, stated)
    errors = np.nan_to_num(np.abs(column(rows, "error") / scale)).max(axis=1)
    order = np.argsort(-errors)[:WORST]
    named = ", ".join(f"{rows[i]['seed']} ({errors[i]:.1f})" for i in order)
    return [f"largest error, in bounds (else sigmas), of seeds: {named}"]
