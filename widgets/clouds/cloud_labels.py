"""The header of a cloud view (title, number of points) and its legend."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QColor, QFontMetrics, QPainter, QPaintEvent
from PyQt6.QtWidgets import QLabel, QSizePolicy, QWidget

from ..basics.theme import text_font

#: Pixels between title and number.
_GAP = 8
_MAX_LINES = 3


class CloudHeader(QWidget):
    """Title and number of points, painted: labels would repeat their layout through the window for every frame."""

    def __init__(self, title: str) -> None:
        super().__init__()
        self._title, self._count = title, 0
        self._bold = text_font("body", bold=True)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setAutoFillBackground(True)  # else each new number would paint all widgets behind it

    def set_count(self, count: int) -> None:
        if count != self._count:
            self._count = count
            self.update()

    def sizeHint(self) -> QSize:
        return QSize(100, self.fontMetrics().height() + 6)

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter, plain, bold = QPainter(self), self.fontMetrics(), QFontMetrics(self._bold)
        room = self.rect().adjusted(4, 2, -4, 0)
        count = f"{self._count:,} point{'' if self._count == 1 else 's'}"
        if bold.horizontalAdvance(self._title) + _GAP + plain.horizontalAdvance(count) > room.width():
            count = ""
        painter.setPen(self.palette().windowText().color())
        painter.drawText(room, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, count)
        left = room.width() - _GAP - plain.horizontalAdvance(count)
        painter.setFont(self._bold)
        title = bold.elidedText(self._title, Qt.TextElideMode.ElideRight, left)
        painter.drawText(room, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter, title)


class LegendLine(QLabel):
    """The entries that fit, over as many lines as it is high; the tooltip lists all."""

    def __init__(self) -> None:
        super().__init__()
        self.entries: list[tuple[str, QColor]] = []
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        self.setTextFormat(Qt.TextFormat.RichText)
        self.setWordWrap(True)
        self.setFont(text_font("caption"))
        self._height = self._line_height()

    def setValue(self, entries: list[tuple[str, QColor]]) -> None:
        """Show these entries, the most important first."""
        self.entries = entries
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
        if height != self._height:
            self._height = height
            self.updateGeometry()

    def needed_height(self) -> int:
        """Return the height in pixels that all entries need at the current width, at most `_MAX_LINES` lines."""
        return min(max(self.heightForWidth(self.width()), self._line_height()), _MAX_LINES * self._line_height())

    def _line_height(self) -> int:
        return self.fontMetrics().height()


def level(legends: Sequence[LegendLine]) -> None:
    """Give legends side by side the height of the highest: views of equal height zoom alike."""
    shown = [legend for legend in legends if (view := legend.parentWidget()) is None or not view.isHidden()]
    height = max((legend.needed_height() for legend in shown), default=0)
    for legend in legends:
        legend.set_height(height)
