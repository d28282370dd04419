import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.formats.foreign import yaml_list
from calibration.formats.plain_yaml import parse_yaml
from toolkit.errors import ConfigError

DOCUMENT = """%YAML 1.1
---
# a comment
name: it's a "camera"  # and another
quoted: 'it''s # no comment: at all'
empty:
words: [~, null, True, false, .inf, 1.2.3, "a, b"]
numbers: [1, -2.5, 1e-05, .5, +3, 2.,
          7]
matrix:
- [1, 2]
- - 3
  - 4
below:
  deeper:
    - a: 1
      b: {c: [2, 3], d: {}}
    -
      - 5
after: a:b
...
"""


def test_every_kind_of_value_is_read():
    assert parse_yaml(DOCUMENT) == {
        "name": 'it\'s a "camera"',
        "quoted": "it's # no comment: at all",
        "empty": None,
        "words": [None, None, True, False, math.inf, "1.2.3", "a, b"],
        "numbers": [1, -2.5, 1e-05, 0.5, 3, 2.0, 7],
        "matrix": [[1, 2], [3, 4]],
        "below": {"deeper": [{"a": 1, "b": {"c": [2, 3], "d": {}}}, [5]]},
        "after": "a:b",
    }
    assert parse_yaml("# nothing\n") is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: !!python/object/apply:os.system [ls]", "line 1 .* begins a value with '!'"),
        ("a: &b 1", "begins a value with '&'"),
        ("a: *b", r"begins a value with '\*'"),
        ("a: |\n  text", r"begins a value with '\|'"),
        ("a: 1\na: 2", "line 2 .* a second time"),
        ("a: {b: 1, b: 2}", "a key twice"),
        ("a: 1\n  b: 2", "line 2 .* otherwise"),
        ("a: 1\nb", "line 2 .* has no 'key: value'"),
        ("a: [1, 2", "never closed"),
        ("a: [1, 2}", "do not match|never closed"),
        ("a: [1] 2", "goes on after its value"),
        ("a: 'open\n  end'", "line 1 opens a quote"),
        ("a:\n\tb: 1", "line 2 is indented by a tab"),
        ("a: " + "[" * 30 + "]" * 30, "nested more than 20 deep"),
        ("\n".join(" " * i + f"k{i}:" for i in range(30)), "nested more than 20 deep"),
    ],
)
def test_what_is_not_read_is_refused_by_line(text, reason):
    with pytest.raises(ConfigError, match=reason) as caught:
        parse_yaml(text)
    assert "\n" not in str(caught.value)


@given(st.text(st.sampled_from(" \n:-[]{}#'\"ab01.,&!|"), max_size=60))
def test_any_text_is_read_or_refused(text):
    try:
        parse_yaml(text)
    except ConfigError as error:
        assert "\n" not in str(error)  # noqa: PT017  (both ways are right)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False)))
def test_written_numbers_come_back_to_the_last_bit(values):
    assert parse_yaml(f"a: {yaml_list(values)}") == {"a": values}
