"""Measure a ball from one motion-blurred picture: position, direction, speed and path.

Each comes with its uncertainty. The public names are listed here and loaded when first used, so
that `import toolkit` stays light.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "AlphaEstimator": "toolkit.alpha",
    "BadOutputError": "toolkit.errors",
    "Camera": "toolkit.camera",
    "Chord": "toolkit.alpha",
    "CalibrationError": "toolkit.errors",
    "ConfigError": "toolkit.errors",
    "Disc": "toolkit.ball",
    "EnvironmentFault": "toolkit.errors",
    "ImageError": "toolkit.errors",
    "LinearImage": "toolkit.types",
    "Measurement": "toolkit.measurement",
    "MismatchError": "toolkit.errors",
    "NoiseModel": "toolkit.types",
    "Observation": "toolkit.alpha",
    "PluginError": "toolkit.errors",
    "ProfileFlag": "toolkit.types",
    "ShapeError": "toolkit.errors",
    "SharpBall": "toolkit.ball",
    "ShotInputs": "toolkit.shot",
    "StreakError": "toolkit.errors",
    "ToolkitError": "toolkit.errors",
    "draw_overlay": "toolkit.report",
    "load_shot": "toolkit.shot",
    "measure": "toolkit.pipeline",
    "measure_shot": "toolkit.shot",
    "observe_colours": "toolkit.alpha",
    "read_background": "toolkit.imaging",
    "read_camera": "toolkit.camera_file",
    "read_image": "toolkit.imaging",
    "select_estimator": "toolkit.selection",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'toolkit' has no attribute '{name}'")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
