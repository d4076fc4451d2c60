"""A 3D view for looking closely: points under the mouse, a distance, and requests to enlarge and for a menu."""

from __future__ import annotations

from math import dist

from PyQt6.QtCore import QEvent, QPointF, QRectF, Qt, QTimer, pyqtSignal
from PyQt6.QtGui import QColor, QMouseEvent, QPainter, QPen
from PyQt6.QtWidgets import QWidget

from ...core.errors import minus
from ..basics.theme import CASING
from .cloud_view import CLICK_PX, CloudView, Place

#: Milliseconds between searches for the point under the moving mouse.
_HOVER_MS = 30
_RADIUS, _END = 6.0, 2.5
_LINE, _PLATE = QColor(255, 255, 255), QColor(0, 0, 0, 190)


class InspectView(CloudView):
    """A `CloudView` that shows a mark and a measured distance and reports what a person does with its points."""

    HELP = """<p><b>Drag</b> to orbit, <b>Shift + drag</b> or middle button to pan, <b>wheel</b> to zoom,
    <b>double click</b> to enlarge, <b>Shift + click</b> on two points to measure their distance.</p>
    <p>Keys: <b>arrows</b> orbit, <b>+ −</b> zoom, <b>R</b> reset, <b>V</b> front, <b>T</b> top, <b>S</b> side,
    <b>Z</b> zoom to the patch.</p>"""
    FOLLOWS_MOUSE = True

    pointHovered = pyqtSignal(object)  # Flat pixel and place of the point under the mouse, or None
    endChosen = pyqtSignal(object)  # Place of a point that was clicked with Shift: an end of a distance
    enlargeRequested = pyqtSignal()

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(title, parent)
        self._mark: Place | None = None
        self._ends: tuple[Place, ...] = ()
        self._pressed: QPointF | None = None
        self._mouse = QPointF()
        self._hover = QTimer(self)
        self._hover.setSingleShot(True)
        self._hover.setInterval(_HOVER_MS)
        self._hover.timeout.connect(self._point)  # no lambda: Qt would call it after Python has cleared a closed view
        self._scene.ornament = self._paint_ornament

    def set_mark(self, mark: Place | None) -> None:
        """Mark a place of the view's frame, metres, or none."""
        if mark != self._mark:
            self._mark = mark
            self._canvas.update()

    def mark(self) -> Place | None:
        return self._mark

    def set_ends(self, ends: tuple[Place, ...]) -> None:
        """Show no, one or both ends of a distance, and with both the distance."""
        if ends != self._ends:
            self._ends = ends
            self._canvas.update()

    def ends(self) -> tuple[Place, ...]:
        return self._ends

    # Events

    def mousePressEvent(self, event: QMouseEvent | None) -> None:
        self._pressed = None if event is None else event.position()
        super().mousePressEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent | None) -> None:
        super().mouseMoveEvent(event)
        if event is not None and event.buttons() == Qt.MouseButton.NoButton:
            self._mouse = self._canvas.mapFrom(self, event.position())
            if not self._hover.isActive():
                self._hover.start()

    def mouseReleaseEvent(self, event: QMouseEvent | None) -> None:
        super().mouseReleaseEvent(event)
        if event is None or self._pressed is None or event.button() != Qt.MouseButton.LeftButton:
            return
        still = (event.position() - self._pressed).manhattanLength() <= CLICK_PX
        self._pressed = None
        if still and event.modifiers() & Qt.KeyboardModifier.ShiftModifier:
            found = self.pick(self._canvas.mapFrom(self, event.position()))
            if found is not None:
                self.endChosen.emit(found[1])

    def _point(self) -> None:
        self.pointHovered.emit(self.pick(self._mouse))

    def leaveEvent(self, event: QEvent | None) -> None:
        super().leaveEvent(event)
        self._hover.stop()
        self.pointHovered.emit(None)

    def mouseDoubleClickEvent(self, event: QMouseEvent | None) -> None:
        if event is not None and event.button() == Qt.MouseButton.LeftButton:
            self.enlargeRequested.emit()

    # Painting

    def _paint_ornament(self, painter: QPainter, canvas: QWidget) -> None:
        if self._mark is not None:
            painter.setBrush(Qt.BrushStyle.NoBrush)
            for place in self._on_screen([self._mark]):
                for color, width in ((CASING, 4.0), (_LINE, 2.0)):
                    painter.setPen(QPen(color, width))
                    painter.drawEllipse(place, _RADIUS, _RADIUS)
        if self._ends:
            self._paint_distance(painter, self._on_screen(list(self._ends)))

    def _on_screen(self, places: list[Place]) -> list[QPointF]:
        """Return where places are seen; empty unless all are before the eye."""
        seen = self.camera().project(places, *self._size())
        return [QPointF(float(u), float(v)) for u, v, _ in seen] if (seen[:, 2] > 0).all() else []

    def _paint_distance(self, painter: QPainter, at: list[QPointF]) -> None:
        for color, width in ((CASING, 4.0), (_LINE, 2.0)):
            painter.setPen(QPen(color, width))
            painter.setBrush(color)
            if len(at) == 2:
                painter.drawLine(*at)
            for place in at:
                painter.drawEllipse(place, _END, _END)
        if len(at) < 2:
            return
        text = distance_text(*self._ends)
        metrics = painter.fontMetrics()
        plate = QRectF(0.0, 0.0, metrics.horizontalAdvance(text) + 10.0, metrics.height() + 4.0)
        plate.moveCenter((at[0] + at[1]) / 2)
        plate.moveLeft(min(max(plate.left(), 2.0), max(2.0, self._canvas.width() - plate.width() - 2.0)))
        plate.moveTop(min(max(at[0].y(), at[1].y()) + 8.0, max(2.0, self._canvas.height() - plate.height() - 2.0)))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(_PLATE)
        painter.drawRoundedRect(plate, 3.0, 3.0)
        painter.setPen(_LINE)
        painter.drawText(plate, int(Qt.AlignmentFlag.AlignCenter), text)


def distance_text(start: Place, end: Place) -> str:
    """Return the distance between two places, and its part along the proximity camera's axis."""
    return minus(f"{1e3 * dist(start, end):.1f} mm (dz {1e3 * (end[2] - start[2]):+.1f} mm)")
