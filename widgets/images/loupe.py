"""A magnifier beside the cursor, with the place that a click would really take."""

from __future__ import annotations

from math import ceil, floor, hypot
from typing import Final

import numpy as np
from PyQt6.QtCore import QPointF, QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QImage, QPainter, QPaintEvent, QPen
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import Uint8Array
from ..basics.theme import theme_colors
from .marks import COLORS, MarkKind

#: Edge of the magnified square in screen pixels, and how many image pixels it spans.
EDGE: Final = 168
SPAN: Final = 21.0
_LINE = 20
_DISTANCE = 26


class Loupe(QWidget):
    """Shows the surroundings of a place in an image, enlarged, with a crosshair.

    Where a snapped place is given, a ring marks it and the line below tells how far it lies.
    """

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self._pixels: Uint8Array | None = None
        self._place = (0.0, 0.0)
        self._snapped: tuple[float, float] | None = None
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setFixedSize(self.sizeHint())
        self.hide()

    def sizeHint(self) -> QSize:
        """A square and a line of text."""
        return QSize(EDGE, EDGE + _LINE)

    def set_pixels(self, pixels: Uint8Array | None) -> None:
        """Take the image, uint8 (h, w, 4) as ``QImage.Format_RGB32`` has it."""
        self._pixels = pixels
        self.update()

    def show_at(self, cursor: QPointF, place: tuple[float, float]) -> None:
        """Magnify an image place and move beside the cursor (parent coordinates), inside the parent."""
        self._place, self._snapped = place, None
        parent = self.parentWidget()
        assert parent is not None
        x = cursor.x() + _DISTANCE
        if x + self.width() > parent.width():
            x = cursor.x() - _DISTANCE - self.width()
        y = cursor.y() - self.height() - _DISTANCE / 2
        if y < 0:
            y = cursor.y() + _DISTANCE / 2
        y = max(0.0, min(y, parent.height() - self.height()))
        self.move(round(x), round(y))
        self.show()
        self.raise_()
        self.update()

    def set_snapped(self, place: tuple[float, float] | None) -> None:
        """Mark the place that a click would take."""
        self._snapped = place
        self.update()

    def text(self) -> str:
        """Return the line below the image."""
        u, v = self._place
        if self._snapped is None:
            return f"{u:.1f}  {v:.1f}"
        distance = hypot(self._snapped[0] - u, self._snapped[1] - v)
        return f"{self._snapped[0]:.2f}  {self._snapped[1]:.2f}   snap {distance:.1f} px"

    def paintEvent(self, _: QPaintEvent | None) -> None:
        """Paint the enlarged pixels, the crosshair, the ring and the text."""
        painter = QPainter(self)
        colors = theme_colors()
        painter.fillRect(self.rect(), QColor(colors.base))
        self._paint_pixels(painter)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        middle = EDGE / 2
        for pen in (QPen(QColor(0, 0, 0, 150), 3), QPen(QColor(255, 255, 255), 1)):
            painter.setPen(pen)
            for start, end in ((4, middle - 8), (middle + 8, EDGE - 4)):
                painter.drawLine(QPointF(middle, start), QPointF(middle, end))
                painter.drawLine(QPointF(start, middle), QPointF(end, middle))
        if self._snapped is not None:
            scale = EDGE / SPAN
            u, v = (self._snapped[axis] - self._place[axis] for axis in (0, 1))
            painter.setPen(QPen(COLORS[MarkKind.PENDING], 2))
            painter.drawEllipse(QPointF(middle + u * scale, middle + v * scale), 5, 5)
        painter.setPen(QColor(colors.text))
        painter.drawText(QRectF(0, EDGE, EDGE, _LINE), Qt.AlignmentFlag.AlignCenter, self.text())
        painter.setPen(QPen(QColor(colors.border), 1))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRect(QRectF(0.5, 0.5, self.width() - 1, self.height() - 1))

    def _paint_pixels(self, painter: QPainter) -> None:
        if self._pixels is None:
            return
        height, width = self._pixels.shape[:2]
        scale = EDGE / SPAN
        left, top = self._place[0] - SPAN / 2, self._place[1] - SPAN / 2
        first_u, last_u = max(0, floor(left + 0.5)), min(width, ceil(left + SPAN + 0.5))
        first_v, last_v = max(0, floor(top + 0.5)), min(height, ceil(top + SPAN + 0.5))
        if first_u >= last_u or first_v >= last_v:
            return
        part = np.ascontiguousarray(self._pixels[first_v:last_v, first_u:last_u])
        columns, rows = part.shape[1], part.shape[0]
        image = QImage(part.tobytes(), columns, rows, 4 * columns, QImage.Format.Format_RGB32)
        painter.setClipRect(0, 0, EDGE, EDGE)
        painter.drawImage(
            QRectF((first_u - 0.5 - left) * scale, (first_v - 0.5 - top) * scale, columns * scale, rows * scale), image
        )
        painter.setClipping(False)
