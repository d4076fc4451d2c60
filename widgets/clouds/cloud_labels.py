"""The header of a cloud view (title, number of points) and its legend."""

from __future__ import annotations

import re
from html import escape

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QColor, QResizeEvent
from PyQt6.QtWidgets import QLabel, QSizePolicy, QWidget

from ..basics.controls import ElidedLabel
from ..basics.theme import text_font

_MARGIN, _TOP, _GAP = 2, 2, 8
#: Horizontal padding of the title, in pixels.
_TITLE_PADDING = 6
_MAX_LINES = 4


class CloudHeader(QWidget):
    """Title on the left, number of points on the right, without the word where both do not fit.

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
        room, height = self.width() - 2 * _MARGIN, self.height() - _TOP
        title = self._title.fontMetrics().horizontalAdvance(self._title.text()) + _TITLE_PADDING
        shown = f"{self._value:,} point{'' if self._value == 1 else 's'}"
        if title + _GAP + self._width_of(shown) > room:
            shown = f"{self._value:,}"
        width = self._width_of(shown)
        self._count.setText(shown)
        self._count.setGeometry(_MARGIN + room - width, _TOP, width, height)
        self._title.setGeometry(_MARGIN, _TOP, max(0, room - width - _GAP), height)

    def _width_of(self, words: str) -> int:
        """Return the width with every digit as wide as an 8, so that nothing moves between frames."""
        return self._count.fontMetrics().horizontalAdvance(re.sub(r"\d", "8", words)) + 2


class LegendLine(QLabel):
    """The entries that fit, over as many lines as it is high; the tooltip lists all."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._entries: list[tuple[str, QColor]] = []
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        self.setTextFormat(Qt.TextFormat.RichText)
        self.setWordWrap(True)
        self.setFont(text_font("caption"))
        self._height = self._line_height()

    def value(self) -> list[tuple[str, QColor]]:
        return list(self._entries)

    def setValue(self, entries: list[tuple[str, QColor]]) -> None:
        """Show these entries, the most important first."""
        self._entries = list(entries)
        named = [
            f'<span style="color:{color.name()}">■</span>&nbsp;{escape(text).replace(" ", "&nbsp;")}'
            for text, color in entries
        ]
        self.setText(" &nbsp; ".join(named))
        self.setToolTip("<br>".join(named))

    def sizeHint(self) -> QSize:
        return QSize(100, self._height)

    def hasHeightForWidth(self) -> bool:
        return False  # all views have the height of the highest legend

    def set_height(self, height: int) -> None:
        self._height = height
        self.updateGeometry()

    def needed_height(self) -> int:
        """Return the height in pixels that all entries need at the current width, at most `_MAX_LINES` lines."""
        return min(max(self.heightForWidth(self.width()), self._line_height()), _MAX_LINES * self._line_height())

    def _line_height(self) -> int:
        return self.fontMetrics().height()
