import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from toolkit.errors import ConfigError
from toolkit.toml_text import to_toml

plain = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(exclude_categories=["Cs"])),
)


@given(
    st.dictionaries(
        st.from_regex(r"\A[a-z_]{1,9}\Z"), plain | st.lists(st.lists(plain)) | st.lists(plain)
    )
)
def test_every_value_comes_back(table):
    table.pop("schema", None)
    read = tomllib.loads(to_toml("thing", table))
    assert read.pop("schema") == "toolkit.thing/1"
    assert read == table
    assert [type(value) for value in read.values()] == [type(value) for value in table.values()]


def test_a_name_that_is_no_text_still_gives_a_valid_file():
    assert tomllib.loads(to_toml("thing", {"name": "a\udc80\x7fb"}))["name"] == "a?\x7fb"


def test_sections_and_several_of_one_name_come_back():
    table = {"one": {"a": 1}, "b": 2, "many": [{"c": [1, 2]}, {"c": []}], "none": []}
    read = tomllib.loads(to_toml("thing", table))
    assert read.pop("schema") == "toolkit.thing/1"
    assert read == table


@pytest.mark.parametrize("value", [float("nan"), float("inf"), [1.0, [float("-inf")]]])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(ConfigError, match=r"'gain' holds .*only finite numbers"):
        to_toml("thing", {"gain": value})


def test_a_table_within_becomes_a_section_after_the_plain_keys():
    text = to_toml("rig", {"ball": {"radius_m": 0.05, "colours": [[1, 0, 0]]}, "note": "x"})
    assert tomllib.loads(text) == {
        "schema": "toolkit.rig/1",
        "note": "x",
        "ball": {"radius_m": 0.05, "colours": [[1, 0, 0]]},
    }
