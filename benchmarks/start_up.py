"""Time from a cold start of the command line, beside that of `import torch` alone.

Conditions: each run is a new process with this Python and its own environment, threads as they
come; files are warm in the system's cache. The shot is a simulated Bayer DNG of 3000x2000 px with
its background of the same size, on the preset "straight"; `toolkit measure` reads both and
measures fully. Runs are interleaved and medians printed, with the median of each round's ratio to
`import torch`. Bytecode is written by one first run of each, which is not counted.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

COMMAND = "import sys; from toolkit.cli.main import main; sys.exit(main())"
"""What the console script `toolkit` runs."""
TORCH = "import torch"
TARGETS = {"toolkit --help": 1 / 3, "toolkit measure": 2.2}


def commands(shot: Path) -> dict[str, list[str]]:
    """Give the command lines to compare."""
    return {
        TORCH: [sys.executable, "-c", TORCH],
        "toolkit --help": [sys.executable, "-c", COMMAND, "--help"],
        "plugins list": [sys.executable, "-c", COMMAND, "plugins", "list"],
        "toolkit measure": [sys.executable, "-c", COMMAND, "measure", str(shot)],
    }


def simulate(folder: Path, size: str, seed: int) -> Path:
    """Write the shot to measure, and give its path."""
    options = ["simulate", "--size", size, "--seed", str(seed), "--out", str(folder)]
    seconds([sys.executable, "-c", COMMAND, *options], environment(folder))
    return folder / "shot.dng"


def environment(folder: Path) -> dict[str, str]:
    """Give the environment, with a place for bytecode, which an installed copy has too."""
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    root = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [root, kept.get("PYTHONPATH", "")]))
    return {**kept, "PYTHONPATH": path, "PYTHONPYCACHEPREFIX": str(folder.parent / "bytecode")}


def seconds(command: list[str], variables: dict[str, str]) -> float:
    """Run a command to its end and give the time it took."""
    start = time.perf_counter()
    subprocess.run(command, env=variables, check=True, capture_output=True)
    return time.perf_counter() - start


def race(shot: Path, rounds: int) -> dict[str, list[float]]:
    """Run all commands in turn."""
    variables = environment(shot.parent)
    lines = commands(shot)
    for line in lines.values():
        seconds(line, variables)
    times: dict[str, list[float]] = {name: [] for name in lines}
    for _ in range(rounds):
        for name, line in lines.items():
            times[name].append(seconds(line, variables))
    return times


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--size", default="3000x2000", help="WIDTHxHEIGHT of the shot, px")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        shot = simulate(Path(folder) / "shot", arguments.size, arguments.seed)
        times = race(shot, arguments.rounds)
    print(f"medians of {arguments.rounds} runs, shot and background of {arguments.size} px each")
    print(f"{'':18}{'s':>8}{'fastest':>9}{'of import torch':>17}{'target':>8}")
    for name, values in times.items():
        ratio = float(np.median(np.array(values) / np.array(times[TORCH])))
        target = f"{TARGETS[name]:8.2f}" if name in TARGETS else ""
        print(f"{name:18}{np.median(values):8.2f}{min(values):9.2f}{ratio:17.2f}{target}")


if __name__ == "__main__":
    main()
