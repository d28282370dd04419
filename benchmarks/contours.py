"""Accuracy of the two contours on brute-force rendered streaks, beside those of OpenCV's Canny.

Conditions: the benchmark scene with the ball at 50 radii, |F - B| >= 0.4, noise 1 % of white in
each channel of shot and background, lens point spread 0.7 px, ball colour given; streaks 40, 60,
80 and 120 px wide, 3 to 7 widths long, of any heading, tilted up to 30 degrees, the curved ones
with a sagitta of 0.4 to 1 width. Errors are distances in px from the true contour, square to it;
signed ones are positive outside. Where the ball's first and last images lie no method is judged.

Canny is favoured: it sees the difference of shot and noise-free background along the line from
background to ball colour, without rounding to 8 bits, and its thresholds are the ones, of a grid,
that find most of the true contours (the highest of these, against clutter). Of several edge pixels
across the contour the one nearest to the truth counts. Source of the claim: Caglioti & Giusti
2007, section 5.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plugins.uniform import Uniform
from toolkit import StreakError
from toolkit.contours import smooth_contours
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import RenderedShot, benchmark_scene, render_shot
from toolkit.view import StreakView, observe_streak

Array = NDArray[np.float64]

WIDTHS = (40, 60, 80, 120)
SIGMAS = (3, 5, 10)
CONTOUR_SAMPLES = 3000
NEAR = 0.35
"""Widths from the true contour within which an edge pixel of Canny is taken for it."""
THRESHOLDS = (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""Upper threshold of Canny, shares of the steepest gradient; the lower one is 0.4 times as high."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """One true contour, without what the ball's first and last images touch."""

    points: Array  # [N, 2] px
    outward: Array  # [N, 2] unit
    length: Array  # [N] px from its beginning
    width: float  # px


@dataclass(frozen=True, kw_only=True)
class Score:
    """How one method did on one shot."""

    method: str
    absolute: float  # px, mean |error|
    signed: float  # px, mean error, positive outside
    found: float  # share of the contour with a measured point


def score_shot(shot: RenderedShot, width: float) -> Iterator[Score]:
    """Score profiles, splines and Canny at all scales on one shot."""
    sides = true_sides(shot, width, margin=0.0)
    view, estimator = observe(shot)
    contours, fit = smooth_contours(fit_streak(view, estimator)[0])
    edges = fit.edges[0][fit.good[0]].numpy()
    yield summarise("profile", edges[:, 0], edges[:, 1], sides)
    yield summarise("spline", contours.points[0].numpy(), contours.points[1].numpy(), sides)
    plane = contrast_plane(shot)
    for sigma in SIGMAS:
        yield score_canny(plane, sigma, true_sides(shot, width, margin=3.0 * sigma))


def observe(shot: RenderedShot) -> tuple[StreakView, Uniform]:
    """Find the streak in the shot; the ball's colour is known."""
    estimator = Uniform(colour=shot.scene.appearance.colour)
    return observe_streak(shot.image, shot.background, estimator), estimator


def true_sides(shot: RenderedShot, width: float, margin: float) -> tuple[Truth, Truth]:
    """Give the left and right true contours, clear of the ball's ends by `margin` px."""
    left, right = shot.contours(CONTOUR_SAMPLES).numpy()
    return _side(left, left - right, width, margin), _side(right, right - left, width, margin)


def _side(points: Array, across: Array, width: float, margin: float) -> Truth:
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    outward = normal * np.sign((normal * across).sum(1, keepdims=True))
    length = np.r_[0.0, np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()]
    clear = width / 2 + margin
    kept = (length > clear) & (length < length[-1] - clear)
    return Truth(points=points[kept], outward=outward[kept], length=length[kept], width=width)


def outward_error(points: Array, truth: Truth) -> tuple[Array, Array]:
    """Give by how many px points [P, 2] lie outside a contour, and where along it."""
    _, nearest = cKDTree(truth.points).query(points, distance_upper_bound=truth.width)
    points, nearest = points[nearest < len(truth.points)], nearest[nearest < len(truth.points)]
    error = ((points - truth.points[nearest]) * truth.outward[nearest]).sum(1)
    inner = (nearest > 0) & (nearest < len(truth.points) - 1)
    return error[inner], truth.length[nearest[inner]]


def summarise(method: str, left: Array, right: Array, sides: tuple[Truth, Truth]) -> Score:
    """Score two measured sides, whichever way the axis ran."""
    orders = [(sides[0], sides[1]), (sides[1], sides[0])]
    errors = [
        np.concatenate([outward_error(p, s)[0] for p, s in zip((left, right), order, strict=True)])
        for order in orders
    ]
    best = min(errors, key=lambda error: np.abs(error).mean())
    return Score(
        method=method, absolute=float(np.abs(best).mean()), signed=float(best.mean()), found=1.0
    )


def contrast_plane(shot: RenderedShot) -> NDArray[np.float32]:
    """Give the shot minus its background along the line from background to ball colour, [H, W]."""
    ball = np.array(shot.scene.appearance.colour)
    direction = ball - shot.clean_background.mean((1, 2)).numpy()
    direction /= np.linalg.norm(direction)
    difference = (shot.image.rgb[0] - shot.clean_background).numpy()
    plane = np.tensordot(direction, difference, axes=1)
    return np.asarray(plane, dtype=np.float32)


def score_canny(plane: NDArray[np.float32], sigma: float, sides: tuple[Truth, Truth]) -> Score:
    """Score Canny with the thresholds that find most of the contours."""
    gradients = scaled_gradients(plane, sigma)
    tried = [_judge(canny_points(gradients, share), sides) for share in THRESHOLDS]
    most = max(found for _, found in tried)
    errors, found = [(error, found) for error, found in tried if found >= 0.95 * most][-1]
    return Score(
        method=f"Canny {sigma}",
        absolute=float(np.abs(errors).mean()),
        signed=float(errors.mean()),
        found=float(found),
    )


def scaled_gradients(
    plane: NDArray[np.float32], sigma: float
) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Give the gradients of the smoothed plane, the steepest 20000 long."""
    smooth = cv2.GaussianBlur(plane, (0, 0), sigma)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    scale = 20000 / float(np.hypot(dx, dy).max())
    return np.rint(dx * scale).astype(np.int16), np.rint(dy * scale).astype(np.int16)


def canny_points(gradients: tuple[NDArray[np.int16], NDArray[np.int16]], share: float) -> Array:
    """Give the edge pixels of Canny [P, 2]."""
    upper = share * 20000
    edges = cv2.Canny(*gradients, 0.4 * upper, upper, L2gradient=True)
    rows, columns = np.nonzero(edges)
    return np.stack([columns, rows], axis=1).astype(np.float64)


def _judge(points: Array, sides: tuple[Truth, Truth]) -> tuple[Array, float]:
    """Give the smallest error in each px of both contours, and the share of px with one."""
    errors, px = [], 0.0
    for truth in sides:
        error, length = outward_error(points, truth)
        near = np.abs(error) < NEAR * truth.width
        errors.append(_nearest_per_px(error[near], length[near]))
        px += truth.length[-1] - truth.length[0]
    joined = np.concatenate(errors)
    return joined, len(joined) / px


def _nearest_per_px(error: Array, length: Array) -> Array:
    """Keep the smallest error in each px along the contour."""
    order = np.abs(error).argsort(kind="stable")
    _, first = np.unique(np.floor(length[order]), return_index=True)
    return error[order][first]


def draw_shot(kind: str, width: float, seed: int) -> RenderedShot:
    """Render the seed's shot of a kind and width."""
    generator = np.random.default_rng([seed, 31])
    scene = benchmark_scene(
        width_px=width,
        length_widths=generator.uniform(4 if kind == "curved" else 3, 7),
        tilt=math.radians(generator.uniform(-30, 30)),
        sagitta_widths=generator.uniform(0.4, 1.0) if kind == "curved" else 0.0,
        seed=seed,
    )
    return render_shot(scene, seed=seed)


def print_rows(kind: str, width: float, seeds: range) -> None:
    """Print one row a method, averaged over the seeds' shots."""
    scores: dict[str, list[Score]] = {}
    for seed in seeds:
        try:
            for score in score_shot(draw_shot(kind, width, seed), width):
                scores.setdefault(score.method, []).append(score)
        except StreakError as error:
            print(f"{kind} {width} px, seed {seed} refused: {error}")
    for method, found in scores.items():
        absolute = np.array([score.absolute for score in found])
        signed = np.array([score.signed for score in found])
        share = np.mean([score.found for score in found])
        print(
            f"{kind:9}{width:5}{len(found):7}  {method:9}{absolute.mean():8.3f}"
            f"{absolute.max():8.3f}{signed.mean():+9.3f}{100 * share:8.0f}",
            flush=True,
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=6, help="of each kind and width")
    parser.add_argument("--seed", type=int, default=1, help="the first one")
    parser.add_argument("--width", type=int, nargs="+", default=list(WIDTHS), help="px")
    parser.add_argument("--kind", nargs="+", default=["straight", "curved"])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print("px from the true contour: mean over shots of the mean |error|, worst shot, mean signed")
    print("(+ outside); found: share of the contour with an edge pixel, %")
    print("kind     width  shots  method      |error|   worst   signed   found")
    for kind in arguments.kind:
        for width in arguments.width:
            print_rows(kind, width, range(arguments.seed, arguments.seed + arguments.shots))


if __name__ == "__main__":
    main()
