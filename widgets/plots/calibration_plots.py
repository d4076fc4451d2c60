"""Plots of a calibration: image coverage of the correspondences and their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, hypot, log10
from typing import Final

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
        """Show counts by rows, top first, and the depths of the points in millimetres."""
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


_STEPS: Final = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Residual:
    """Residual of one pair: offset in pixels, name, and whether it is an outlier."""

    du: float
    dv: float
    label: str = ""
    worst: bool = False


class ResidualPlot(QWidget):
    """Rings at round numbers of pixels, a dot for each pair, names at outliers."""

    def __init__(self) -> None:
        super().__init__()
        self._residuals: tuple[Residual, ...] = ()
        self._limit = 1.0
        self._message = ""
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setAccessibleName("Residuals")

    def sizeHint(self) -> QSize:
        return QSize(260, 220)

    def minimumSizeHint(self) -> QSize:
        return QSize(140, 120)

    def set_residuals(self, residuals: Sequence[Residual], limit: float | None = None, message: str = "") -> None:
        """Show residuals; ``limit`` is the outer ring in pixels, by default a round number beyond all residuals."""
        self._residuals, self._message = tuple(residuals), message
        self._limit = limit or round_limit(residuals)
        self.setToolTip(
            message or f"{len(residuals)} pairs; clicked minus predicted position, outer ring {self._limit:g} px"
        )
        self.update()

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        colors = theme_colors()
        area = QRectF(self.rect()).adjusted(1, 1, -1, -1)
        painter.fillRect(area, QColor(colors.base))
        if self._message:
            painter.setPen(QColor(colors.muted))
            flags = Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap
            painter.drawText(area.adjusted(12, 12, -12, -12), int(flags), self._message)
            return
        middle = area.center()
        radius = min(area.width(), area.height()) / 2 - 14
        painter.setPen(QPen(QColor(colors.border), 1))
        for share in (0.5, 1.0):
            painter.drawEllipse(middle, share * radius, share * radius)
        painter.drawLine(middle - QPointF(radius, 0), middle + QPointF(radius, 0))
        painter.drawLine(middle - QPointF(0, radius), middle + QPointF(0, radius))
        painter.setPen(QColor(colors.muted))
        painter.drawText(middle + QPointF(3, -radius + 12), f"{self._limit:g} px")
        painter.drawText(middle + QPointF(3, -radius / 2 + 12), f"{self._limit / 2:g}")
        for residual in sorted(self._residuals, key=lambda residual: residual.worst):
            self._paint_dot(painter, middle, radius, residual)

    def _paint_dot(self, painter: QPainter, middle: QPointF, radius: float, residual: Residual) -> None:
        colors = theme_colors()
        scale = radius / self._limit
        length = hypot(residual.du, residual.dv)
        shrink = min(1.0, 1.06 * self._limit / length) if length > 0 else 1.0
        place = middle + QPointF(residual.du * scale * shrink, residual.dv * scale * shrink)
        color = QColor(colors.error if residual.worst else colors.accent)
        painter.setPen(QPen(QColor(colors.base), 1))
        painter.setBrush(color)
        painter.drawEllipse(place, 4.0, 4.0)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if residual.worst:
            painter.setPen(color)
            painter.drawText(place + QPointF(6, 4), residual.label)


def round_limit(residuals: Sequence[Residual]) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that holds all residuals, pixels."""
    largest = max((hypot(residual.du, residual.dv) for residual in residuals), default=0.0)
    if not 1e-6 < largest < 1e9:
        return 1.0
    decade = 10.0 ** (ceil(log10(largest)) - 1)
    return next(step * decade for step in _STEPS if step * decade >= largest * 0.999)
