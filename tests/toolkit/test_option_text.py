import pytest

from toolkit import ConfigError
from toolkit.option_text import can_be_text, format_option, parse_option


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (0.1, float),
        (1e-300, float),
        (7, int),
        (True, bool),
        (False, bool),
        ("a=b,c", str),
        (None, float | None),
        (2.5, float | None),
        ((0.1, 0.2, 0.3), tuple[float, float, float]),
        ((1.0, 2.0), tuple[float, ...]),
        (("x", 3), tuple[str, int]),
    ],
)
def test_a_value_survives_being_text(value, kind):
    assert can_be_text(kind)
    assert parse_option(format_option(value), kind, "it") == value


@pytest.mark.parametrize("kind", [list[float], dict, tuple[tuple[float, ...], ...], int | str])
def test_other_kinds_are_set_from_python(kind):
    assert not can_be_text(kind)


def test_another_value_cannot_be_written():
    with pytest.raises(ConfigError, match="a list cannot be written as text"):
        format_option([1])
