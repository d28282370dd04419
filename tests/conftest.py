import importlib
import itertools
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest

_numbers = itertools.count()

Declare = Callable[..., str]


@pytest.fixture
def declare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Declare:
    """Install throw-away distributions in a folder of their own; the real ones are hidden.

    Call it with the source of a module and its entry points, "name = :attribute"; it gives the
    module's name.
    """
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def only_ours(**wanted: str) -> metadata.EntryPoints:
        found = metadata.distributions(path=[str(site)])
        points = [point for dist in found for point in dist.entry_points]
        return metadata.EntryPoints(points).select(**wanted)

    monkeypatch.setattr(metadata, "entry_points", only_ours)

    def declare(
        source: str,
        *points: str,
        group: str = "toolkit.alpha_estimators",
        distribution: str = "shop",
    ) -> str:
        module = f"throwaway_{next(_numbers)}"
        (site / f"{module}.py").write_text(source)
        info = site / f"{distribution}-1.5.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.5\n"
        )
        lines = [point.replace("= :", f"= {module}:") for point in points]
        (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines]) + "\n")
        importlib.invalidate_caches()
        return module

    return declare
