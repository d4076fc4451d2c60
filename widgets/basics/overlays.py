"""What lies over a view: a notice in words, and the wipe between two pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

from PyQt6.QtCore import QEvent, QObject, QPoint, QPointF, QRect, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QFontMetrics, QMouseEvent, QPainter, QPaintEvent, QPalette, QPen
from PyQt6.QtWidgets import QApplication, QWidget

from .controls import push_button, wrapped_label
from .layouts import STRETCH, vbox
from .theme import CASING, text_font

_VEIL_ALPHA, _PLATE_ALPHA = 150, 200


class Notice(QWidget):
    """Words on a plate over a view, with a button if one is offered; ``warns`` dims a picture that is old."""

    def __init__(self, over: QWidget, *, warns: bool = False) -> None:
        super().__init__(over)
        self._warns = warns
        self._words = wrapped_label()
        self._words.setTextFormat(Qt.TextFormat.PlainText)
        self._words.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._words.setProperty("plate", "warning" if warns else "plain")
        self.button = push_button("", "")  # Enter belongs to the dialog that the view is in
        self.button.hide()
        centre = Qt.AlignmentFlag.AlignHCenter
        column = vbox(*([] if warns else [STRETCH]), within=self, margins=8, spacing=12)
        column.addWidget(self._words, 0, centre)
        column.addWidget(self.button, 0, centre)
        column.addStretch(1)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        over.installEventFilter(self)
        self.hide()

    def text(self) -> str:
        return self._words.text()

    def set_text(self, text: str) -> None:
        if text != self.text():
            self._words.setText(text)
            self.setAccessibleName(text)
            self._fit()
            self.setVisible(bool(text))
            self.raise_()

    def offer(self, text: str, tip: str = "") -> None:
        """Show a button below the words, or with an empty text none."""
        if (text, tip) == (self.button.text(), self.button.toolTip()):
            return
        self.button.setText(text)
        self.button.setToolTip(tip)
        self.button.setVisible(bool(text))
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents, not text)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        if isinstance(watched, QWidget) and event is not None and event.type() == QEvent.Type.Resize:
            self.setGeometry(watched.rect())
            self._fit()
        return False

    def _fit(self) -> None:
        """Make the plate as large as its words, which are wrapped to the width of the view."""
        room, flags = QRect(0, 0, max(20, self.width() - 40), 9999), Qt.TextFlag.TextWordWrap
        words = self._words.fontMetrics().boundingRect(room, flags, self.text())
        self._words.setFixedSize(words.size() + QSize(20, 12))

    def paintEvent(self, _: QPaintEvent | None) -> None:
        if self._warns:
            veil = self.palette().color(QPalette.ColorRole.Base)
            veil.setAlpha(_VEIL_ALPHA)
            QPainter(self).fillRect(self.rect(), veil)


#: Distance in screen pixels within which the mouse grabs the line of the wipe.
_REACH: Final = 7.0
_LINE, _PLATE = QColor(255, 255, 255), QColor(0, 0, 0, 165)


@dataclass(frozen=True)
class Wipe:
    """A line at the same share of the width in every view, 1 shows only the left side, and the names of both sides."""

    share: float
    left: str
    right: str

    def column(self, width: int) -> int:
        return min(max(round(self.share * width), 0), width)

    def grabbed(self, x: float, width: float) -> bool:
        return abs(x - self.share * width) <= _REACH


class WipeGrip(QObject):
    """The wipe over a view, which the mouse drags; whoever listens answers with another share."""

    dragged = pyqtSignal(float)  # to this share of the width

    def __init__(self, over: QWidget) -> None:
        super().__init__(over)
        self.wipe: Wipe | None = None
        self._held = self._lit = False
        self._usual = over.cursor()
        over.setMouseTracking(True)
        over.installEventFilter(self)

    def eventFilter(self, over: QObject | None, event: QEvent | None) -> bool:
        if not isinstance(over, QWidget) or not isinstance(event, QMouseEvent):
            return False
        if self.wipe is None:  # it may have ended while it was held
            if self._lit:
                over.setCursor(self._usual)
            self._held = self._lit = False
            return False
        x, width, left = event.position().x(), max(1, over.width()), event.button() == Qt.MouseButton.LeftButton
        held, lit = self._held, self.wipe.grabbed(x, width)
        if event.type() == QEvent.Type.MouseMove and held:
            self.dragged.emit(min(max(x / width, 0.0), 1.0))
        elif event.type() == QEvent.Type.MouseMove and lit != self._lit and not event.buttons():
            self._usual, self._lit = self._usual if self._lit else over.cursor(), lit
            over.setCursor(Qt.CursorShape.SplitHCursor if lit else self._usual)
        elif left:
            self._held = event.type() == QEvent.Type.MouseButtonPress and lit
        return held or self._held


def paint_wipe(painter: QPainter, room: QRectF, wipe: Wipe) -> None:
    """Paint the line with a grip, and in each side's outer corner its name, or its letter."""
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    x = room.left() + wipe.column(round(room.width()))
    if 0 < wipe.share < 1:
        for color, width in ((CASING, 4.0), (_LINE, 2.0)):
            painter.setPen(QPen(color, width))
            painter.drawLine(QPointF(x, room.top()), QPointF(x, room.bottom()))
            painter.setBrush(_LINE)
            painter.drawEllipse(QPointF(x, room.center().y()), 5.0, 5.0)
    painter.setFont(text_font("caption"))
    left, right = QRectF(room), QRectF(room)
    left.setRight(x)
    right.setLeft(x)
    for side, name, corner in (
        (left, wipe.left, Qt.AlignmentFlag.AlignLeft),
        (right, wipe.right, Qt.AlignmentFlag.AlignRight),
    ):
        inner = side.adjusted(11, 7, -11, 0)
        metrics, letter = painter.fontMetrics(), name.partition(":")[0]
        text = next((each for each in (name, letter) if metrics.horizontalAdvance(each) <= inner.width()), "")
        if not text:
            continue
        words = painter.boundingRect(inner, corner | Qt.AlignmentFlag.AlignTop, text)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(_PLATE)
        painter.drawRoundedRect(words.adjusted(-5, -1, 5, 1), 3.0, 3.0)
        painter.setPen(_LINE)
        painter.drawText(words, 0, text)


class Reading(NamedTuple):
    """A number that stands on a view, what it is, and its widest text: so its neighbours keep their place."""

    value: str
    caption: str
    widest: str


def paint_readings(painter: QPainter, size: QSize, readings: tuple[Reading, ...]) -> None:
    """Paint numbers in large type, each over its caption, on a plate over the top of a view."""
    places, band = _places(size, tuple((words, widest) for _, words, widest in readings))
    palette = QApplication.palette()
    plate = palette.color(QPalette.ColorRole.Base)
    plate.setAlpha(_PLATE_ALPHA)
    painter.fillRect(band, plate)
    number = text_font("title", bold=True), QPalette.ColorRole.Text
    caption = text_font("caption"), QPalette.ColorRole.PlaceholderText
    for line, (font, role) in enumerate((number, caption)):
        painter.setFont(font)
        painter.setPen(palette.color(role))
        for place, reading in zip(places, readings, strict=False):
            painter.drawText(place[line], reading[line])


@lru_cache(maxsize=2)
def _places(size: QSize, entries: tuple[tuple[str, str], ...]) -> tuple[list[tuple[QPoint, QPoint]], QRect]:
    """Return where each number and its caption begin, and the band that they fill; entries as in `Reading`.

    They take as many rows as they need; the last ones are left out where they would cover half of the view.
    """
    numbers, captions = QFontMetrics(text_font("title", bold=True)), QFontMetrics(text_font("caption"))
    left, gap, height = 8, 12, numbers.height() + captions.height() + 4
    widths = [max(numbers.horizontalAdvance(widest), captions.horizontalAdvance(words)) for words, widest in entries]
    total = left + sum(widths) + gap * len(widths)
    share = total / math.ceil(total / max(1, size.width()))  # rows are about equally long
    places: list[tuple[QPoint, QPoint]] = []
    x, y = left, 4
    for taken in widths:
        if x > left and (x + taken >= size.width() or x > share):
            x, y = left, y + height
            if y + height > size.height() / 2:
                y -= height
                break
        below = y + numbers.height() - 1 + captions.ascent()
        places.append((QPoint(x, y + numbers.ascent()), QPoint(x, below)))
        x += taken + gap
    return places, QRect(0, 0, size.width(), y + height)
