import sys

import pytest

from toolkit import AlphaEstimator, ConfigError, PluginError, registry

HEAD = """
from dataclasses import dataclass
from toolkit import AlphaEstimator

class Base(AlphaEstimator):
    def observe(self, image, background, noise): ...
    def foreground(self, chord, appearance): ...
"""

GOOD = (
    HEAD
    + """
@dataclass(frozen=True, kw_only=True)
class Good(Base):
    colour: tuple[float, float, float]
    gloss: float = 0.5
    steps: int = 3
    careful: bool = False
    label: str = "x"
    weights: tuple[float, ...] = ()
    limit: float | None = 1.0
    def __post_init__(self):
        if self.steps > 100:
            raise ValueError("too many steps")
"""
)


def test_an_estimator_is_named_as_it_is_declared_or_by_its_class(declare):
    declare(GOOD, "very-good = :Good")
    estimator = registry.load("very-good")
    assert registry.name_of(estimator) == "very-good"
    assert registry.name_of(type("HalfMatte", (estimator,), {})) == "half-matte"


def make(**options: str) -> AlphaEstimator:
    return registry.build("good", given={"colour": (0.1, 0.2, 0.3), "colours": ()}, options=options)


def test_installed_lists_without_importing(declare):
    module = declare(GOOD, "good = :Good")
    (info,) = registry.installed()
    assert (info.name, info.distribution, info.version) == ("good", "shop", "1.5")
    assert info.target == f"{module}:Good"
    assert info.problem is None
    assert module not in sys.modules


def test_load_imports_only_the_named_estimator(declare):
    good = declare(GOOD, "good = :Good")
    other = declare("raise SystemExit('never import me')", "other = :Other", distribution="rival")
    assert issubclass(registry.load("good"), AlphaEstimator)
    assert good in sys.modules
    assert other not in sys.modules


def test_built_ins_are_declared_like_strangers():
    assert "uniform" in [info.name for info in registry.installed()]
    assert registry.load("uniform").__name__ == "Uniform"


def test_unknown_name_lists_the_installed_ones(declare):
    declare(GOOD, "good = :Good", "better = :Good")
    with pytest.raises(PluginError, match=r"no estimator 'best' is installed.*: better, good"):
        registry.load("best")


def test_two_owners_are_both_named_and_stop_nothing_else(declare):
    declare(GOOD, "good = :Good", "fine = :Good")
    declare(GOOD, "good = :Good", distribution="rival")
    with pytest.raises(
        PluginError, match=r"declared by (shop 1.5 and rival|rival 1.5 and shop) 1.5"
    ):
        registry.load("good")
    assert registry.load("fine")
    problems = {info.name: info.problem for info in registry.installed()}
    assert problems["fine"] is None
    assert "2 packages" in str(problems["good"])


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("import nonexistent_package_x", "cannot be imported .*No module named 'nonexistent"),
        ("raise SystemExit(3)", "cannot be imported .*SystemExit: 3"),
        ("Good = 3 +", "cannot be imported .*SyntaxError"),
        ("Best = 1", "cannot be imported .*has no attribute 'Good'"),
        ("class Good: ...", "is not a subclass"),
        ("Good = 3", "is not a subclass"),
        ("from toolkit import AlphaEstimator as Good", "is unfinished; .*foreground, observe"),
        (HEAD + "class Good(Base):\n    api_version = 99", "is written for API version 99"),
        (HEAD + "class Good(Base):\n    gloss: float = 1", "has fields but is not a dataclass"),
    ],
)
def test_broken_estimator_is_one_line(declare, source, reason):
    declare(source, "good = :Good")
    with pytest.raises(PluginError, match=rf"^estimator 'good' of shop 1.5 {reason}") as caught:
        registry.load("good")
    assert "\n" not in str(caught.value)


def test_ctrl_c_while_importing_stops_everything(declare):
    declare("raise KeyboardInterrupt", "good = :Good")
    with pytest.raises(KeyboardInterrupt):
        registry.load("good")
    with pytest.raises(KeyboardInterrupt):
        registry.tried(registry.installed()[0])


def test_what_shows_without_importing_is_listed_and_stops_nothing_else(declare):
    declare(GOOD, "good = :Good")
    declare("raise SystemExit", "auto = :Auto", distribution="greedy")
    declare("class Good(:", "wrong = :Good", distribution="sloppy")
    declare(GOOD, "lost = nowhere_to_be_found.deep:Good", "vague = :", distribution="moved")
    found = {info.name: info for info in registry.installed()}
    assert {name for name, info in found.items() if info.problem is None} == {"good"}
    assert "the name 'auto' is reserved" in found["auto"].problem
    assert "SyntaxError" in found["wrong"].problem
    assert found["lost"].place is None
    assert "no module nowhere_to_be_found.deep" in found["lost"].problem
    assert "names no class" in found["vague"].problem
    assert [found[name].owner for name in ("auto", "wrong")] == ["greedy 1.5", "sloppy 1.5"]
    assert all("\n" not in (info.problem or "") for info in found.values())
    assert registry.load("good")


def test_auto_is_explained_where_an_estimator_is_needed(declare):
    declare(GOOD, "good = :Good")
    with pytest.raises(PluginError, match="'auto' is no estimator but tries those installed: good"):
        registry.load("auto")


def test_nobody_may_claim_auto(declare):
    declare(GOOD, "auto = :Good")
    with pytest.raises(PluginError, match=r"of shop 1.5: the name 'auto' is reserved"):
        registry.load("auto")


def test_what_only_importing_shows_is_found_by_trying(declare):
    declare(GOOD, "good = :Good")
    broken = declare("raise SystemExit(3)", "broken = :Good", distribution="rival")
    good, bad = (info for info in reversed(registry.installed()))
    assert registry.tried(good) == good
    assert bad.problem is None
    assert broken not in sys.modules
    assert "of rival 1.5 cannot be imported (SystemExit: 3)" in registry.tried(bad).problem


def test_the_place_of_a_plugin_is_its_file(declare):
    module = declare(GOOD, "good = :Good", "uniform = plugins.uniform:Uniform")
    places = {info.name: info.place for info in registry.installed()}
    assert places["good"].name == f"{module}.py"
    assert places["uniform"].parts[-2:] == ("plugins", "uniform.py")


def test_an_error_names_the_estimator_and_its_owner(declare):
    declare(GOOD, "very-good = :Good")
    estimator = registry.load("very-good")
    assert registry.called(estimator) == "estimator 'very-good' of shop 1.5"
    assert registry.called(type("HalfMatte", (estimator,), {})) == "estimator 'half-matte'"


def test_a_class_variable_is_no_field(declare):
    source = HEAD + "from typing import ClassVar\nclass Good(Base):\n    x: ClassVar[int] = 1\n"
    declare(source, "good = :Good")
    assert registry.load("good").x == 1


def test_bad_name_is_refused(declare):
    declare(GOOD, "Not-Good = :Good")
    with pytest.raises(PluginError, match="name does not match"):
        registry.load("Not-Good")


def test_build_passes_only_facts_with_a_field(declare):
    declare(GOOD, "good = :Good")
    assert make().colour == (0.1, 0.2, 0.3)


@pytest.mark.parametrize(
    ("field", "text", "value"),
    [
        ("gloss", "2.5e-1", 0.25),
        ("steps", "7", 7),
        ("careful", "yes", True),
        ("careful", "false", False),
        ("label", "a=b,c", "a=b,c"),
        ("weights", "1,2.5", (1.0, 2.5)),
        ("colour", "1,0,0.5", (1.0, 0.0, 0.5)),
        ("limit", "none", None),
        ("limit", "3", 3.0),
    ],
)
def test_option_is_read_by_the_type_of_its_field(declare, field, text, value):
    declare(GOOD, "good = :Good")
    assert getattr(make(**{field: text}), field) == value


@pytest.mark.parametrize(
    ("field", "text", "reason"),
    [
        ("gloss", "shiny", "field 'gloss' of estimator 'good' is 'shiny'; a number is needed"),
        ("gloss", "nan", "a finite number is needed"),
        ("steps", "1.5", "a whole number is needed"),
        ("careful", "maybe", "true or false is needed"),
        ("colour", "1,2", "3 values with commas"),
        ("color", "1,2,3", "has no field 'color'; its fields are: colour, gloss, steps"),
    ],
)
def test_bad_option_is_a_config_error(declare, field, text, reason):
    declare(GOOD, "good = :Good")
    with pytest.raises(ConfigError, match=reason):
        make(**{field: text})


def test_missing_fact_is_named_in_the_users_words(declare):
    declare(GOOD, "good = :Good")
    with pytest.raises(ConfigError, match="good needs the ball's colour: --ball-colour R,G,B, or"):
        registry.build("good", given={}, options={})


def test_missing_other_field_is_reached_by_set(declare):
    source = HEAD + "@dataclass(frozen=True, kw_only=True)\nclass Good(Base):\n    gloss: float\n"
    declare(source, "good = :Good")
    with pytest.raises(ConfigError, match="good needs its field 'gloss': --set gloss=VALUE"):
        registry.build("good", given={}, options={})


def test_estimator_that_breaks_on_its_values(declare):
    declare(GOOD, "good = :Good")
    with pytest.raises(PluginError, match=r"does not accept its values \(ValueError: too many"):
        make(steps="101")


def test_field_type_that_cannot_be_read(declare):
    source = (
        HEAD
        + "@dataclass(frozen=True, kw_only=True)\nclass Good(Base):\n    gloss: 'Nowhere' = 1\n"
    )
    declare(source, "good = :Good")
    with pytest.raises(PluginError, match="field type that cannot be read"):
        registry.build("good", given={}, options={})


def test_a_damaged_package_is_named_and_stops_nothing_else(tmp_path, monkeypatch):
    for name, points in (
        ("damaged", "[toolkit.alpha_estimators]\nno equals sign\n"),
        ("whole", "[toolkit.alpha_estimators]\nwhole = plugins.uniform:Uniform\n"),
    ):
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = {info.distribution: info for info in registry.installed()}
    assert "its entry points cannot be read" in found["damaged"].problem
    assert found["whole"].problem is None
    assert registry.load("whole").__name__ == "Uniform"
    assert "ball-streak-toolkit" in found
