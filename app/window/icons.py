"""Small icons drawn in the palette's own text colour, so that they follow the theme."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from PyQt6.QtCore import QPointF, QRect, QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QIcon, QIconEngine, QPainter, QPainterPath, QPalette, QPen, QPixmap, QPolygonF
from PyQt6.QtWidgets import QApplication

Draw = Callable[[QPainter], None]


class _PaletteIcon(QIconEngine):
    """Calls a drawing function in a 16 x 16 box with pen and brush set to the text colour."""

    def __init__(self, draw: Draw) -> None:
        super().__init__()
        self._draw = draw

    def paint(self, painter: QPainter | None, rect: QRect, mode: QIcon.Mode, state: QIcon.State) -> None:
        if painter is None:
            return
        group = QPalette.ColorGroup.Disabled if mode == QIcon.Mode.Disabled else QPalette.ColorGroup.Active
        color: QColor = QApplication.palette().color(group, QPalette.ColorRole.ButtonText)
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.translate(rect.x(), rect.y())
        painter.scale(rect.width() / 16, rect.height() / 16)
        painter.setBrush(color)
        painter.setPen(QPen(color, 1.4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin))
        self._draw(painter)
        painter.restore()

    def pixmap(self, size: QSize, mode: QIcon.Mode, state: QIcon.State) -> QPixmap:
        pixmap = QPixmap(size)
        pixmap.fill(Qt.GlobalColor.transparent)
        painter = QPainter(pixmap)
        self.paint(painter, QRect(0, 0, size.width(), size.height()), mode, state)
        painter.end()
        return pixmap

    def clone(self) -> QIconEngine:
        return _PaletteIcon(self._draw)


def _triangle(painter: QPainter, left: float, right: float) -> None:
    painter.drawPolygon(QPolygonF([QPointF(left, 3.5), QPointF(right, 8), QPointF(left, 12.5)]))


def _bar(painter: QPainter, x: float) -> None:
    painter.drawLine(QPointF(x, 3.5), QPointF(x, 12.5))


def _play(painter: QPainter) -> None:
    _triangle(painter, 4.5, 13)


def _pause(painter: QPainter) -> None:
    painter.drawRect(QRectF(4.2, 3.5, 2, 9))
    painter.drawRect(QRectF(9.8, 3.5, 2, 9))


def _next(painter: QPainter) -> None:
    _triangle(painter, 4, 10.5)
    _bar(painter, 12.5)


def _previous(painter: QPainter) -> None:
    _triangle(painter, 12, 5.5)
    _bar(painter, 3.5)


def _loop(painter: QPainter) -> None:
    painter.setBrush(Qt.BrushStyle.NoBrush)
    path = QPainterPath()
    box = QRectF(2.5, 3.5, 11, 9)
    path.arcMoveTo(box, 60)
    path.arcTo(box, 60, 290)
    painter.drawPath(path)
    painter.drawLine(QPointF(13.1, 6.4), QPointF(13.2, 3.4))
    painter.drawLine(QPointF(13.1, 6.4), QPointF(10.2, 6.2))


def _freeze(painter: QPainter) -> None:
    for angle in (90, 30, 150):
        x, y = 5.5 * math.cos(math.radians(angle)), 5.5 * math.sin(math.radians(angle))
        painter.drawLine(QPointF(8 - x, 8 - y), QPointF(8 + x, 8 + y))


def _reset(painter: QPainter) -> None:
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.drawRect(QRectF(3, 3, 10, 10))
    painter.drawEllipse(QPointF(8, 8), 1.5, 1.5)


def _export(painter: QPainter) -> None:
    painter.drawLine(QPointF(8, 2.5), QPointF(8, 9))
    painter.drawPolygon(QPolygonF([QPointF(5, 7), QPointF(11, 7), QPointF(8, 10.5)]))
    painter.drawLine(QPointF(3, 13), QPointF(13, 13))


def _record(painter: QPainter) -> None:
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(QColor("#d64545"))
    painter.drawEllipse(QPointF(8, 8), 5, 5)


def _more(painter: QPainter) -> None:
    painter.setBrush(Qt.BrushStyle.NoBrush)
    for left in (2.5, 8.5):
        painter.drawPolyline(QPolygonF([QPointF(left, 5), QPointF(left + 4.5, 8), QPointF(left, 11)]))


def _saved(painter: QPainter) -> None:
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.drawPolyline(QPolygonF([QPointF(3, 8.5), QPointF(6.5, 12), QPointF(13, 4.5)]))


def _bracket(painter: QPainter, x: float, to: float) -> None:
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.drawPolyline(QPolygonF([QPointF(x + to, 3), QPointF(x, 3), QPointF(x, 13), QPointF(x + to, 13)]))


def _flag(painter: QPainter) -> None:
    painter.drawLine(QPointF(4.5, 2.5), QPointF(4.5, 13.5))
    painter.drawPolygon(QPolygonF([QPointF(4.5, 3), QPointF(12.5, 5.7), QPointF(4.5, 8.5)]))


def _list(painter: QPainter) -> None:
    for y in (4.0, 8.0, 12.0):
        painter.drawEllipse(QPointF(3.5, y), 0.5, 0.5)
        painter.drawLine(QPointF(6.5, y), QPointF(13, y))


def _clear(painter: QPainter) -> None:
    painter.drawLine(QPointF(4, 4), QPointF(12, 12))
    painter.drawLine(QPointF(4, 12), QPointF(12, 4))


_DRAWINGS: dict[str, Draw] = {
    "play": _play,
    "pause": _pause,
    "next": _next,
    "previous": _previous,
    "loop": _loop,
    "freeze": _freeze,
    "reset": _reset,
    "export": _export,
    "record": _record,
    "more": _more,
    "saved": _saved,
    "in": partial(_bracket, x=6, to=4),
    "out": partial(_bracket, x=10, to=-4),
    "clear": _clear,
    "flag": _flag,
    "list": _list,
}


def icon(name: str) -> QIcon:
    """Return an icon by its name, such as ``"play"``."""
    return QIcon(_PaletteIcon(_DRAWINGS[name]))
