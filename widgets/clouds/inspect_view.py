"""A 3D view for looking closely: the point under the mouse is marked, a double click enlarges."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, QPointF, Qt, QTimer, pyqtSignal
from PyQt6.QtGui import QColor, QMouseEvent, QPainter, QPen
from PyQt6.QtWidgets import QWidget

from ..basics.theme import CASING
from .cloud_view import CloudView, Place

#: Milliseconds between searches for the point under the moving mouse.
_HOVER_MS = 30
_RADIUS, _LINE = 6.0, QColor(255, 255, 255)


class InspectView(CloudView):
    """A `CloudView` that shows a mark and reports the point under the mouse."""

    HELP = """<p><b>Drag</b> to orbit, <b>Shift + drag</b> or middle button to pan, <b>wheel</b> to zoom,
    <b>double click</b> to enlarge.</p>
    <p>Keys: <b>arrows</b> orbit, <b>+ −</b> zoom, <b>R</b> reset, <b>V</b> front, <b>T</b> top, <b>S</b> side,
    <b>Z</b> zoom to the patch.</p>"""
    FOLLOWS_MOUSE = True

    pointHovered = pyqtSignal(object)  # Flat pixel and place of the point under the mouse, or None
    enlargeRequested = pyqtSignal()

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(title, parent)
        self._mark: Place | None = None
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

    # Events

    def mouseMoveEvent(self, event: QMouseEvent | None) -> None:
        super().mouseMoveEvent(event)
        if event is not None and event.buttons() == Qt.MouseButton.NoButton:
            self._mouse = self._canvas.mapFrom(self, event.position())
            if not self._hover.isActive():
                self._hover.start()

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

    def _paint_ornament(self, painter: QPainter, _canvas: QWidget) -> None:
        if self._mark is None:
            return
        u, v, away = self.camera().project([self._mark], *self._size())[0]
        if away > 0:
            painter.setBrush(Qt.BrushStyle.NoBrush)
            for color, width in ((CASING, 4.0), (_LINE, 2.0)):
                painter.setPen(QPen(color, width))
                painter.drawEllipse(QPointF(u, v), _RADIUS, _RADIUS)
