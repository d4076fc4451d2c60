"""Ranges and rectangles: a slider with two handles, and the editors for two and for four numbers."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QEvent, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import (
    QColor,
    QFocusEvent,
    QKeyEvent,
    QLinearGradient,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPalette,
    QPen,
)
from PyQt6.QtWidgets import QAbstractSpinBox, QSizePolicy, QWidget

from ..basics.controls import caption
from ..basics.fields import FieldSpec
from ..basics.gestures import GestureClock
from ..basics.layouts import hbox
from .number_slider import NumberEntry, Scale

Span = tuple[int, int]


def groove_colors(hue: Span, saturation: Span, value: Span) -> dict[str, list[QColor]]:
    """Return the colours along the grooves of hue, saturation and value, by these names.

    Saturation and value are shown at the centre of the hue range, OpenCV's 8-bit convention.
    """
    middle = (hue[0] + ((hue[1] - hue[0]) % 180) // 2) % 180
    typical_saturation, typical_value = sum(saturation) // 2, sum(value) // 2
    return {
        "hue": [QColor.fromHsv(2 * (h % 180), 230, 230) for h in range(0, 180, 15)] + [QColor.fromHsv(358, 230, 230)],
        "saturation": [QColor.fromHsv(2 * middle, s, max(typical_value, 120)) for s in range(0, 256, 51)],
        "value": [QColor.fromHsv(2 * middle, typical_saturation, v) for v in range(0, 256, 51)],
    }


_HANDLE_WIDTH = 10.0
_HANDLE_HEIGHT = 18.0
_GROOVE_HEIGHT = 8.0
_BAND = 2  # what is gripped when it is neither handle 0 nor handle 1

Band = tuple[float, float]


class BandSlider(QWidget):
    """Two handles on one groove.

    Drag a handle, or the band between them to move both. With ``wraps`` the handles may cross: a low end above
    the high end means the band from the low end over the top to the high end, and moving the band rotates it.
    Otherwise the ends stay at least ``gap`` apart.
    Tab goes from the low handle to the high one; arrows, PageUp, PageDown, Home and End move the one in focus.

    Signals
    -------
    edited(low: float, high: float, gesture: int)
        Changed by the user.
    """

    edited = pyqtSignal(float, float, int)

    def __init__(self, scale: Scale, *, wraps: bool = False, gap: float = 0.0) -> None:
        super().__init__()
        self._scale = scale
        self._wraps = wraps
        self._gap = scale.fraction(scale.low + gap)
        self._band: Band = (scale.low, scale.high)
        self._colors: list[QColor] = []
        self._active = 0
        self._gripped: int | None = None
        self._grip_fraction = 0.0
        self._grip_band = self._band
        self._hovered: int | None = None
        self._clock = GestureClock()
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def value(self) -> Band:
        """Return (low, high)."""
        return self._band

    def setValue(self, low: float, high: float) -> None:
        """Show a band; never emits."""
        if (low, high) != self._band:
            self._band = (low, high)
            self.update()

    def set_colors(self, colors: Sequence[QColor]) -> None:
        """Paint the groove with colours spread evenly from the low end to the high end."""
        if list(colors) != self._colors:
            self._colors = list(colors)
            self.update()

    def wrapped(self) -> bool:
        """Whether the band wraps around now."""
        return self._wraps and self._band[0] > self._band[1]

    def sizeHint(self) -> QSize:
        """As high as a handle."""
        return QSize(120, 22)

    def minimumSizeHint(self) -> QSize:
        """Room for both handles and some travel."""
        return QSize(40, 22)

    def handle_x(self, handle: int) -> float:
        """Return the x of a handle's centre in pixels."""
        left, length = self._travel()
        return left + length * self._scale.fraction(self._band[handle])

    # --- mouse -------------------------------------------------------------------------------------------------

    def mousePressEvent(self, event: QMouseEvent | None) -> None:
        """Grip a handle or the band; a press outside brings the nearer handle here."""
        if event is None or event.button() != Qt.MouseButton.LeftButton:
            return
        x = event.position().x()
        self._gripped = self._part_at(x)
        handle = self._nearer_handle(x) if self._gripped is None else self._gripped
        outside = self._gripped is None
        self._gripped = handle
        if handle != _BAND:
            self._active = handle
        self._grip_band = self._band
        self._clock.hold()
        self._grip_fraction = self._scale.fraction(self._band[handle]) if outside else self._fraction_at(x)
        self._drag_to(x)
        self.update()

    def mouseMoveEvent(self, event: QMouseEvent | None) -> None:
        """Drag, or show what a press here would grip."""
        if event is None:
            return
        if self._gripped is not None:
            self._drag_to(event.position().x())
            return
        hovered = self._part_at(event.position().x())
        if hovered != self._hovered:
            self._hovered = hovered
            self.setCursor(Qt.CursorShape.SizeHorCursor if hovered == _BAND else Qt.CursorShape.ArrowCursor)
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent | None) -> None:
        """Let go."""
        if event is not None and event.button() == Qt.MouseButton.LeftButton:
            self._gripped = None
            self._clock.release()
            self.update()

    def leaveEvent(self, event: QEvent | None) -> None:
        """Nothing is under the mouse any more."""
        self._hovered = None
        self.update()
        super().leaveEvent(event)

    # --- keyboard ----------------------------------------------------------------------------------------------

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Move the handle in focus."""
        if event is None:
            return
        page = max(1, self._scale.positions // 10)
        steps = {
            Qt.Key.Key_Left: -1,
            Qt.Key.Key_Down: -1,
            Qt.Key.Key_Right: 1,
            Qt.Key.Key_Up: 1,
            Qt.Key.Key_PageDown: -page,
            Qt.Key.Key_PageUp: page,
            Qt.Key.Key_Home: -self._scale.positions,
            Qt.Key.Key_End: self._scale.positions,
        }.get(Qt.Key(event.key()))
        if steps is None:
            super().keyPressEvent(event)
            return
        position = round(self._scale.fraction(self._band[self._active]) * self._scale.positions) + steps
        self._move_handle(self._active, position / self._scale.positions)

    def focusNextPrevChild(self, forward: bool) -> bool:
        """Tab goes through both handles."""
        target = self._active + (1 if forward else -1)
        if target in (0, 1):
            self._active = target
            self._clock.release()
            self.update()
            return True
        return super().focusNextPrevChild(forward)

    def focusInEvent(self, event: QFocusEvent | None) -> None:
        """Enter at the handle that Tab or Shift+Tab comes to first."""
        if event is not None and event.reason() == Qt.FocusReason.TabFocusReason:
            self._active = 0
        if event is not None and event.reason() == Qt.FocusReason.BacktabFocusReason:
            self._active = 1
        super().focusInEvent(event)

    def focusOutEvent(self, event: QFocusEvent | None) -> None:
        """Leaving ends the burst of keys."""
        self._clock.release()
        super().focusOutEvent(event)

    # --- geometry ----------------------------------------------------------------------------------------------

    def _travel(self) -> tuple[float, float]:
        return _HANDLE_WIDTH / 2 + 1, max(1.0, self.width() - _HANDLE_WIDTH - 2)

    def _fraction_at(self, x: float) -> float:
        left, length = self._travel()
        return (x - left) / length

    def _nearer_handle(self, x: float) -> int:
        return min((0, 1), key=lambda handle: abs(x - self.handle_x(handle)))

    def _part_at(self, x: float) -> int | None:
        nearer = self._nearer_handle(x)
        low_x, high_x = self.handle_x(0), self.handle_x(1)
        if low_x == high_x and abs(x - low_x) <= _HANDLE_WIDTH / 2 + 2:
            # both handles on one spot: take the one that can move towards the mouse
            return 0 if x < low_x or (x == low_x and self._band[1] >= self._scale.high) else 1
        if abs(x - self.handle_x(nearer)) <= _HANDLE_WIDTH / 2 + 2:
            return nearer
        if self.wrapped():
            return _BAND if x < high_x or x > low_x else None
        return _BAND if low_x < x < high_x else None

    def _drag_to(self, x: float) -> None:
        if self._gripped == _BAND:
            self._move_band(self._fraction_at(x) - self._grip_fraction)
        elif self._gripped is not None:
            start = self._scale.fraction(self._grip_band[self._gripped])
            self._move_handle(self._gripped, start + self._fraction_at(x) - self._grip_fraction)

    def _move_handle(self, handle: int, fraction: float) -> None:
        low, high = self._band
        if not self._wraps and handle == 0:
            fraction = min(fraction, self._scale.fraction(high) - self._gap)
        elif not self._wraps:
            fraction = max(fraction, self._scale.fraction(low) + self._gap)
        value = self._scale.value(fraction)
        self._take((value, high) if handle == 0 else (low, value))

    def _move_band(self, by: float) -> None:
        start = [self._scale.fraction(end) for end in self._grip_band]
        if self._wraps:
            count = self._scale.positions + 1
            shift = round(by * self._scale.positions)
            ends = [(round(end * self._scale.positions) + shift) % count / self._scale.positions for end in start]
        else:
            by = min(max(by, -start[0]), 1.0 - start[1])
            ends = [end + by for end in start]
        if by != 0.0:
            self._take((self._scale.value(ends[0]), self._scale.value(ends[1])))

    def _take(self, band: Band) -> None:
        if band != self._band:
            self._band = band
            self.update()
            self.edited.emit(*band, self._clock.number())

    # --- painting ----------------------------------------------------------------------------------------------

    def paintEvent(self, _: QPaintEvent | None) -> None:
        """Paint the groove, the band and the handles."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        group = QPalette.ColorGroup.Normal if self.isEnabled() else QPalette.ColorGroup.Disabled
        palette = self.palette()
        left, length = self._travel()
        middle = self.height() / 2
        groove = QRectF(left, middle - _GROOVE_HEIGHT / 2, length, _GROOVE_HEIGHT)
        border = palette.color(group, QPalette.ColorRole.Mid)
        accent = palette.color(group, QPalette.ColorRole.Highlight)

        painter.setPen(QPen(border, 1.0))
        painter.setBrush(self._groove_brush(groove, palette.color(group, QPalette.ColorRole.Base)))
        painter.drawRoundedRect(groove, 3, 3)
        if self._colors:
            faded = palette.color(group, QPalette.ColorRole.Window)
            faded.setAlpha(190 if self.isEnabled() else 220)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(faded)
            for span in self._spans(groove, inside=False) if self.isEnabled() else [groove]:
                painter.drawRect(span.adjusted(0, 0.5, 0, -0.5))
        for span in self._spans(groove, inside=True):
            painter.setPen(QPen(accent, 1.5) if self._colors else Qt.PenStyle.NoPen)
            painter.setBrush(Qt.BrushStyle.NoBrush if self._colors else accent)
            painter.drawRect(span)
        for handle in (1 - self._active, self._active):
            self._paint_handle(painter, handle, middle, palette, group)

    def _groove_brush(self, groove: QRectF, plain: QColor) -> QColor | QLinearGradient:
        if not self._colors:
            return plain
        gradient = QLinearGradient(groove.topLeft(), groove.topRight())
        for index, color in enumerate(self._colors):
            gradient.setColorAt(index / max(1, len(self._colors) - 1), color)
        return gradient

    def _spans(self, groove: QRectF, *, inside: bool) -> list[QRectF]:
        """Return the parts of the groove inside or outside the band."""
        low, high = self.handle_x(0), self.handle_x(1)
        start, end = groove.left(), groove.right()
        middle = [(min(low, high), max(low, high))]
        rest = [(start, min(low, high)), (max(low, high), end)]
        parts = middle if inside != self.wrapped() else rest
        return [QRectF(a, groove.top(), b - a, groove.height()) for a, b in parts]

    def _paint_handle(
        self, painter: QPainter, handle: int, middle: float, palette: QPalette, group: QPalette.ColorGroup
    ) -> None:
        body = QRectF(
            self.handle_x(handle) - _HANDLE_WIDTH / 2, middle - _HANDLE_HEIGHT / 2, _HANDLE_WIDTH, _HANDLE_HEIGHT
        )
        focused = self.hasFocus() and handle == self._active
        lit = handle in (self._hovered, self._gripped)
        fill = palette.color(group, QPalette.ColorRole.Button)
        outline = palette.color(group, QPalette.ColorRole.WindowText)
        if not focused:
            outline.setAlpha(150)
        painter.setPen(QPen(palette.color(QPalette.ColorRole.Highlight) if focused else outline, 2.0 if focused else 1))
        painter.setBrush(fill.lighter(115) if lit else fill)
        painter.drawRoundedRect(body.adjusted(0.5, 0.5, -0.5, -0.5), 3, 3)


Numbers = tuple[float, ...]


class _Entries(QWidget):
    """Numeric entries for a tuple; the base of the editors below.

    Signals
    -------
    valueChanged(value: tuple)
        On every change.
    edited(value: tuple, gesture: int)
        Changed by the user.
    refused(sentence: str)
    """

    valueChanged = pyqtSignal(object)
    edited = pyqtSignal(object, int)
    refused = pyqtSignal(str)

    def __init__(self, spec: FieldSpec, names: Sequence[str]) -> None:
        super().__init__()
        self.spec = spec
        self.entries = [NumberEntry(spec, title=f"{spec.title}, {name}", shows_unit=False) for name in names]
        for entry in self.entries:
            entry.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)
            entry.edited.connect(self._entry_edited)
            entry.refused.connect(self.refused)
        self._value: Numbers = tuple(spec.default)
        for entry, number in zip(self.entries, self._value, strict=True):
            entry.setValue(number)

    @property
    def tab_stops(self) -> list[QWidget]:
        """Focusable widgets, in tab order."""
        return list(self.entries)

    def value(self) -> Numbers:
        """Return the exact numbers."""
        return self._value

    def setValue(self, value: Sequence[float]) -> None:
        """Show numbers; `edited` is not emitted."""
        target = tuple(value)
        if target != self._value:
            self._show(target)
            self.valueChanged.emit(target)

    def _show(self, value: Numbers) -> None:
        self._value = value
        for entry, number in zip(self.entries, value, strict=True):
            entry.setValue(number)

    def _entry_edited(self, _: object, gesture: int) -> None:
        self._take(tuple(entry.value() for entry in self.entries), gesture)

    def _take(self, value: Numbers, gesture: int) -> None:
        self._show(value)
        self.valueChanged.emit(value)
        self.edited.emit(value, gesture)


class RangeEditor(_Entries):
    """A low and a high end: entry, slider with two handles, entry."""

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__(spec, ("low end", "high end"))
        # whole numbers may coincide (one hue); a range of lengths must not be empty
        gap = 0.0 if spec.integer else spec.step
        self.slider = BandSlider(Scale(*spec.slider, step=spec.step, log=spec.log), wraps=spec.wraps, gap=gap)
        self.slider.setAccessibleName(f"{spec.title} slider")
        self.slider.setToolTip(spec.tooltip)
        self.slider.setValue(*self._value)
        self.slider.edited.connect(self._slider_edited)
        hbox(self.entries[0], (self.slider, 1), self.entries[1], within=self, margins=0, spacing=4)

    @property
    def tab_stops(self) -> list[QWidget]:
        """Focusable widgets, in tab order."""
        return [self.entries[0], self.slider, self.entries[1]]

    def set_colors(self, colors: Sequence[QColor]) -> None:
        """Paint the groove with the colours that its positions mean."""
        self.slider.set_colors(colors)

    def _show(self, value: Numbers) -> None:
        super()._show(value)
        self.slider.setValue(value[0], value[1])

    def _slider_edited(self, low: float, high: float, gesture: int) -> None:
        self._take((round(low), round(high)) if self.spec.integer else (low, high), gesture)


class RectangleEditor(_Entries):
    """Left, top, width and height."""

    def __init__(self, spec: FieldSpec) -> None:
        names = ("left", "top", "width", "height")
        super().__init__(spec, names)
        layout = hbox(within=self, margins=0, spacing=4)
        for text, entry in zip(("x", "y", "w", "h"), self.entries, strict=True):
            layout.addWidget(caption(text, entry))
            layout.addWidget(entry, 1)
