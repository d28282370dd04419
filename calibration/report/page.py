"""The report's page: one HTML file that holds all it shows."""

from calibration.report.content import Content, LeftOut
from calibration.report.drawings import (
    draw_coverage,
    draw_curves,
    draw_residuals,
    draw_uncertainty,
)
from calibration.report.markup import Markup, join, table, tag
from calibration.report.style import STYLE

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What a browser may fetch for the page: nothing."""


def render_page(content: Content) -> str:
    """Write the page.

    Args:
        content: what it shows.

    Returns:
        HTML without scripts and without addresses of anything outside.
    """
    body = tag(
        "main",
        tag("h1", "Calibration report"),
        *_verdict(content),
        *_summary(content),
        *_coverage(content),
        *_residuals(content),
        *_uncertainty(content),
        *_models(content),
        *_curves(content),
        *_left_out(content),
        *_used(content),
    )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", "Calibration report"),
        tag("style", Markup(STYLE)),
    )
    return "<!DOCTYPE html>\n" + tag("html", head, tag("body", body), lang="en") + "\n"


def _verdict(content: Content) -> list[Markup]:
    failed = sum(not verdict.is_passed for verdict in content.verdicts)
    headline = "Every gate is passed." if not failed else f"{failed} gates are not passed."
    headline = "One gate is not passed." if failed == 1 else headline
    lines = [
        tag("li", _mark(v.is_passed), " ", v.text)
        for v in sorted(content.verdicts, key=lambda v: v.is_passed)
    ]
    lines += [tag("li", _mark(False), " ", caution) for caution in content.cautions]
    told = [tag("p", tag("strong", headline, class_="bad" if failed else "good"))]
    if lines:
        told.append(tag("ul", *lines))
    if content.advice:
        told.append(tag("h2", "What would help"))
        told.append(tag("ul", *(tag("li", text) for text in content.advice)))
    return told


def _mark(is_good: bool) -> Markup:
    """Say in a word whether it is well: colour alone would not reach everybody."""
    return tag("strong", "ok" if is_good else "look", class_="good" if is_good else "bad")


def _summary(content: Content) -> list[Markup]:
    rows = [tag("tr", tag("th", name, scope="row"), tag("td", v)) for name, v in content.summary]
    return [
        tag("h2", "The camera"),
        tag("div", tag("table", tag("tbody", *rows)), class_="wide"),
        _soft("Uncertainties are one standard deviation."),
    ]


def _coverage(content: Content) -> list[Markup]:
    empty = int((content.counts == 0).sum())
    told = "Every part of the picture has been seen."
    if empty:
        told = f"{empty} of {content.counts.size} parts show no corner: the lens is guessed there."
    return [
        tag("h2", "Where the board was"),
        tag("p", told),
        draw_coverage(content.picture_size, content.corners, content.counts),
        _soft("Each dot is a corner of the board; numbers count them in each part."),
    ]


def _residuals(content: Content) -> list[Markup]:
    if not len(content.places):
        return []
    drawing, longer = draw_residuals(content.picture_size, content.places, content.errors)
    return [
        tag("h2", "What is left over"),
        drawing,
        _soft(
            f"From where the camera predicts a corner to where it was found, {longer:.0f} times"
            " longer than it is. Thick: the mean of a part of the picture. Errors that point every"
            " way are noise; thick arrows that follow each other show a lens that is not described"
            " well, a bent board, or blur."
        ),
    ]


def _uncertainty(content: Content) -> list[Markup]:
    return [
        tag("h2", "How sure it is, over the picture"),
        draw_uncertainty(content.picture_size, content.uncertainty),
        _soft(
            "Pixels by which a far point of the scene may be seen elsewhere than the camera says,"
            " one standard deviation; a turn of the whole camera is taken out."
        ),
    ]


def _models(content: Content) -> list[Markup]:
    if not content.models:
        return []
    rows = [
        (
            row.name,
            row.board,
            str(row.terms),
            f"{row.held_out_px:.3f}",
            tag("strong", "taken", class_="good") if row.is_taken else "",
        )
        for row in content.models
    ]
    return [
        tag("h2", "Lens models compared"),
        table(("model", "board", "terms", "error of views left out, px", ""), rows),
        _soft("The simplest one is taken that predicts views it was not shown as well as any."),
    ]


def _curves(content: Content) -> list[Markup]:
    if not content.curves:
        return []
    return [
        tag("h2", "The response"),
        draw_curves(content.curves),
        _soft("Light for each brightness stored; the band is two standard deviations wide."),
    ]


def _left_out(content: Content) -> list[Markup]:
    if not content.left_out:
        return []
    figures = [_figure(photo) for photo in content.left_out]
    return [tag("h2", "Photos left out"), tag("div", *figures, class_="photos")]


def _figure(photo: LeftOut) -> Markup:
    shown = tag("div", "cannot be shown", class_="blank")
    if photo.thumbnail is not None:
        shown = tag("img", src=photo.thumbnail, alt=photo.name)
    return tag("figure", shown, tag("figcaption", tag("strong", photo.name), ": ", photo.reason))


def _used(content: Content) -> list[Markup]:
    rows = [(row.name, str(row.corners), f"{row.rms_px:.2f}") for row in content.used]
    return [tag("h2", "Photos used"), table(("photo", "corners", "RMS, px"), rows)]


def _soft(text: str) -> Markup:
    return tag("p", join([text]), class_="soft")
