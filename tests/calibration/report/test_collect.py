import base64
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.intrinsics import calibrate_views
from calibration.report.collect import collect, write_report
from calibration.report.page import render_page
from toolkit.imaging import write_png16
from toolkit.response import Response, SampledCurve

VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Reads a page as a browser would, and notes what stands out."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.words, self.links = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.links += [value for name, value in attributes if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def calibration(make_views, tilted_poses):
    return calibrate_views(make_views(tilted_poses(12)))


@pytest.fixture
def left_out(calibration, tmp_path):
    """The same with a blurred photo that can be shown and a damaged one that cannot."""
    write_png16(tmp_path / "seen.png", np.full((3, 480, 640), 0.3))
    seen = replace(calibration.views[0], path=tmp_path / "seen.png", reason="blurred along y")
    gone = replace(calibration.views[1], path=tmp_path / "<b>x.jpg", reason="cannot be read")
    return replace(calibration, views=(*calibration.views[2:], seen, gone))


def test_errors_are_those_of_the_calibration(calibration):
    errors = collect(calibration).errors
    assert errors.shape == (12 * 54, 2)
    rms = float(np.sqrt((errors**2).sum(-1).mean()))
    assert rms == pytest.approx(calibration.rms_px, rel=1e-3)


def test_errors_do_not_depend_on_the_unit_of_the_poses(make_views, tilted_poses):
    views = make_views(tilted_poses(8))
    in_squares = collect(calibrate_views(views)).errors
    in_metres = collect(calibrate_views(views, square=0.03), square=0.03).errors
    assert in_metres == pytest.approx(in_squares, abs=1e-9)


def test_the_poses_take_up_the_plane_through_a_bent_board(make_views, tilted_poses, camera):
    """The board's shape is told less the plane through it, whatever plane the poses hold."""
    flat = calibrate_views(make_views(tilted_poses(12), noise=0.02))
    tilted = 0.01 * np.mgrid[:6, :9][1]
    bent = collect(replace(flat, board_shape=tilted)).errors
    assert np.sqrt((bent**2).sum(-1).mean()) < 1.05 * flat.rms_px


def test_the_page_is_well_formed_and_fetches_nothing(left_out):
    text = render_page(collect(left_out))
    page = Page(text)
    assert page.open == []
    assert "script" not in page.tags
    assert page.tags.count("svg") == 3
    assert [link[:5] for link in page.links] == ["data:"]
    assert text.replace("http://www.w3.org/2000/svg", "").count("http:") == 0
    assert "https:" not in text
    assert "url(" not in text
    assert "default-src &#x27;none&#x27;" in text
    assert 'name="viewport"' in text
    assert "prefers-color-scheme: dark" in text


def test_every_part_is_there(left_out):
    words = "\n".join(Page(render_page(collect(left_out))).words)
    for heading in (
        "The camera",
        "Where the board was",
        "What is left over",
        "How sure it is, over the picture",
        "Lens models compared",
        "Photos left out",
        "Photos used",
    ):
        assert heading in words
    assert "blurred along y" in words
    assert "/<b>x.jpg" in words  # as text, not as markup
    assert "cannot be shown" in words
    for gate in left_out.gates:
        assert gate.is_refusal or gate.text in words


def test_advice_and_cautions_are_told(make_views, tilted_poses):
    few = calibrate_views(make_views(tilted_poses(5)))
    words = "\n".join(Page(render_page(collect(few))).words)
    assert "What would help" in words
    assert few.advice[0].text in words
    assert "not passed" in words


def test_a_thumbnail_shows_the_photo_and_its_corners(left_out):
    shown, gone = collect(left_out).left_out
    assert gone.thumbnail is None
    code = base64.b64decode(shown.thumbnail.partition(",")[2])
    picture = cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_COLOR).astype(int)
    assert picture.shape == (180, 240, 3)
    assert (picture[..., 2] - picture[..., 1]).max() > 60  # the corners' red


def test_response_curves_are_drawn_where_there_are_any(calibration):
    brightness = np.linspace(0, 1, 9)
    curve = SampledCurve(brightness=brightness, exposure=brightness**2, std=0.01 * brightness)
    measured = Response(name="mine", curves=(curve, curve, curve))
    channels = collect(calibration, response=measured).curves
    assert [name for name, *_ in channels] == ["r", "g", "b"]
    assert channels[0][3].max() == pytest.approx(0.01)
    assert "The response" in render_page(collect(calibration, response=measured))
    assert collect(calibration, response=Response(name="linear")).curves == []


def test_a_report_is_written_whole(calibration, tmp_path):
    write_report(tmp_path / "r.html", calibration)
    assert (tmp_path / "r.html").read_text(encoding="utf-8").endswith("</html>\n")
    assert [path.name for path in Path(tmp_path).iterdir()] == ["r.html"]
