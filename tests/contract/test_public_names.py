import ast
from importlib import import_module
from pathlib import Path

import pytest

import toolkit

NAMES = """
AlphaEstimator BadOutputError CalibrationError Camera Chord ConfigError Disc EnvironmentFault
ImageError LinearImage Measurement MismatchError NoiseModel Observation PluginError ProfileFlag
ShapeError SharpBall ShotInputs StreakError ToolkitError draw_overlay load_shot measure measure_shot
observe_colours read_background read_camera read_image select_estimator
""".split()


def test_the_public_names_are_these():
    assert sorted(toolkit.__all__) == sorted(NAMES)


def test_the_stub_names_the_same():
    stub = Path(toolkit.__file__).with_suffix(".pyi").read_text()
    named = {
        (alias.asname, node.module)
        for node in ast.parse(stub).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert named == set(toolkit._HOME.items())


@pytest.mark.parametrize("name", NAMES)
def test_each_can_be_loaded_and_is_documented(name):
    first = getattr(toolkit, name)
    assert getattr(toolkit, name) is first  # a submodule of that name would replace it
    assert first.__doc__
    assert name in dir(toolkit)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = toolkit.nonsense


def test_no_submodule_bears_a_public_name():
    folder = Path(toolkit.__file__).parent
    modules = {path.stem for path in folder.glob("*.py")} | {
        path.parent.name for path in folder.glob("*/__init__.py")
    }
    assert modules & set(NAMES) == set()


def test_errors_have_the_documented_codes():
    codes = {
        "ConfigError": 2,
        "PluginError": 2,
        "BadOutputError": 5,
        "ImageError": 3,
        "MismatchError": 4,
        "StreakError": 5,
        "CalibrationError": 5,
        "EnvironmentFault": 7,
        "ShapeError": 70,
    }
    errors = import_module("toolkit.errors")
    assert {name: getattr(errors, name).exit_code for name in codes} == codes
    assert all(issubclass(getattr(errors, name), errors.ToolkitError) for name in codes)
