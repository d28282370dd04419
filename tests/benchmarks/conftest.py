import sys
from pathlib import Path

# scripts import one another by name, as Python lets a script do
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
