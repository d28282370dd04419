import pytest

from calibration.report.markup import Markup, join, picture, table, tag


def test_text_is_escaped_and_markup_is_not():
    text = tag("p", "<script>", tag("b", 'a & "b"'), Markup("<i>x</i>"))
    assert text == "<p>&lt;script&gt;<b>a &amp; &quot;b&quot;</b><i>x</i></p>"


def test_attributes_are_escaped_and_named_as_html_names_them():
    text = tag("rect", fill_opacity=0.25, class_='a"b', x=1 / 3, y=None)
    assert text == '<rect fill-opacity="0.25" class="a&quot;b" x="0.33333"/>'


@pytest.mark.parametrize("text", ["a\x00b", "a\x1b[31mb", "a\udcffb"])
def test_what_html_does_not_allow_is_replaced(text):
    assert set(tag("p", text)) & {"\x00", "\x1b", "\udcff"} == set()
    assert "?" in tag("p", text)


def test_an_empty_element_that_is_not_void_is_closed():
    assert tag("td", "") == "<td></td>"
    assert tag("br") == "<br/>"


def test_tables_scroll_by_themselves():
    text = table(("a", "b"), [("1", "<2>")])
    assert text.startswith('<div class="wide"><table><thead>')
    assert "<td>&lt;2&gt;</td>" in text


def test_a_drawing_says_what_it_shows():
    text = picture(640.0, 480.0, "dots & lines", tag("circle", r=1))
    assert 'viewBox="0 0 640 480"' in text
    assert "<title>dots &amp; lines</title>" in text
    assert join(["a", "b"], ", ") == "a, b"
