"""Errors a caller can act on, each carrying the exit code of its kind.

The text of an error is one line: what happened, where or with which value, and what to do about it.
"""

from typing import ClassVar


class ToolkitError(Exception):
    """Base of every error this toolkit raises on purpose."""

    exit_code: ClassVar[int] = 70


class ConfigError(ToolkitError):
    """A usage mistake or a bad configuration: missing input, unknown key, impossible value."""

    exit_code = 2


class PluginError(ToolkitError):
    """An estimator that is unknown, claimed twice or broken."""

    exit_code = 2


class BadOutputError(PluginError):
    """An estimator that broke, or gave what cannot be, while it was used."""

    exit_code = 5


class ImageError(ToolkitError):
    """A file that cannot be read as a picture, or is of an unsupported kind."""

    exit_code = 3


class MismatchError(ToolkitError):
    """Inputs that are each fine but do not fit together: camera and image, background and shot."""

    exit_code = 4


class StreakError(ToolkitError):
    """No trustworthy measurement is possible on this shot; the text says why."""

    exit_code = 5


class CalibrationError(ToolkitError):
    """No trustworthy calibration is possible from these pictures; the text says why."""

    exit_code = 5


class EnvironmentFault(ToolkitError):
    """The machine refused: disk full, folder read-only, file locked."""

    exit_code = 7


class ShapeError(ToolkitError):
    """Arrays whose shapes disagree: a bug of the calling code."""

    exit_code = 70
