"""Colour swatches with words, on one line or on several."""

from __future__ import annotations

from html import escape

from PyQt6.QtCore import QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QFont, QFontInfo, QFontMetricsF, QPainter, QPaintEvent, QPalette
from PyQt6.QtWidgets import QSizePolicy, QWidget

_SWATCH, _GAP, _SPACING, _PADDING = 10.0, 5.0, 14.0, 4.0
#: More lines than this would take too much from what is explained.
_MOST_LINES = 4


class LegendLine(QWidget):
    """Shows as many entries as fit on its lines; the rest hides behind ``+N``, and the tooltip lists all."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._entries: list[tuple[str, QColor]] = []
        self._lines = 1
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
        """As high as its lines, as wide as there is room."""
        return QSize(100, round(self._lines * QFontMetricsF(self.font()).height() + _PADDING))

    def needed_lines(self) -> int:
        """Return on how many lines all entries fit at the present width, or the most there can be."""
        places = self._places()
        return min(places[-1][0] + 1, _MOST_LINES) if places else 1

    def set_lines(self, lines: int) -> None:
        """Take up so many lines."""
        if lines != self._lines:
            self._lines = lines
            self.updateGeometry()
            self.update()

    def fitting(self) -> int:
        """Return how many entries fit at the present width and number of lines."""
        places = self._places()
        last = self._lines - 1
        if all(line <= last and end <= self.width() for line, _, end in places):
            return len(places)
        rest = QFontMetricsF(self.font()).horizontalAdvance(f"+{len(places)}")
        room = self.width() - _SPACING - rest
        return sum(line < last or (line == last and end <= room) for line, _, end in places)

    def _places(self) -> list[tuple[int, float, float]]:
        """Return the line, the left and the right end of each entry at the present width."""
        metrics = QFontMetricsF(self.font())
        places: list[tuple[int, float, float]] = []
        line, x = 0, _PADDING
        for text, _ in self._entries:
            width = _SWATCH + _GAP + metrics.horizontalAdvance(text)
            if x > _PADDING and x + width > self.width():
                line, x = line + 1, _PADDING
            places.append((line, x, x + width))
            x += width + _SPACING
        return places

    def paintEvent(self, _event: QPaintEvent | None) -> None:
        """Paint swatches and words from the left, line after line."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        text_color = self.palette().color(QPalette.ColorRole.WindowText)
        outline = QColor(text_color)
        outline.setAlpha(70)
        places, shown, height = self._places(), self.fitting(), self.height() / self._lines
        for (text, color), (line, x, _) in zip(self._entries[:shown], places, strict=False):
            painter.setPen(outline)
            painter.setBrush(color)
            painter.drawRoundedRect(QRectF(x, (line + 0.5) * height - _SWATCH / 2, _SWATCH, _SWATCH), 2.0, 2.0)
            painter.setPen(text_color)
            self._write(painter, x + _SWATCH + _GAP, line * height, height, text)
        if shown < len(places):
            line, x, _ = places[shown]
            if line >= self._lines:
                line, x = self._lines - 1, places[shown - 1][2] + _SPACING
            painter.setPen(text_color)
            self._write(painter, x, line * height, height, f"+{len(places) - shown}")
        painter.end()

    def _write(self, painter: QPainter, x: float, y: float, height: float, text: str) -> None:
        flags = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
        painter.drawText(QRectF(x, y, self.width() - x, height), int(flags), text)
