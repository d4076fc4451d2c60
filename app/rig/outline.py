"""A rectangle over an image that shows where something is measured; it cannot be dragged."""

from __future__ import annotations

import pyqtgraph as pg

from ...widgets.basics.theme import ACCENT
from ...widgets.images.image_pane import ImagePane, Rectangle


class Outline:
    """Shows (left, top, width, height) on a pane."""

    def __init__(self, pane: ImagePane) -> None:
        self._curve = pg.PlotCurveItem(pen=pg.mkPen(ACCENT, width=2))
        self._curve.setZValue(10)
        pane.box.addItem(self._curve, ignoreBounds=True)

    def set_rectangle(self, rectangle: Rectangle) -> None:
        """Show a rectangle of whole pixels."""
        left, top, width, height = rectangle
        near, far = left - 0.5, left + width - 0.5
        upper, lower = top - 0.5, top + height - 0.5
        self._curve.setData([near, far, far, near, near], [upper, upper, lower, lower, upper])
