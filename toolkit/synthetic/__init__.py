"""Rendered truth: shots and boards made by brute force."""

from toolkit.synthetic.appearance import Appearance, LambertBall, PlainBall, StripedBall
from toolkit.synthetic.backgrounds import (
    checked_background,
    flat_background,
    panelled_background,
    textured_background,
)
from toolkit.synthetic.boards import (
    BoardPose,
    RenderedBoard,
    board_points,
    board_poses,
    render_board,
)
from toolkit.synthetic.noise import NoiseLevel, add_noise
from toolkit.synthetic.paths import (
    BallPath,
    BouncingPath,
    CircularPath,
    ParabolicPath,
    StraightPath,
)
from toolkit.synthetic.presets import PRESETS, preset_scene
from toolkit.synthetic.render import RenderedShot, Scene, render_shot
from toolkit.synthetic.scenes import benchmark_scene
from toolkit.synthetic.truth import true_contours

__all__ = [
    "PRESETS",
    "Appearance",
    "BallPath",
    "BoardPose",
    "BouncingPath",
    "CircularPath",
    "LambertBall",
    "NoiseLevel",
    "ParabolicPath",
    "PlainBall",
    "RenderedBoard",
    "RenderedShot",
    "Scene",
    "StraightPath",
    "StripedBall",
    "add_noise",
    "benchmark_scene",
    "board_points",
    "board_poses",
    "checked_background",
    "flat_background",
    "panelled_background",
    "preset_scene",
    "render_board",
    "render_shot",
    "textured_background",
    "true_contours",
]
