import pytest

from calibration.wizard.quantities import parse_length, parse_radius, parse_time
from toolkit.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("0.036", 0.036),
        ("0,036", 0.036),
        (" 36 mm ", 0.036),
        ("36MM", 0.036),
        ("3,6 cm", 0.036),
        ("0.036m", 0.036),
        ("1.5 in", 0.0381),
        (".036", 0.036),
    ],
)
def test_a_radius_is_read_as_people_write_it(text, metres):
    assert parse_radius(text) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize("text", ["36", "3,6", "1e3"])
def test_a_radius_without_its_unit_is_recognised(text):
    with pytest.raises(ConfigError, match=f"write the unit, as in '{text} mm'"):
        parse_radius(text)


@pytest.mark.parametrize("text", ["0", "0,0001", "2 m"])
def test_no_ball_is_that_small_or_large(text):
    with pytest.raises(ConfigError, match="half its diameter"):
        parse_radius(text)


@pytest.mark.parametrize("text", ["", "abc", "-3", "1,234.5", "1 234", "36 km", "nan", "inf", "1e"])
def test_other_texts_are_no_length(text):
    with pytest.raises(ConfigError, match="is not a length such as"):
        parse_length(text)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("1/500", 0.002), ("1/500 s", 0.002), ("2 ms", 0.002), ("0,002", 0.002), ("0", 0.0)],
)
def test_times_are_read_as_cameras_show_them(text, seconds):
    assert parse_time(text) == pytest.approx(seconds, rel=1e-12)


def test_impossible_times_are_refused():
    with pytest.raises(ConfigError, match="divides by zero"):
        parse_time("1/0")
    with pytest.raises(ConfigError, match="too large"):
        parse_time("1e999")
    with pytest.raises(ConfigError, match="is not a time"):
        parse_time("36 mm")
