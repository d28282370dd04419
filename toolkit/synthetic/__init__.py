"""Rendered truth: shots and boards made by brute force."""

from toolkit.synthetic.appearance import (
    Appearance,
    LambertBall,
    LitBall,
    PanelledBall,
    PlainBall,
    StripedBall,
    mean_colour,
    pigments,
)
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
from toolkit.synthetic.still import SharpPicture, render_sharp, true_disc
from toolkit.synthetic.truth import true_contours

__all__ = [
    "PRESETS",
    "Appearance",
    "BallPath",
    "BoardPose",
    "BouncingPath",
    "CircularPath",
    "LambertBall",
    "LitBall",
    "NoiseLevel",
    "PanelledBall",
    "ParabolicPath",
    "PlainBall",
    "RenderedBoard",
    "RenderedShot",
    "Scene",
    "SharpPicture",
    "StraightPath",
    "StripedBall",
    "add_noise",
    "benchmark_scene",
    "board_points",
    "board_poses",
    "checked_background",
    "flat_background",
    "mean_colour",
    "panelled_background",
    "pigments",
    "preset_scene",
    "render_board",
    "render_sharp",
    "render_shot",
    "textured_background",
    "true_contours",
    "true_disc",
]
