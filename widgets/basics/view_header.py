"""The line above a view or image: its title, and what its colours mean."""

from __future__ import annotations

from html import escape

from PyQt6.QtCore import QRect, QSize, Qt
from PyQt6.QtGui import QFontMetrics, QPainter, QPaintEvent
from PyQt6.QtWidgets import QSizePolicy, QWidget

from .colormaps import Legend
from .theme import text_font

#: Pixels between two entries, and between the square of an entry and its name.
_GAP, _SMALL_GAP = 12, 4


class ViewHeader(QWidget):
    """Title at the left, and at the right the entries that fit, the most important first; the tooltip names all.

    Both are painted: labels would repeat their layout through the window whenever an entry changes.
    """

    def __init__(self, title: str) -> None:
        super().__init__()
        self._title, self.entries, self._shows_legend = title, Legend(), True
        self._bold, self._caption = text_font("body", bold=True), text_font("caption")
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setAutoFillBackground(True)  # else each change would paint all widgets behind it

    def set_title(self, title: str) -> None:
        self._title = title
        self.update()

    def set_entries(self, entries: Legend) -> None:
        if entries != self.entries:
            self.entries = entries
            self.update()

    def show_legend(self, shown: bool) -> None:
        self._shows_legend = shown
        self.update()

    def legend_tip(self) -> str:
        """Return all entries as rich text for a tooltip."""
        named = (f'<span style="color:{color.name()}">■</span> {escape(text)}' for text, color in self.entries)
        return f"<p>{'<br>'.join(named)}</p>" if self.entries else ""

    def sizeHint(self) -> QSize:
        return QSize(100, self.fontMetrics().height() + 6)

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter, bold, small = QPainter(self), QFontMetrics(self._bold), QFontMetrics(self._caption)
        room = self.rect().adjusted(4, 2, -4, 0)
        centred = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
        painter.setFont(self._bold)
        title = bold.elidedText(self._title, Qt.TextElideMode.ElideRight, room.width())
        painter.drawText(room, centred, title)
        if not self._shows_legend:
            return
        painter.setFont(self._caption)
        side = small.ascent() // 2 + 2
        widths = [side + _SMALL_GAP + small.horizontalAdvance(text) for text, _ in self.entries]
        left, fitting = room.width() - bold.horizontalAdvance(title), 0
        while fitting < len(widths) and sum(widths[: fitting + 1]) + _GAP * (fitting + 1) <= left:
            fitting += 1
        x = room.right() - sum(widths[:fitting]) - _GAP * max(0, fitting - 1)
        for (text, color), width in zip(self.entries, widths[:fitting], strict=False):
            painter.fillRect(QRect(x, room.center().y() - side // 2 + 1, side, side), self.palette().mid())
            painter.fillRect(QRect(x + 1, room.center().y() - side // 2 + 2, side - 2, side - 2), color)
            painter.drawText(room.adjusted(x + side + _SMALL_GAP - room.left(), 0, 0, 0), centred, text)
            x += width + _GAP
