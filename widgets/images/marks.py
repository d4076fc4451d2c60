"""Marks over an image: clicked points, ghosts and residual arrows, drawn at screen size whatever the zoom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import atan2, cos, hypot, sin
from typing import Any, Final

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import QObject, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QPainter, QPaintEvent, QPen, QPolygonF, QTransform
from PyQt6.QtWidgets import QWidget

from ..basics.controls import GestureClock
from ..basics.theme import ACCENT, CASING
from .image_pane import ImagePane, Rectangle

#: Distance in screen pixels within which the mouse grabs a mark.
REACH: Final = 9.0
_RADIUS = 6.5
#: Number of marks above which they are drawn small.
_CROWD, _SMALL_RADIUS = 80, 3.5
_ARROW_HEAD = 8.0
#: Residual arrows are drawn enlarged by this factor.
ARROW_FACTOR: Final = 10.0


class MarkKind(StrEnum):
    """Meaning of a mark; each has a colour that is legible on any image."""

    POINT = "point"
    STANDING_OUT = "stands out"
    OFF = "switched off"
    PENDING = "waiting for its partner"
    GHOST = "predicted"


COLORS: Final = {
    MarkKind.POINT: QColor(64, 196, 255),
    MarkKind.STANDING_OUT: QColor(255, 92, 80),
    MarkKind.OFF: QColor(176, 176, 176),
    MarkKind.PENDING: QColor(255, 214, 10),
    MarkKind.GHOST: QColor(255, 214, 10),
}
_ARROW = QColor(255, 255, 255)


@dataclass(frozen=True)
class Mark:
    """One mark at a place in image pixels; ``arrow`` is its residual in image pixels, drawn enlarged."""

    key: str
    u: float
    v: float
    label: str = ""
    kind: MarkKind = MarkKind.POINT
    selected: bool = False
    arrow: tuple[float, float] | None = None


class MarkLayer(QWidget):
    """A transparent layer over an `ImagePane` that paints marks and never takes the mouse."""

    def __init__(self, pane: ImagePane) -> None:
        viewport = pane.view.viewport()
        super().__init__(viewport)
        self._pane = pane
        self.marks: tuple[Mark, ...] = ()
        self.ghost: tuple[float, float] | None = None
        self._partner: tuple[float, float] | None = None
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        pane.viewChanged.connect(lambda _: self.update())

    def set_marks(self, marks: Sequence[Mark]) -> None:
        self.marks = tuple(marks)
        self.update()

    def set_ghost(self, place: tuple[float, float] | None) -> None:
        self.ghost = place
        self.update()

    def set_partner(self, place: tuple[float, float] | None) -> None:
        """Show the expected position of the other image's cursor."""
        if place != self._partner:
            self._partner = place
            self.update()

    def to_screen(self) -> QTransform:
        """Return the transform from image pixels to this layer's coordinates."""
        box = self._pane.box
        return QTransform(box.childTransform() * box.sceneTransform()) * QTransform(self._pane.view.viewportTransform())

    def mark_at(self, place: QPointF) -> Mark | None:
        """Return the mark nearest to a place in this layer's coordinates, within reach."""
        transform = self.to_screen()
        best, nearest = None, REACH
        for mark in self.marks:
            offset = transform.map(QPointF(mark.u, mark.v)) - place
            distance = hypot(offset.x(), offset.y())
            if distance <= nearest:
                best, nearest = mark, distance
        return best

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        transform = self.to_screen()
        if self._partner is not None:
            _cross(painter, transform.map(QPointF(*self._partner)), QColor(255, 255, 255, 200))
        for mark in self.marks:
            if mark.arrow is not None:
                end = QPointF(mark.u + ARROW_FACTOR * mark.arrow[0], mark.v + ARROW_FACTOR * mark.arrow[1])
                _arrow(painter, transform.map(QPointF(mark.u, mark.v)), transform.map(end))
        for mark in sorted(self.marks, key=lambda mark: mark.selected):
            self._paint_mark(painter, transform.map(QPointF(mark.u, mark.v)), mark)
        if self.ghost is not None:
            place = transform.map(QPointF(*self.ghost))
            _ring(painter, place, COLORS[MarkKind.GHOST], radius=10, width=2.0, style=Qt.PenStyle.DashLine)
            _text(painter, place + QPointF(13, -5), "Enter accepts", COLORS[MarkKind.GHOST])

    def _paint_mark(self, painter: QPainter, place: QPointF, mark: Mark) -> None:
        if not QRectF(self.rect()).adjusted(-60, -30, 60, 30).contains(place):
            return
        color = COLORS[mark.kind]
        style = Qt.PenStyle.DotLine if mark.kind is MarkKind.OFF else Qt.PenStyle.SolidLine
        if mark.selected:
            _ring(painter, place, QColor("white"), radius=_RADIUS + 4, width=2.0)
        if len(self.marks) >= _CROWD:
            _ring(painter, place, color, radius=_SMALL_RADIUS, width=1.4)
            return
        _ring(painter, place, color, radius=_RADIUS, width=2.0, style=style)
        painter.setPen(QPen(color, 1.5))
        painter.drawPoint(place)
        if mark.label:
            _text(painter, place + QPointF(_RADIUS + 3, -_RADIUS + 2), mark.label, color)


def _ring(
    painter: QPainter,
    place: QPointF,
    color: QColor,
    radius: float,
    width: float,
    style: Qt.PenStyle = Qt.PenStyle.SolidLine,
) -> None:
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.setPen(QPen(CASING, width + 2.0))
    painter.drawEllipse(place, radius, radius)
    painter.setPen(QPen(color, width, style))
    painter.drawEllipse(place, radius, radius)


def _cross(painter: QPainter, place: QPointF, color: QColor) -> None:
    for pen in (QPen(CASING, 3.0), QPen(color, 1.0)):
        painter.setPen(pen)
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            painter.drawLine(place + QPointF(4 * dx, 4 * dy), place + QPointF(12 * dx, 12 * dy))


def _arrow(painter: QPainter, start: QPointF, end: QPointF) -> None:
    length = hypot(end.x() - start.x(), end.y() - start.y())
    if length < 1.0:
        return
    angle = atan2(end.y() - start.y(), end.x() - start.x())
    head = min(_ARROW_HEAD, length)
    wings = [end - QPointF(head * cos(angle + turn), head * sin(angle + turn)) for turn in (0.45, -0.45)]
    for pen in (QPen(CASING, 4.0), QPen(_ARROW, 2.0)):
        painter.setPen(pen)
        painter.drawLine(start, end)
        painter.drawPolyline(QPolygonF([wings[0], end, wings[1]]))


def _text(painter: QPainter, place: QPointF, text: str, color: QColor) -> None:
    """Draw text with a dark outline, legible on any image."""
    painter.setPen(QColor(0, 0, 0, 200))
    for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        painter.drawText(place + QPointF(dx, dy), text)
    painter.setPen(color)
    painter.drawText(place, text)


_CORNERS = (((0, 0), (1, 1)), ((1, 0), (0, 1)), ((0, 1), (1, 0)), ((1, 1), (0, 0)))


class RegionItem(QObject):
    """Shows (left, top, width, height) on a pane; corners resize it, the interior moves it."""

    edited = pyqtSignal(object, int)  # rectangle, gesture

    def __init__(self, pane: ImagePane) -> None:
        super().__init__(pane)
        self._pane = pane
        self.rectangle: Rectangle | None = None
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
        if self._clock.held or rectangle == self.rectangle:
            return
        self.rectangle = rectangle
        self._show()

    def _show(self) -> None:
        self.roi.setVisible(self.rectangle is not None)
        if self.rectangle is None:
            return
        left, top, width, height = self.rectangle
        self.roi.setPos((left - 0.5, top - 0.5), update=False)
        self.roi.setSize((width, height), finish=False)

    def _changed(self, *_: Any) -> None:
        rectangle = self._rounded()
        if self._clock.held and rectangle != self.rectangle:
            self.rectangle = rectangle
            self.edited.emit(rectangle, self._clock.number())

    def _finished(self, *_: Any) -> None:
        self._clock.release()
        self._show()

    def _rounded(self) -> Rectangle:
        """Return the dragged rectangle in whole pixels, cut to the image."""
        extents = self._pane.image_rect().size().toSize()
        starts, lengths = np.array(self.roi.pos()) + 0.5, np.array(self.roi.size())
        ends = np.sort([starts, starts + lengths], axis=0)
        (left, top), (right, bottom) = np.rint(ends).astype(int).tolist()
        left, top = min(max(left, 0), extents.width() - 1), min(max(top, 0), extents.height() - 1)
        return left, top, max(1, min(right, extents.width()) - left), max(1, min(bottom, extents.height()) - top)
