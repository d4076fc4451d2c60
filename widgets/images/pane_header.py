"""The line above an image: its title, and a legend as long as there is room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PyQt6.QtCore import QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QImage, QPainter, QPaintEvent, QPen
from PyQt6.QtWidgets import QSizePolicy, QWidget

from ...core.model.arrays import Uint8Array
from ..basics.theme import theme_colors

_BAR_WIDTH = 48
_SHORTEST_BAR = 24
_SWATCH = 10
_GAP = 5


@dataclass(frozen=True)
class Swatch:
    """A colour and its name."""

    text: str
    rgb: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class ColorBar:
    """A colour table with the texts of both ends; ``marks`` are fractions along the bar."""

    low: str
    high: str
    lut: Uint8Array
    marks: tuple[float, ...] = ()


class PaneHeader(QWidget):
    """Paints a title and a legend, on one line or on two; what does not fit is left out, last things first."""

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._title = title
        self._bar: ColorBar | None = None
        self._swatches: tuple[Swatch, ...] = ()
        self._lines = 1
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._describe()

    def set_legend(self, bar: ColorBar | None, swatches: tuple[Swatch, ...] = ()) -> None:
        """Show a colour bar, swatches, or both."""
        self._bar, self._swatches = bar, swatches
        self._describe()
        self.update()

    def full_width(self) -> int:
        """Return the width in pixels that the title and the bar, or else the swatches, take on one line."""
        metrics = self.fontMetrics()
        title = metrics.horizontalAdvance(self._title) + 2 + 2 * _GAP
        if self._bar is None:
            return title + sum(metrics.horizontalAdvance(s.text) + _SWATCH + 3 * _GAP for s in self._swatches)
        ends = metrics.horizontalAdvance(self._bar.low) + metrics.horizontalAdvance(self._bar.high)
        return title + ends + _SHORTEST_BAR + 2 * _GAP + 4

    def set_lines(self, lines: int) -> None:
        """Put the legend beside the title (1) or below it (2)."""
        if lines != self._lines:
            self._lines = lines
            self.updateGeometry()
            self.update()

    def sizeHint(self) -> QSize:
        """As high as its lines."""
        return QSize(200, self._lines * (self.fontMetrics().height() + 4))

    def minimumSizeHint(self) -> QSize:
        """The width is up to the pane."""
        return QSize(0, self.sizeHint().height())

    def paintEvent(self, _: QPaintEvent | None) -> None:
        """Paint the title and what fits of the legend."""
        painter = QPainter(self)
        colors = theme_colors()
        metrics = self.fontMetrics()
        line = self.height() / self._lines
        painter.setPen(QColor(colors.text))
        title = metrics.elidedText(self._title, Qt.TextElideMode.ElideRight, self.width() - 2)
        painter.drawText(QRectF(2, 0, self.width(), line), Qt.AlignmentFlag.AlignVCenter, title)
        left = metrics.horizontalAdvance(title) + 2 + 2 * _GAP if self._lines == 1 else 2
        right = float(self.width() - 2)
        painter.setPen(QColor(colors.muted))
        painter.translate(0, self.height() - line)
        if self._bar is not None:
            right = self._paint_bar(painter, self._bar, left, right, line)
        for swatch in self._swatches:
            right = self._paint_swatch(painter, swatch, left, right, line)

    def _paint_bar(self, painter: QPainter, bar: ColorBar, left: float, right: float, line: float) -> float:
        """Paint the bar right-aligned; return where the space left of it ends."""
        metrics = self.fontMetrics()
        low, high = metrics.horizontalAdvance(bar.low), metrics.horizontalAdvance(bar.high)
        length = min(_BAR_WIDTH, right - left - low - high - 2 * _GAP)
        if length < _SHORTEST_BAR:
            return right
        flags = Qt.AlignmentFlag.AlignVCenter
        painter.drawText(QRectF(right - high, 0, high + 1, line), flags, bar.high)
        frame = QRectF(right - high - _GAP - length, line / 2 - 4, length, 8)
        painter.drawText(QRectF(frame.left() - _GAP - low, 0, low + 1, line), flags, bar.low)
        strip = np.ascontiguousarray(bar.lut[None, 1:])
        painter.drawImage(frame, QImage(strip.tobytes(), strip.shape[1], 1, QImage.Format.Format_RGBX8888))
        painter.save()
        painter.setPen(QPen(QColor(theme_colors().text), 1.5))
        for mark in bar.marks:
            x = frame.left() + mark * length
            painter.drawLine(round(x), round(frame.top() - 2), round(x), round(frame.bottom() + 2))
        painter.restore()
        return frame.left() - _GAP - low - 2 * _GAP

    def _paint_swatch(self, painter: QPainter, swatch: Swatch, left: float, right: float, line: float) -> float:
        advance = self.fontMetrics().horizontalAdvance(swatch.text)
        start = right - advance - _SWATCH - _GAP
        if start < left:
            return right
        painter.fillRect(QRectF(start, (line - _SWATCH) / 2, _SWATCH, _SWATCH), QColor(*swatch.rgb))
        box = QRectF(right - advance, 0, advance + 1, line)
        painter.drawText(box, Qt.AlignmentFlag.AlignVCenter, swatch.text)
        return start - 2 * _GAP

    def _describe(self) -> None:
        """Say the legend in words, for the tooltip and for screen readers."""
        parts = [swatch.text for swatch in self._swatches]
        if self._bar is not None:
            parts.insert(0, f"{self._bar.low} to {self._bar.high}")
        self.setToolTip(f"{self._title}: {', '.join(parts)}" if parts else self._title)
        self.setAccessibleName(self._title)
        self.setAccessibleDescription(", ".join(parts))
