"""A slider with one handle for a number, or with two for a range; and the scale along its groove."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from PyQt6.QtCore import QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import (
    QColor,
    QFocusEvent,
    QKeyEvent,
    QLinearGradient,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QWheelEvent,
)
from PyQt6.QtWidgets import QSizePolicy, QWidget

from ..basics.controls import GestureClock
from ..basics.theme import theme_colors

_RADIUS = 6.0
#: Distance in pixels within which the mouse grips a handle.
_REACH = 8.0
_GROOVE, _COLORED_GROOVE = 4.0, 8.0

Values = tuple[float, ...]


@dataclass(frozen=True)
class Scale:
    """A slider's travel, ``low`` to ``high``; linear ones snap to steps, logarithmic ones to 0.01 decades."""

    low: float
    high: float
    step: float = 1.0
    log: bool = False

    def fraction(self, value: float) -> float:
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def value(self, fraction: float) -> float:
        fraction = min(max(fraction, 0.0), 1.0)
        if self.log:
            exact = float(f"{self.low * (self.high / self.low) ** fraction:.3g}")
        else:
            steps = round(fraction * (self.high - self.low) / self.step)
            exact = float(f"{self.low + steps * self.step:.12g}")  # 3 x 0.1 is 0.3
        return min(max(exact, self.low), self.high)

    @property
    def positions(self) -> int:
        if self.log:
            return round(100 * math.log10(self.high / self.low))
        return max(1, round((self.high - self.low) / self.step))


class Slider(QWidget):
    """One handle, or two with a band between them.

    A press beside a handle brings the nearer one. With ``wraps`` the handles may cross: the band then goes from the
    low end over the top to the high end. Otherwise they stay at least ``gap`` apart. Tab goes from the low handle to
    the high one.
    """

    edited = pyqtSignal(object, int)  # values, gesture: changed by the user

    def __init__(self, scale: Scale, handles: int = 1, *, wraps: bool = False, gap: float = 0.0) -> None:
        super().__init__()
        self._scale = scale
        self._wraps = wraps
        self._gap = scale.fraction(scale.low + gap)
        self.values: Values = (scale.low, scale.high)[:handles]
        self._colors: list[QColor] = []
        self._active = 0
        self._grip_px = 0.0  # from the handle's centre to the mouse
        self.clock = GestureClock()
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def set_values(self, *values: float) -> None:
        if values != self.values:
            self.values = values
            self.update()

    def set_colors(self, colors: Sequence[QColor]) -> None:
        """Paint the groove with colours spread evenly from the low end to the high end."""
        if list(colors) != self._colors:
            self._colors = list(colors)
            self.update()

    def wrapped(self) -> bool:
        return self._wraps and self.values[0] > self.values[-1]

    def sizeHint(self) -> QSize:
        return QSize(120, 22)

    def minimumSizeHint(self) -> QSize:
        return QSize(36, 22)

    def travel(self) -> tuple[float, float]:
        """Return the x of a handle's centre at the minimum, and how far it can move, in pixels."""
        return _RADIUS + 1, max(1.0, self.width() - 2 * _RADIUS - 2)

    def handle_x(self, handle: int) -> float:
        left, length = self.travel()
        return left + length * self._scale.fraction(self.values[handle])

    # Mouse

    def mousePressEvent(self, event: QMouseEvent | None) -> None:
        if event is None or event.button() != Qt.MouseButton.LeftButton:
            return
        x = event.position().x()
        self._active = self._nearer_handle(x)
        self._grip_px = x - self.handle_x(self._active)
        if abs(self._grip_px) > _REACH:
            self._grip_px = 0.0
        self.clock.hold()
        self._drag_to(x)
        self.update()

    def mouseMoveEvent(self, event: QMouseEvent | None) -> None:
        if event is not None and self.clock.held:
            self._drag_to(event.position().x())

    def mouseReleaseEvent(self, event: QMouseEvent | None) -> None:
        if event is not None and event.button() == Qt.MouseButton.LeftButton:
            self.clock.release()
            self.update()

    def wheelEvent(self, event: QWheelEvent | None) -> None:
        if event is not None and self.hasFocus():
            self._step(1 if event.angleDelta().y() > 0 else -1)
        elif event is not None:
            event.ignore()

    # Keyboard

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        assert event is not None
        page, all_of_it = max(1, self._scale.positions // 10), self._scale.positions
        key = Qt.Key
        steps = {key.Key_Left: -1, key.Key_Down: -1, key.Key_Right: 1, key.Key_Up: 1}
        steps |= {key.Key_PageDown: -page, key.Key_PageUp: page, key.Key_Home: -all_of_it, key.Key_End: all_of_it}
        if event.key() in steps:
            self._step(steps[key(event.key())])
        else:
            super().keyPressEvent(event)

    def focusNextPrevChild(self, forward: bool) -> bool:
        target = self._active + (1 if forward else -1)
        if 0 <= target < len(self.values):
            self._active = target
            self.clock.release()
            self.update()
            return True
        return super().focusNextPrevChild(forward)

    def focusInEvent(self, event: QFocusEvent | None) -> None:
        if event is not None and event.reason() == Qt.FocusReason.TabFocusReason:
            self._active = 0
        if event is not None and event.reason() == Qt.FocusReason.BacktabFocusReason:
            self._active = len(self.values) - 1
        super().focusInEvent(event)

    def focusOutEvent(self, event: QFocusEvent | None) -> None:
        self.clock.release()
        super().focusOutEvent(event)

    # Moving

    def _nearer_handle(self, x: float) -> int:
        low_x, high_x = self.handle_x(0), self.handle_x(-1)
        if len(self.values) == 2 and low_x == high_x:  # take the handle that can move towards the mouse
            return 0 if x < low_x or self.values[1] >= self._scale.high else 1
        return int(abs(x - high_x) < abs(x - low_x))

    def _drag_to(self, x: float) -> None:
        left, length = self.travel()
        self._move_handle((x - self._grip_px - left) / length)

    def _step(self, steps: int) -> None:
        position = round(self._scale.fraction(self.values[self._active]) * self._scale.positions) + steps
        self._move_handle(position / self._scale.positions)

    def _move_handle(self, fraction: float) -> None:
        handle, positions = self._active, self._scale.positions
        now = self._scale.fraction(self.values[handle])
        if round(min(max(fraction, 0.0), 1.0) * positions) == round(now * positions):
            return  # a value between two positions stays exactly what it is
        if not self._wraps and len(self.values) == 2:
            if handle == 0:
                fraction = min(fraction, self._scale.fraction(self.values[1]) - self._gap)
            else:
                fraction = max(fraction, self._scale.fraction(self.values[0]) + self._gap)
        value = self._scale.value(fraction)
        values = tuple(value if number == handle else kept for number, kept in enumerate(self.values))
        if values != self.values:
            self.values = values
            self.update()
            self.edited.emit(values, self.clock.number())

    # Painting

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter, colors = QPainter(self), theme_colors()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        left, length = self.travel()
        centre, enabled = self.height() / 2, self.isEnabled()
        height = _COLORED_GROOVE if self._colors else _GROOVE
        accent = QColor(colors.accent if enabled else colors.border)
        low, high = left if len(self.values) == 1 else self.handle_x(0), self.handle_x(-1)
        inside, outside = [(low, high)], [(left, low), (high, left + length)]
        if self.wrapped():
            inside, outside = [(left, high), (low, left + length)], [(high, low)]

        def span(start: float, end: float) -> QRectF:
            return QRectF(start, centre - height / 2, end - start, height)

        groove = span(left, left + length)
        if self._colors:
            gradient = QLinearGradient(groove.topLeft(), groove.topRight())
            for index, color in enumerate(self._colors):
                gradient.setColorAt(index / max(1, len(self._colors) - 1), color)
            painter.setBrush(gradient)
            painter.drawRoundedRect(groove, 3, 3)
            faded = QColor(colors.window)
            faded.setAlpha(200)
            for ends in outside if enabled else [(left, left + length)]:
                painter.fillRect(span(*ends), faded)
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.setPen(QPen(accent, 1.5))
        else:
            painter.setBrush(QColor(colors.outline if enabled else colors.border))
            painter.drawRoundedRect(groove, height / 2, height / 2)
            painter.setBrush(accent)
        corner = 0.0 if self._colors else height / 2
        for ends in inside:
            painter.drawRoundedRect(span(*ends), corner, corner)
        painter.setPen(QPen(accent, 2.0))
        for handle in range(len(self.values)):
            lit = enabled and handle == self._active and (self.clock.held or self.hasFocus())
            painter.setBrush(QColor(colors.accent if lit else colors.knob if enabled else colors.button))
            painter.drawEllipse(QPointF(self.handle_x(handle), centre), _RADIUS, _RADIUS)
        painter.end()
