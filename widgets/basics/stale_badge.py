"""Marks a picture as old: dims it and shows the reason on a plate."""

from __future__ import annotations

from PyQt6.QtCore import QRectF, Qt
from PyQt6.QtGui import QColor, QFont, QPainter, QPaintEvent, QPalette, QPen
from PyQt6.QtWidgets import QWidget

from .colormaps import palette_theme

_VEIL_ALPHA = 150
_MARGIN, _PADDING_X, _PADDING_Y = 6.0, 8.0, 4.0

#: Plate, border and text; text on plate has a contrast of at least 7.
BADGE_COLORS = {
    "light": ("#fff1cc", "#b97700", "#4a3000"),
    "dark": ("#3b2d0c", "#d99a1e", "#ffdf9e"),
}


def paint_badge(painter: QPainter, area: QRectF, palette: QPalette, font: QFont, text: str) -> None:
    """Dim ``area`` and write ``text`` on a plate at its upper edge."""
    plate, border, ink = (QColor(value) for value in BADGE_COLORS[palette_theme(palette)])
    veil = palette.color(QPalette.ColorRole.Base)
    veil.setAlpha(_VEIL_ALPHA)
    painter.fillRect(area, veil)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setFont(font)
    flags = int(Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop | Qt.TextFlag.TextWordWrap)
    x, y = _MARGIN + _PADDING_X, _MARGIN + _PADDING_Y
    room = area.adjusted(x, y, -x, -y)
    words = painter.boundingRect(room, flags, text)
    painter.setPen(QPen(border, 1.0))
    painter.setBrush(plate)
    painter.drawRoundedRect(words.adjusted(-_PADDING_X, -_PADDING_Y, _PADDING_X, _PADDING_Y), 4.0, 4.0)
    painter.setPen(ink)
    painter.drawText(room, flags, text)


class StaleBadge(QWidget):
    """A transparent overlay that ignores the mouse; hidden while its text is empty."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self._text = ""
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.hide()

    def text(self) -> str:
        return self._text

    def set_text(self, text: str) -> None:
        if text == self._text:
            return
        self._text = text
        parent = self.parentWidget()
        if parent is not None:
            self.setGeometry(parent.rect())
        self.setVisible(bool(text))
        self.raise_()
        self.update()

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter = QPainter(self)
        paint_badge(painter, QRectF(self.rect()), self.palette(), self.font(), self._text)
        painter.end()
