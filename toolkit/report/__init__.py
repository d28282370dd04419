"""What people look at: a result in words, and drawn on the shot."""

from toolkit.report.overlay import draw_overlay, write_overlay
from toolkit.report.summary import summarise

__all__ = ["draw_overlay", "summarise", "write_overlay"]
