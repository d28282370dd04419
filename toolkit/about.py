"""Which version of the toolkit is running."""

from importlib.metadata import PackageNotFoundError, version

DISTRIBUTION = "ball-streak-toolkit"


def installed_version() -> str:
    """Give the version of the installed distribution, "unknown" when run from loose files."""
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return "unknown"
