"""What each estimator makes of each kind of ball, on brute-force rendered streaks.

Conditions: the benchmark scene (ball at 50 radii R, smooth coloured texture of at most 0.1 about
grey 0.3, noise 1 % of white in each channel of shot, background and sharp picture, lens point
spread 0.7 px, one background picture). Straight streaks, 50 to 100 px wide, 3 to 6 widths long,
tilted up to 30 degrees out of the image plane. The mean colour of each ball, over its disc and the
exposure, lies at least 0.4 from every pixel of the background (norm over three channels). Lamps
stand within 50 degrees of the camera, 40 % of the light comes from the room. Patterned balls bear 2
to 6 stripes, or a football's panels, and turn 2 to 6 times within the exposure, about axes drawn at
random; balls of too little contrast are drawn anew.

Patterned balls are lemon and red: a background is measured by its distance n.B from the plane
through black and both pigments, and grey lies 0.27 (0.2 at least) from theirs. A white pigment, or
a pair such as orange and blue whose mixtures hold grey, would put the background into the plane.
Lemon and red differ in green alone, so that `uniform` errs little where they are evenly lit.

The lamp stays while the ball crosses up to 14 degrees of the view, so that its shade shifts on the
disc by as much: known shading, which holds it fixed, is tested with that error in it.

    python benchmarks/ball_kinds.py [--shots N] [--kind lambert stripes] [--seed N]

Each shot is measured with the estimators that suit its ball and, for comparison, with `uniform`
given the ball's mean colour. Known shading sees the ball in a sharp picture with noise, found and
cut out as a user would; the pigments' plane is given by the true pigments, or learnt from that
picture. What is not installed is left out with a word.

Then `auto` is let choose among all three, told all of this; how often it took which is printed.

Columns: median over the shots of the error of the axis' depth (itself the median along the axis, in
R) and of the speed at mid-exposure; bias of the half width and of the axis' depth (medians with
their signs); the share of shots whose error lies within 1.96 reported standard deviations for the
position x y z at mid-exposure and the speed; refused shots; median CPU time of `measure` on one
thread, warm, and its ratio to that of `uniform` on the same shots; results with the caution that
all profiles differ alike from the shape expected.
"""

import os

# read when the libraries are first imported, hence before them
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from toolkit import (
    AlphaEstimator,
    CalibrationError,
    Measurement,
    PluginError,
    StreakError,
    measure,
    registry,
    select_estimator,
)
from toolkit.ball_colours import learn_colours
from toolkit.ball_look import lay_out
from toolkit.disc import view_ball
from toolkit.synthetic import (
    Appearance,
    LitBall,
    PanelledBall,
    PlainBall,
    RenderedShot,
    Scene,
    SharpPicture,
    StripedBall,
    benchmark_scene,
    mean_colour,
    pigments,
    render_sharp,
    render_shot,
)

Array = NDArray[np.float64]
Generator = np.random.Generator

LEMON, RED = (0.9, 0.8, 0.03), (0.95, 0.04, 0.03)
AMBIENT, HIGHLIGHT = 0.4, 0.06
LAMP_ANGLE = math.radians(50)
TURNS, STRIPES = (2.0, 6.0), (2, 7)
CONTRAST = 0.4
STEP = 0.5
"""px between the sharp images that make a streak."""
BASELINE = "uniform"


@dataclass(frozen=True, kw_only=True)
class Method:
    """An estimator, and what it is told about the ball."""

    label: str
    estimator: str
    facts: tuple[str, ...] = ()


UNIFORM = Method(label="uniform", estimator="uniform", facts=("colour",))
UNKNOWN = Method(label="uniform, colour unknown", estimator="uniform")
SHADING = Method(label="known-shading", estimator="known-shading", facts=("ball",))
PIGMENTS = Method(label="two-colour, given", estimator="two-colour", facts=("colours",))
LEARNT = Method(label="two-colour, learnt", estimator="two-colour", facts=("plane_normal",))


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of ball, and the methods that suit it."""

    paint: Callable[[Scene, Generator], Appearance]
    methods: tuple[Method, ...]


def _lit(pattern: Appearance, generator: Generator, highlight: float = 0.0) -> LitBall:
    angle, turn = LAMP_ANGLE * math.sqrt(generator.uniform()), generator.uniform(0, math.tau)
    across = math.sin(angle)
    light = (across * math.cos(turn), across * math.sin(turn), -math.cos(angle))
    return LitBall(pattern=pattern, light=light, ambient=AMBIENT, highlight=highlight)


def _spin(scene: Scene, generator: Generator) -> tuple[float, float, float]:
    rate = math.tau * generator.uniform(*TURNS) / scene.exposure
    x, y, z = (rate * _direction(generator)).tolist()
    return (x, y, z)


def _direction(generator: Generator) -> Array:
    vector = generator.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _stripes(scene: Scene, generator: Generator) -> StripedBall:
    x, y, z = _direction(generator).tolist()
    spin = _spin(scene, generator)
    stripes = int(generator.integers(*STRIPES))
    return StripedBall(colours=(LEMON, RED), stripes=stripes, pole=(x, y, z), spin=spin)


KINDS = {
    "uniform": Kind(paint=lambda scene, _: scene.appearance, methods=(UNKNOWN,)),
    "lambert": Kind(
        paint=lambda _, generator: _lit(PlainBall(colour=LEMON), generator), methods=(SHADING,)
    ),
    "highlight": Kind(
        paint=lambda _, generator: _lit(PlainBall(colour=LEMON), generator, HIGHLIGHT),
        methods=(SHADING,),
    ),
    "stripes": Kind(paint=_stripes, methods=(PIGMENTS, LEARNT)),
    "lit stripes": Kind(
        paint=lambda scene, generator: _lit(_stripes(scene, generator), generator),
        methods=(PIGMENTS, LEARNT),
    ),
    "lit panels": Kind(
        paint=lambda scene, generator: _lit(
            PanelledBall(colours=(LEMON, RED), spin=_spin(scene, generator)), generator
        ),
        methods=(PIGMENTS, LEARNT),
    ),
}


@dataclass(frozen=True, kw_only=True)
class Score:
    """How far one measurement is from the truth, with signs."""

    depth: float  # R, median along the axis, positive too far away
    speed: float  # share
    half_width: float  # px, median over the profiles
    within: tuple[bool, ...]  # x y z speed inside 1.96 standard deviations
    warned: bool  # whether the result says that the ball looks otherwise than taken for
    seconds: float


def draw_shot(kind: Kind, distance: float, seed: int) -> RenderedShot:
    """Render the seed's shot of a kind."""
    generator = np.random.default_rng([seed, 11])
    scene = benchmark_scene(
        width_px=generator.uniform(50, 100),
        length_widths=generator.uniform(3, 6),
        distance_R=distance,
        tilt=math.radians(generator.uniform(-30, 30)),
        seed=seed,
    )
    ball = kind.paint(scene, generator)
    while _contrast(scene, ball) < CONTRAST - 1e-3:
        ball = kind.paint(scene, generator)
    return render_shot(replace(scene, appearance=ball), seed=seed, step=STEP)


def _contrast(scene: Scene, ball: Appearance) -> float:
    mean = torch.tensor(mean_colour(ball, scene.exposure))[:, None, None]
    return float((scene.background - mean).norm(dim=0).min())


def know(shot: RenderedShot, sharp: SharpPicture) -> dict[str, object]:
    """Give what is known about the ball, or why the sharp picture does not tell."""
    appearance = shot.scene.appearance
    known: dict[str, object] = {
        "colour": mean_colour(appearance, shot.scene.exposure),
        "colours": pigments(appearance),
    }
    try:
        view = view_ball(sharp.image, shot.background)
        normal = learn_colours([view]).normal
    except CalibrationError as refusal:
        return known | {"ball": refusal, "plane_normal": refusal}
    no_plane = CalibrationError("the sharp picture's colours span no plane")
    return known | {"ball": lay_out(view), "plane_normal": normal or no_plane}


def run(shot: RenderedShot, estimator: AlphaEstimator) -> Measurement:
    """Measure a rendered shot as a user would."""
    scene = shot.scene
    return measure(
        shot.image,
        shot.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=estimator,
        stage="contours",
    )


def compare(shot: RenderedShot, result: Measurement, seconds: float) -> Score:
    """Compare a measurement with the truth, on the branch of the sign nearer to it."""
    velocity = shot.velocity.numpy()
    speed = float(np.linalg.norm(velocity))
    state_std = np.sqrt(np.diag(np.array(result.state_covariance)))
    sigmas = (np.array(result.position_m) - shot.position.numpy()) / state_std[:3]
    speed_sigma = (result.speed_m_s - speed) / result.speed_std_m_s
    return Score(
        depth=depth_error(shot, result),
        speed=result.speed_m_s / speed - 1,
        half_width=half_width_error(shot, result),
        within=tuple(bool(abs(value) < 1.96) for value in (*sigmas, speed_sigma)),
        warned=any(caution.code == "profiles-misshapen" for caution in result.warnings),
        seconds=seconds,
    )


def depth_error(shot: RenderedShot, result: Measurement) -> float:
    """Give the median over the path found of its depth minus the true axis', on the same ray, R."""
    found = np.array(result.trajectory.position_m)
    rays = found / np.linalg.norm(found, axis=-1, keepdims=True)
    centre, velocity = shot.position.numpy(), shot.velocity.numpy()
    along = velocity / np.linalg.norm(velocity)
    # the point of the true line nearest each ray, and its depth along that ray
    cosine = rays @ along
    step = (cosine * (rays @ centre) - centre @ along) / (1 - cosine**2)
    depth = ((centre + step[:, None] * along) * rays).sum(-1)
    error = np.linalg.norm(found, axis=-1) - depth
    return float(np.median(error)) / shot.scene.ball_radius


def half_width_error(shot: RenderedShot, result: Measurement) -> float:
    """Give the median over the good profiles of the half width minus the true one, px."""
    good = np.array(result.profiles.flags) == 0
    centre = np.array(result.profiles.centre_px)[good]
    contours = shot.contours(2000).numpy()
    gaps = np.linalg.norm(centre[:, None, None] - contours[None], axis=-1).min(-1)
    return float(np.median(np.array(result.profiles.half_width_px)[good] - gaps.mean(-1)))


def usable(methods: tuple[Method, ...]) -> list[Method]:
    """Keep the methods whose estimators are installed; say which are not."""
    kept = []
    for method in methods:
        try:
            registry.load(method.estimator)
        except PluginError as problem:
            print(f"left out: {problem}", flush=True)
        else:
            kept.append(method)
    return kept


def score_kind(kind: Kind, distance: float, shots: int, seed: int) -> Mapping[str, list[Score]]:
    """Measure all shots of a kind by all its methods; refusals are printed, once a reason."""
    methods = usable((UNIFORM, *kind.methods))
    scores: dict[str, list[Score]] = {method.label: [] for method in methods}
    refusals: Counter[str] = Counter()
    choices: Counter[str] = Counter()
    for index in range(shots):
        own_seed = seed * 1000 + index
        shot = draw_shot(kind, distance, own_seed)
        known = know(shot, render_sharp(shot.scene, seed=own_seed))
        # the first round warms the libraries up
        for is_warm in (False, True) if index == 0 else (True,):
            for method in methods:
                score = score_method(method, shot, known)
                if is_warm and isinstance(score, Score):
                    scores[method.label].append(score)
                elif is_warm:
                    refusals[f"{method.label}: {score}"] += 1
        choices[choose(shot, known)] += 1
    chosen = ", ".join(f"{name} {count}" for name, count in choices.most_common())
    print(f"auto chose {chosen}", flush=True)
    for reason, count in refusals.items():
        print(f"refused {count} x {reason}", flush=True)
    return scores


def score_method(
    method: Method, shot: RenderedShot, known: Mapping[str, object]
) -> Score | StreakError | CalibrationError:
    """Give the score of one measurement, or why there is none."""
    given = {fact: known[fact] for fact in method.facts}
    for value in given.values():
        if isinstance(value, CalibrationError):
            return value
    estimator = registry.build(method.estimator, given=given, options={})
    start = time.process_time()
    try:
        result = run(shot, estimator)
    except StreakError as refusal:
        return refusal
    return compare(shot, result, time.process_time() - start)


def choose(shot: RenderedShot, known: Mapping[str, object]) -> str:
    """Give the estimator that `auto` takes, told all that is known about the ball."""
    estimators = [
        (method.estimator, registry.build(method.estimator, given=given, options={}))
        for method in usable((UNIFORM, SHADING, LEARNT))
        if not isinstance(known[method.facts[0]], CalibrationError)
        for given in [{fact: known[fact] for fact in method.facts}]
    ]
    try:
        return select_estimator(shot.image, shot.background, estimators, shot.scene.camera).name
    except StreakError:
        return "none"


def print_rows(name: str, scores: Mapping[str, list[Score]], shots: int) -> None:
    """Print the medians of one kind, a row for each method."""
    base = scores.get(BASELINE)
    base_time = float(np.median([s.seconds for s in base])) if base else math.nan
    for label, own in scores.items():
        if not own:
            print(f"{name:12}{label:25}{0:5}/{shots:<4} none measured", flush=True)
            continue
        depth, speed, width, seconds = (
            np.array([getattr(score, key) for score in own])
            for key in ("depth", "speed", "half_width", "seconds")
        )
        within = np.mean([score.within for score in own], axis=0)
        taken = float(np.median(seconds))
        print(
            f"{name:12}{label:25}{len(own):5}/{shots:<4}{np.median(np.abs(depth)):8.3f}"
            f"{100 * np.median(np.abs(speed)):9.2f}{np.median(width):11.3f}{np.median(depth):9.3f}"
            "    " + " ".join(f"{share:.2f}" for share in within) + f"{1000 * taken:8.0f}"
            f"{taken / base_time:7.2f}{sum(score.warned for score in own):8}",
            flush=True,
        )


HEAD = (
    "kind        estimator                measured  depth R  speed %  width px  depth R"
    "   within 1.96 sigma   CPU ms  ratio  warned\n"
    "                                                |error|  |error|      bias     bias"
    "      x    y    z speed"
)


def main() -> None:
    """Print a table of kinds and estimators."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shots", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--distance", type=float, default=50.0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(HEAD)
    for name in arguments.kind:
        scores = score_kind(KINDS[name], arguments.distance, arguments.shots, arguments.seed)
        print_rows(name, scores, arguments.shots)


if __name__ == "__main__":
    main()
