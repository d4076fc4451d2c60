"""The coverage of an image and of depth by the points of a calibration."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QPointF, QRectF, QSize, Qt
from PyQt6.QtGui import QBrush, QColor, QPainter, QPaintEvent, QPen
from PyQt6.QtWidgets import QSizePolicy, QWidget

from ..basics.theme import theme_colors

_BAR_HEIGHT = 40
_ENOUGH = 3


class CoverageGrid(QWidget):
    """Paints the number of points in each grid cell, empty ones hatched, and a depth line below."""

    def __init__(self) -> None:
        super().__init__()
        self._cells: tuple[tuple[int, ...], ...] = ()
        self._depths_mm: tuple[float, ...] = ()
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setAccessibleName("Coverage of the image and of depth")

    def sizeHint(self) -> QSize:
        return QSize(260, 190)

    def minimumSizeHint(self) -> QSize:
        return QSize(160, 120)

    def set_coverage(self, cells: Sequence[Sequence[int]], depths_mm: Sequence[float]) -> None:
        self._cells = tuple(tuple(row) for row in cells)
        self._depths_mm = tuple(depths_mm)
        empty = sum(count == 0 for row in self._cells for count in row)
        self.setToolTip(
            f"Points in each part of the proximity image ({empty} parts are empty), and their tactile depths in mm"
        )
        self.update()

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        area = QRectF(self.rect()).adjusted(1, 1, -1, -1)
        grid = QRectF(area.left(), area.top(), area.width(), area.height() - _BAR_HEIGHT)
        if self._cells:
            self._paint_cells(painter, grid)
        self._paint_depths(painter, QRectF(area.left(), grid.bottom(), area.width(), _BAR_HEIGHT))

    def _paint_cells(self, painter: QPainter, grid: QRectF) -> None:
        colors = theme_colors()
        rows, columns = len(self._cells), len(self._cells[0])
        width, height = grid.width() / columns, grid.height() / rows
        for row, counts in enumerate(self._cells):
            for column, count in enumerate(counts):
                cell = QRectF(grid.left() + column * width, grid.top() + row * height, width, height)
                if count == 0:
                    painter.fillRect(cell, QColor(colors.base))
                    painter.fillRect(cell, QBrush(QColor(colors.border), Qt.BrushStyle.BDiagPattern))
                fill = QColor(colors.accent)
                fill.setAlphaF(0.75 * min(1.0, count / _ENOUGH))
                painter.fillRect(cell, fill)
                painter.setPen(QPen(QColor(colors.border), 1))
                painter.drawRect(cell)
                painter.setPen(QColor(colors.error if count == 0 else colors.text))
                painter.drawText(cell, Qt.AlignmentFlag.AlignCenter, str(count))

    def _paint_depths(self, painter: QPainter, area: QRectF) -> None:
        colors = theme_colors()
        painter.setPen(QColor(colors.muted))
        if not self._depths_mm:
            painter.drawText(area, Qt.AlignmentFlag.AlignCenter, "no tactile depths")
            return
        near, far = min(self._depths_mm), max(self._depths_mm)
        text = f"depth {near:.0f} to {far:.0f} mm, a span of {far - near:.0f} mm"
        painter.drawText(area.adjusted(0, 0, 0, -2), Qt.AlignmentFlag.AlignBottom | Qt.AlignmentFlag.AlignHCenter, text)
        line = area.top() + 14
        left, right = area.left() + 8, area.right() - 8
        painter.setPen(QPen(QColor(colors.border), 2))
        painter.drawLine(QPointF(left, line), QPointF(right, line))
        painter.setPen(QPen(QColor(colors.base), 1))
        painter.setBrush(QColor(colors.accent))
        low, high = min(near, (near + far) / 2 - 15), max(far, (near + far) / 2 + 15)
        for depth in self._depths_mm:
            painter.drawEllipse(QPointF(left + (depth - low) / (high - low) * (right - left), line), 4, 4)
