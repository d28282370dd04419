"""Rendered truth: shots and boards made by brute force."""

from toolkit.synthetic.appearance import Appearance, LambertBall, PlainBall, StripedBall
from toolkit.synthetic.backgrounds import (
    checked_background,
    flat_background,
    panelled_background,
    textured_background,
)
from toolkit.synthetic.noise import NoiseLevel, add_noise
from toolkit.synthetic.paths import (
    BallPath,
    BouncingPath,
    CircularPath,
    ParabolicPath,
    StraightPath,
)
from toolkit.synthetic.render import RenderedShot, Scene, render_shot
from toolkit.synthetic.scenes import benchmark_scene
from toolkit.synthetic.truth import true_contours

__all__ = [
    "Appearance",
    "BallPath",
    "BouncingPath",
    "CircularPath",
    "LambertBall",
    "NoiseLevel",
    "ParabolicPath",
    "PlainBall",
    "RenderedShot",
    "Scene",
    "StraightPath",
    "StripedBall",
    "add_noise",
    "benchmark_scene",
    "checked_background",
    "flat_background",
    "panelled_background",
    "render_shot",
    "textured_background",
    "true_contours",
]
