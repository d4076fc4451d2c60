"""The region of interest as a rectangle with handles, over one image."""

from __future__ import annotations

from typing import Any

import pyqtgraph as pg
from PyQt6.QtCore import QObject, pyqtSignal

from ..basics.theme import ACCENT
from ..parameters.gestures import GestureClock
from .image_pane import ImagePane, Rectangle

_CORNERS = (((0, 0), (1, 1)), ((1, 0), (0, 1)), ((0, 1), (1, 0)), ((1, 1), (0, 0)))


class RegionItem(QObject):
    """Shows (left, top, width, height) on a pane; corners resize it, the middle moves it.

    Signals
    -------
    edited(rectangle: tuple, gesture: int)
    """

    edited = pyqtSignal(object, int)

    def __init__(self, pane: ImagePane) -> None:
        super().__init__(pane)
        self._pane = pane
        self._rectangle: Rectangle | None = None
        self._showing = False
        self._clock = GestureClock()
        pen = pg.mkPen(ACCENT, width=2)
        lit = pg.mkPen("w", width=2)
        self.roi = pg.ROI(
            (0, 0), (1, 1), movable=False, rotatable=False, resizable=False, pen=pen, handlePen=pen, handleHoverPen=lit
        )
        for corner, opposite in _CORNERS:
            self.roi.addScaleHandle(corner, opposite)
        self.roi.addTranslateHandle((0.5, 0.5))
        self.roi.setZValue(10)
        self.roi.hide()
        pane.box.addItem(self.roi, ignoreBounds=True)
        self.roi.sigRegionChangeStarted.connect(self._clock.hold)
        self.roi.sigRegionChanged.connect(self._changed)
        self.roi.sigRegionChangeFinished.connect(self._finished)

    def set_rectangle(self, rectangle: Rectangle | None) -> None:
        """Show a rectangle, or none; never emits. The one being dragged is left alone."""
        if self._clock.held or rectangle == self._rectangle:
            return
        self._rectangle = rectangle
        self._show()

    def _show(self) -> None:
        self.roi.setVisible(self._rectangle is not None)
        if self._rectangle is None:
            return
        left, top, width, height = self._rectangle
        self._showing = True
        self.roi.setPos((left - 0.5, top - 0.5), update=False)
        self.roi.setSize((width, height))
        self._showing = False

    def _changed(self, *_: Any) -> None:
        if self._showing or not self._clock.held:
            return
        rectangle = self._rounded()
        if rectangle != self._rectangle:
            self._rectangle = rectangle
            self.edited.emit(rectangle, self._clock.number())

    def _finished(self, *_: Any) -> None:
        if not self._showing:
            self._clock.release()
            self._show()

    def _rounded(self) -> Rectangle:
        """Return the dragged rectangle in whole pixels, cut to the image."""
        limit = self._pane.image_rect()
        position, size = self.roi.pos(), self.roi.size()
        ends = []
        for start, length, extent in (
            (position.x(), size.x(), int(limit.width())),
            (position.y(), size.y(), int(limit.height())),
        ):
            low, high = sorted((start + 0.5, start + length + 0.5))
            first = min(max(round(low), 0), extent - 1)
            ends.append((first, max(1, min(round(high), extent) - first)))
        (left, width), (top, height) = ends
        return left, top, width, height
