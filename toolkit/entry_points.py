"""What installed packages declare, also where one of them is damaged."""

from importlib import metadata
from importlib.metadata import EntryPoint


def declared(group: str) -> list[EntryPoint]:
    """List the entry points of a group; a package whose list cannot be read is left out."""
    try:
        return list(metadata.entry_points(group=group))
    except Exception:  # one damaged file among the packages stops the reading of all
        return [point for point in _one_by_one()[0] if point.group == group]


def unreadable() -> list[str]:
    """Name the packages whose entry points cannot be read."""
    try:
        metadata.entry_points()
    except Exception:  # whatever a damaged file leads to
        return _one_by_one()[1]
    return []


def owner(point: EntryPoint) -> str:
    """Name the distribution that declares an entry point, and its version."""
    name, version = owner_parts(point)
    return f"{name} {version}"


def owner_parts(point: EntryPoint) -> tuple[str, str]:
    """Give the distribution's name and version, "unknown" where it does not say."""
    name = point.dist.name if point.dist else None
    version = point.dist.version if point.dist else None
    return name or "unknown", version or "unknown"


def _one_by_one() -> tuple[list[EntryPoint], list[str]]:
    """Read every distribution by itself: entry points, and names of those that fail."""
    found: dict[str, list[EntryPoint]] = {}
    broken = []
    for number, distribution in enumerate(metadata.distributions()):
        name = str(distribution.metadata["Name"] or f"unknown {number}")
        if name in found or name in broken:
            continue  # the first on the path is the one that is imported
        try:
            found[name] = list(distribution.entry_points)
        except Exception:  # whatever a damaged file leads to
            broken.append(name)
    return [point for points in found.values() for point in points], broken
