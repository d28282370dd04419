"""What people look at: a result in words, and drawn on the shot."""

from toolkit.report.overlay import draw_disc, draw_overlay, write_disc_overlay, write_overlay
from toolkit.report.residuals import draw_residuals, write_residuals
from toolkit.report.summary import summarise

__all__ = [
    "draw_disc",
    "draw_overlay",
    "draw_residuals",
    "summarise",
    "write_disc_overlay",
    "write_overlay",
    "write_residuals",
]
