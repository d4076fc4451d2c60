"""The wipe: a vertical line at the same share of the width in every view, with one side left and one right of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QColor, QFont, QFontMetricsF, QPainter, QPen

from .theme import CASING

#: Distance in screen pixels within which the mouse grabs the line.
REACH: Final = 7.0

_LINE = QColor(255, 255, 255)
_PLATE = QColor(0, 0, 0, 165)
_GRIP = 7.0
_MARGIN, _PADDING = 6.0, 5.0


@dataclass(frozen=True)
class Wipe:
    """Where the line stands, and the names of both sides.

    ``share`` is the part of the width left of the line: 1 shows only the left side, 0 only the right one.
    """

    share: float
    left: str
    right: str

    def column(self, width: int) -> int:
        return min(max(round(self.share * width), 0), width)

    def grabbed(self, x: float, width: float) -> bool:
        return abs(x - self.share * width) <= REACH


def paint_wipe(painter: QPainter, room: QRectF, wipe: Wipe, font: QFont) -> None:
    x = room.left() + wipe.column(round(room.width()))
    painter.save()
    painter.setFont(font)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    if 0 < wipe.share < 1:
        for color, width in ((CASING, 4.0), (_LINE, 2.0)):
            painter.setPen(QPen(color, width))
            painter.drawLine(QPointF(x, room.top()), QPointF(x, room.bottom()))
        _paint_grip(painter, QPointF(x, room.center().y()))
    _paint_name(painter, QRectF(room.left(), room.top(), x - room.left(), room.height()), wipe.left, wipe.share < 1)
    _paint_name(painter, QRectF(x, room.top(), room.right() - x, room.height()), wipe.right, False)
    painter.restore()


def _paint_grip(painter: QPainter, centre: QPointF) -> None:
    painter.setPen(QPen(CASING, 1.5))
    painter.setBrush(_LINE)
    painter.drawEllipse(centre, _GRIP, _GRIP)
    painter.setPen(QPen(QColor(0, 0, 0), 1.5))
    for side in (-1, 1):
        tip = centre + QPointF(4.5 * side, 0)
        for up in (-1, 1):
            painter.drawLine(tip, centre + QPointF(2.0 * side, 2.5 * up))


def _paint_name(painter: QPainter, side: QRectF, name: str, at_right: bool) -> None:
    """Paint a name in the top corner of a side, elided; nothing where not even its first letters fit."""
    metrics = QFontMetricsF(painter.font())
    room = side.width() - 2 * (_MARGIN + _PADDING)
    if room < metrics.horizontalAdvance(f"{name[:1]}…"):
        return
    text = metrics.elidedText(name, Qt.TextElideMode.ElideRight, room)
    width = metrics.horizontalAdvance(text) + 2 * _PADDING
    left = side.right() - _MARGIN - width if at_right else side.left() + _MARGIN
    plate = QRectF(left, side.top() + _MARGIN, width, metrics.height() + 2)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(_PLATE)
    painter.drawRoundedRect(plate, 3.0, 3.0)
    painter.setPen(_LINE)
    painter.drawText(plate, int(Qt.AlignmentFlag.AlignCenter), text)
