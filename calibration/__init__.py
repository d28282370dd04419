"""Calibrate what a measurement needs to know beforehand: the camera.

The public names are loaded when first used, so that `import calibration` stays light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.board import Board as Board
    from calibration.board import BoardRequest as BoardRequest
    from calibration.board_page import write_board as write_board
    from calibration.corners import BoardSearch as BoardSearch
    from calibration.corners import View as View
    from calibration.corners import find_boards as find_boards
    from calibration.corners import search_boards as search_boards
    from calibration.formats.convert import export_camera as export_camera
    from calibration.formats.convert import import_camera as import_camera
    from calibration.intrinsics import Calibration as Calibration
    from calibration.intrinsics import calibrate as calibrate
    from calibration.intrinsics import calibrate_views as calibrate_views
    from calibration.intrinsics import write_calibration as write_calibration
    from calibration.noise_model import MeasuredNoise as MeasuredNoise
    from calibration.noise_model import measure_noise as measure_noise
    from calibration.response_curve import MeasuredResponse as MeasuredResponse
    from calibration.response_curve import measure_response as measure_response

_HOME = {
    "Board": "calibration.board",
    "BoardRequest": "calibration.board",
    "BoardSearch": "calibration.corners",
    "Calibration": "calibration.intrinsics",
    "MeasuredNoise": "calibration.noise_model",
    "MeasuredResponse": "calibration.response_curve",
    "View": "calibration.corners",
    "calibrate": "calibration.intrinsics",
    "calibrate_views": "calibration.intrinsics",
    "export_camera": "calibration.formats.convert",
    "find_boards": "calibration.corners",
    "search_boards": "calibration.corners",
    "write_board": "calibration.board_page",
    "write_calibration": "calibration.intrinsics",
    "import_camera": "calibration.formats.convert",
    "measure_noise": "calibration.noise_model",
    "measure_response": "calibration.response_curve",
}


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'calibration' has no attribute '{name}'")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
