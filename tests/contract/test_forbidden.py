import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib", "yaml"}
CALLS = {"eval", "exec", "torch.load", "yaml.load", "os.system", "os.popen", "numpy.load"}
KEYWORDS = {"shell", "allow_pickle"}


def offences(source: str | bytes) -> Iterator[str]:
    """Name everything in a source file that could run code out of a data file."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.partition(".")[0] in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module:
            if node.module.partition(".")[0] in MODULES:
                yield node.module
            yield from (call for a in node.names if (call := f"{node.module}.{a.name}") in CALLS)
        elif isinstance(node, ast.Call):
            if (name := ast.unparse(node.func).replace("np.", "numpy.")) in CALLS:
                yield name
            yield from (
                f"{keyword.arg}="
                for keyword in node.keywords
                if keyword.arg in KEYWORDS and ast.unparse(keyword.value) != "False"
            )


FOLDERS = ("toolkit", "calibration", "plugins", "examples", "benchmarks")


def test_nothing_can_run_code_out_of_a_file():
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    assert files
    found = [
        f"{path.relative_to(ROOT)}: {o}" for path in files for o in offences(path.read_bytes())
    ]
    assert found == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "from torch import load",
        "import torch\nstate = torch.load('x')",
        "eval('1')",
        "np.load('x', allow_pickle=True)",
        "subprocess.run('ls', shell=True)",
        "import yaml",
    ],
)
def test_the_check_sees_each_offence(source):
    assert list(offences(source))


def test_the_check_lets_harmless_code_pass():
    assert list(offences("import json\nmodel.eval()\nsubprocess.run(['ls'], shell=False)")) == []
