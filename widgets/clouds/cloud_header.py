"""The title of a cloud and the number of its points, on one line of any width."""

from __future__ import annotations

import re

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QLabel, QSizePolicy, QWidget

from ..basics.elided_label import ElidedLabel

_MARGIN, _TOP, _GAP = 2, 2, 8
#: What the title's label keeps free around its text.
_TITLE_PADDING = 6


def short_count(count: int) -> str:
    """Return a number in at most four characters up to 999 million: 950, 1.2k, 222k, 1.3M."""
    if count < 1000:
        return str(count)
    value, unit = (count / 1e3, "k") if count < 999_500 else (count / 1e6, "M")
    return f"{value:.1f}{unit}" if value < 9.95 else f"{value:.0f}{unit}"


class CloudHeader(QWidget):
    """Title left, number of points right; where both do not fit, the number is rounded and the title elided.

    The labels are placed by hand: a layout would be done anew through the whole window for each frame.
    """

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
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
        self._value = 0
        self.set_count(0)

    def set_count(self, count: int) -> None:
        """Show another number of points."""
        self._value = count
        self._place()

    def sizeHint(self) -> QSize:
        """One line high, as wide as there is room."""
        return QSize(100, self._title.sizeHint().height() + _TOP)

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        """Choose again what fits."""
        super().resizeEvent(event)
        self._place()

    def _place(self) -> None:
        full = f"{self._value:,} point{'' if self._value == 1 else 's'}"
        metrics = self._count.fontMetrics()
        # As if all digits were the widest one, so that the form does not flicker from frame to frame.
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
        self._count.setToolTip("" if fits else full)
        self._count.setGeometry(_MARGIN + room - needed, _TOP, needed, height)
        self._title.setGeometry(_MARGIN, _TOP, max(0, room - needed - _GAP), height)
