"""The header of a cloud view (title, number of points) and its legend."""

from __future__ import annotations

import re
from html import escape

from PyQt6.QtCore import QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QFontMetricsF, QPainter, QPaintEvent, QPalette, QResizeEvent
from PyQt6.QtWidgets import QLabel, QSizePolicy, QWidget

from ..basics.controls import ElidedLabel
from ..basics.theme import text_font

_MARGIN, _TOP, _GAP = 2, 2, 8
#: Horizontal padding of the title, in pixels.
_TITLE_PADDING = 6


def short_count(count: int) -> str:
    """Return a number in at most four characters up to 999 million: 950, 1.2k, 222k, 1.3M."""
    if count < 1000:
        return str(count)
    value, unit = (count / 1e3, "k") if count < 999_500 else (count / 1e6, "M")
    return f"{value:.1f}{unit}" if value < 9.95 else f"{value:.0f}{unit}"


class CloudHeader(QWidget):
    """Title on the left, number of points on the right. A narrow header rounds the number and elides the title.

    The labels have no layout: a layout would repeat its work through the whole window for every frame.
    """

    def __init__(self, title: str) -> None:
        super().__init__()
        self._title = ElidedLabel(title, self)
        self._title.setObjectName("title")
        font = self._title.font()
        font.setBold(True)
        self._title.setFont(font)
        self._count = QLabel(self)
        self._count.setObjectName("count")
        self._count.setTextFormat(Qt.TextFormat.PlainText)
        self._count.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        for opaque in (self, self._count):
            opaque.setAutoFillBackground(True)  # else each new number would paint all widgets behind it
        self._value = 0
        self._place()

    def set_count(self, count: int) -> None:
        if count != self._value:
            self._value = count
            self._place()

    def sizeHint(self) -> QSize:
        return QSize(100, self._title.sizeHint().height() + _TOP)

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        super().resizeEvent(event)
        self._place()

    def _place(self) -> None:
        full = f"{self._value:,} point{'' if self._value == 1 else 's'}"
        metrics = self._count.fontMetrics()
        # Every digit counts as wide as an 8, so that the format does not flicker between frames.
        needed = metrics.horizontalAdvance(re.sub(r"\d", "8", full)) + 2
        title = self._title.fontMetrics().horizontalAdvance(self._title.text()) + _TITLE_PADDING
        room, height = self.width() - 2 * _MARGIN, self.height() - _TOP
        fits = title + _GAP + needed <= room
        shown = full if fits else short_count(self._value)
        if not fits:
            needed = metrics.horizontalAdvance(shown) + 2
        if shown != self._count.text():
            self._count.setText(shown)
            self._count.setAccessibleName(full)
        tip = "" if fits else full
        if tip != self._count.toolTip():
            self._count.setToolTip(tip)
        self._count.setGeometry(_MARGIN + room - needed, _TOP, needed, height)
        self._title.setGeometry(_MARGIN, _TOP, max(0, room - needed - _GAP), height)


_SWATCH, _TEXT_GAP, _SPACING, _PADDING = 10.0, 5.0, 14.0, 4.0
_MAX_LINES = 4


class LegendLine(QWidget):
    """Shows the entries that fit; ``+N`` counts the hidden ones, and the tooltip lists all."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._entries: list[tuple[str, QColor]] = []
        self._lines = 1
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setFont(text_font("caption"))

    def value(self) -> list[tuple[str, QColor]]:
        return list(self._entries)

    def setValue(self, entries: list[tuple[str, QColor]]) -> None:
        """Show these entries, the most important first."""
        self._entries = list(entries)
        rows = "".join(
            f'<tr><td style="color:{color.name()}">■&nbsp;</td><td>{escape(text)}</td></tr>' for text, color in entries
        )
        self.setToolTip(f"<p><table>{rows}</table></p>" if rows else "")
        self.update()

    def sizeHint(self) -> QSize:
        return QSize(100, round(self._lines * QFontMetricsF(self.font()).height() + _PADDING))

    def needed_lines(self) -> int:
        """Return the number of lines that all entries need at the current width, at most `_MAX_LINES`."""
        places = self._places()
        return min(places[-1][0] + 1, _MAX_LINES) if places else 1

    def set_lines(self, lines: int) -> None:
        if lines != self._lines:
            self._lines = lines
            self.updateGeometry()
            self.update()

    def fitting(self) -> int:
        """Return how many entries fit at the current width and number of lines."""
        places = self._places()
        last = self._lines - 1
        if all(line <= last and end <= self.width() for line, _, end in places):
            return len(places)
        rest = QFontMetricsF(self.font()).horizontalAdvance(f"+{len(places)}")
        room = self.width() - _SPACING - rest
        return sum(line < last or (line == last and end <= room) for line, _, end in places)

    def _places(self) -> list[tuple[int, float, float]]:
        """Return line, left end and right end of each entry at the current width."""
        metrics = QFontMetricsF(self.font())
        places: list[tuple[int, float, float]] = []
        line, x = 0, _PADDING
        for text, _ in self._entries:
            width = _SWATCH + _TEXT_GAP + metrics.horizontalAdvance(text)
            if x > _PADDING and x + width > self.width():
                line, x = line + 1, _PADDING
            places.append((line, x, x + width))
            x += width + _SPACING
        return places

    def paintEvent(self, _event: QPaintEvent | None) -> None:
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
            self._write(painter, x + _SWATCH + _TEXT_GAP, line * height, height, text)
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
