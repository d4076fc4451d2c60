"""One line of colour swatches with words."""

from __future__ import annotations

from html import escape

from PyQt6.QtCore import QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QFont, QFontInfo, QFontMetricsF, QPainter, QPaintEvent, QPalette
from PyQt6.QtWidgets import QSizePolicy, QWidget

_SWATCH, _GAP, _SPACING, _PADDING = 10.0, 5.0, 14.0, 4.0


class LegendLine(QWidget):
    """Shows as many entries as fit; the rest hides behind ``+N``, and the tooltip lists all."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._entries: list[tuple[str, QColor]] = []
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        font = QFont(self.font())
        font.setPointSizeF(QFontInfo(font).pointSizeF() * 0.9)
        self.setFont(font)

    def value(self) -> list[tuple[str, QColor]]:
        """Return the entries."""
        return list(self._entries)

    def setValue(self, entries: list[tuple[str, QColor]]) -> None:
        """Show other entries, the most important first."""
        self._entries = list(entries)
        rows = "".join(
            f'<tr><td style="color:{color.name()}">■&nbsp;</td><td>{escape(text)}</td></tr>' for text, color in entries
        )
        self.setToolTip(f"<table>{rows}</table>" if rows else "")
        self.update()

    def sizeHint(self) -> QSize:
        """One line of text high, as wide as there is room."""
        return QSize(100, round(QFontMetricsF(self.font()).height() + _PADDING))

    def fitting(self) -> int:
        """Return how many entries fit at the present width."""
        metrics = QFontMetricsF(self.font())
        ends, x = [], _PADDING
        for text, _ in self._entries:
            x += _SWATCH + _GAP + metrics.horizontalAdvance(text)
            ends.append(x)
            x += _SPACING
        if not ends or ends[-1] <= self.width():
            return len(ends)
        room = self.width() - _SPACING - metrics.horizontalAdvance(f"+{len(ends)}")
        return sum(end <= room for end in ends)

    def paintEvent(self, _event: QPaintEvent | None) -> None:
        """Paint swatches and words from the left."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        metrics = QFontMetricsF(self.font())
        text_color = self.palette().color(QPalette.ColorRole.WindowText)
        outline = QColor(text_color)
        outline.setAlpha(70)
        shown = self.fitting()
        x, height = _PADDING, float(self.height())
        for text, color in self._entries[:shown]:
            painter.setPen(outline)
            painter.setBrush(color)
            painter.drawRoundedRect(QRectF(x, (height - _SWATCH) / 2, _SWATCH, _SWATCH), 2.0, 2.0)
            x += _SWATCH + _GAP
            x = self._write(painter, metrics, x, text, text_color) + _SPACING
        if shown < len(self._entries):
            self._write(painter, metrics, x, f"+{len(self._entries) - shown}", text_color)
        painter.end()

    def _write(self, painter: QPainter, metrics: QFontMetricsF, x: float, text: str, color: QColor) -> float:
        width = metrics.horizontalAdvance(text)
        painter.setPen(color)
        flags = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
        painter.drawText(QRectF(x, 0.0, width + 1.0, float(self.height())), int(flags), text)
        return x + width
