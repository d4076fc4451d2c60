"""One number: the scale of a slider, a numeric entry that never rounds its value, and both in a row."""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal

from PyQt6.QtCore import QEvent, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QFocusEvent, QKeyEvent, QKeySequence, QMouseEvent, QValidator, QWheelEvent
from PyQt6.QtWidgets import QAbstractSpinBox, QLineEdit, QSlider, QStyle, QStyleOptionSlider, QWidget

from ...core.errors import minus
from ..basics.fields import FieldSpec, format_number
from ..basics.gestures import GestureClock
from ..basics.layouts import hbox


@dataclass(frozen=True)
class Scale:
    """A slider's travel from ``low`` to ``high``; positions are fractions 0 to 1.

    Linear scales snap to multiples of ``step`` from ``low``, logarithmic ones to a hundredth of a decade,
    rounded to three significant digits.
    """

    low: float
    high: float
    step: float = 1.0
    log: bool = False

    def fraction(self, value: float) -> float:
        """Return the position of a value, clamped to the ends."""
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def value(self, fraction: float) -> float:
        """Return the snapped value at a position."""
        fraction = min(max(fraction, 0.0), 1.0)
        if self.log:
            exact = self.low * (self.high / self.low) ** fraction
            return min(max(float(f"{exact:.3g}"), self.low), self.high)
        return self._snapped(self.low + fraction * (self.high - self.low))

    @property
    def positions(self) -> int:
        """Number of steps between the ends."""
        if self.log:
            return round(100 * math.log10(self.high / self.low))
        return max(1, round((self.high - self.low) / self.step))

    def _snapped(self, value: float) -> float:
        steps = round((value - self.low) / self.step)
        # decimal arithmetic keeps 3 x 0.1 from becoming 0.30000000000000004
        exact = Decimal(repr(self.low)) + steps * Decimal(repr(self.step))
        return min(max(float(exact), self.low), self.high)


_Step = QAbstractSpinBox.StepEnabledFlag
_UNDO_KEYS = (QKeySequence.StandardKey.Undo, QKeySequence.StandardKey.Redo)


class NumberEntry(QAbstractSpinBox):
    """A spin box for one number of a preset field.

    The value stays the exact number given to `setValue`; only what a person types or steps changes it.
    Typing takes effect on Enter, which gives the keyboard back to the window, or when the focus leaves; Esc brings back
    the text. Before anything is typed, space bar and comma belong to the window: no number begins with them.

    Signals
    -------
    edited(value: float | int, gesture: int)
    refused(sentence: str)
        What was typed is no number or out of bounds; the old value stays.
    """

    edited = pyqtSignal(object, int)
    refused = pyqtSignal(str)

    def __init__(self, spec: FieldSpec, *, title: str = "", shows_unit: bool = True) -> None:
        super().__init__()
        self._spec = spec
        self._suffix = spec.suffix if shows_unit else ""
        self._title = title or spec.title
        self._value: float | int = round(spec.slider[0]) if spec.integer else spec.slider[0]
        self._typing = False
        self._clock = GestureClock()
        self._edit = self.lineEdit() or QLineEdit(self)
        self._edit.setAlignment(Qt.AlignmentFlag.AlignRight)
        self._edit.textEdited.connect(self._typing_started)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(self._title)
        self.editingFinished.connect(self._commit)
        self._show_value()

    def value(self) -> float | int:
        """Return the exact value."""
        return self._value

    def setValue(self, value: float | int) -> None:
        """Show a value; never emits. Typed text stays unless the value differs."""
        if value == self._value and type(value) is type(self._value):
            return
        self._value = value
        self._show_value()

    def stepBy(self, steps: int) -> None:
        """Move by whole steps of the field, snapping to multiples of it."""
        self._commit()
        step = Decimal(repr(self._spec.step))
        value = Decimal(repr(float(self._value)))
        on_grid = value / step == (value / step).to_integral_value()
        floor = (value / step).to_integral_value(rounding="ROUND_FLOOR")
        target = float((floor + steps + (0 if on_grid or steps > 0 else 1)) * step)
        low = self._spec.step if self._spec.open_minimum else self._spec.minimum
        self._take(min(max(target, low), self._spec.maximum))
        self.selectAll()

    def stepEnabled(self) -> QAbstractSpinBox.StepEnabledFlag:
        """Which arrows can still move."""
        flags = _Step.StepNone
        if self._value < self._spec.maximum:
            flags |= _Step.StepUpEnabled
        if self._value > self._spec.minimum:
            flags |= _Step.StepDownEnabled
        return flags

    def validate(self, text: str | None, position: int) -> tuple[QValidator.State, str, int]:
        """Accept any text; `refused` reports an invalid one once it is entered."""
        return QValidator.State.Acceptable, text or "", position

    def sizeHint(self) -> QSize:
        """Wide enough for the field's own numbers."""
        hint = super().sizeHint()
        frame = hint.width() - self._edit.sizeHint().width()
        widest = max(self.fontMetrics().horizontalAdvance(text) for text in self._sample_texts())
        around = 32 if self.buttonSymbols() != QAbstractSpinBox.ButtonSymbols.NoButtons else 10
        return QSize(widest + around, hint.height()) if frame else hint

    def minimumSizeHint(self) -> QSize:
        """Never cut off a number."""
        return self.sizeHint()

    def event(self, event: QEvent | None) -> bool:
        """Leave undo, redo and the comma to the window unless something was typed."""
        if (
            isinstance(event, QKeyEvent)
            and event.type() == QEvent.Type.ShortcutOverride
            and not self._typing
            and (event.key() == Qt.Key.Key_Comma or any(map(event.matches, _UNDO_KEYS)))
        ):
            event.ignore()
            return False
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Esc restores the text while typing; Enter leaves the field; the space bar is the window's."""
        if event is None:
            return
        if event.key() == Qt.Key.Key_Escape and self._typing:
            self._show_value()
            self.selectAll()
        elif event.key() == Qt.Key.Key_Space and not self._typing:
            event.ignore()
        elif event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self._commit()
            if (window := self.window()) is not None:
                window.setFocus()
        else:
            super().keyPressEvent(event)

    def wheelEvent(self, event: QWheelEvent | None) -> None:
        """Let the panel scroll unless this entry has the focus."""
        if event is not None and not self.hasFocus():
            event.ignore()
            return
        super().wheelEvent(event)

    def focusOutEvent(self, event: QFocusEvent | None) -> None:
        """Leaving ends the burst of keys."""
        super().focusOutEvent(event)
        self._clock.release()

    def _sample_texts(self) -> list[str]:
        spec = self._spec
        ends = (*spec.slider, -spec.step if spec.minimum < 0 else spec.step)
        return [f"{end * spec.factor:.{spec.decimals}f}{self._suffix}" for end in ends]

    def _typing_started(self, _: str) -> None:
        self._typing = True

    def _show_value(self) -> None:
        self._typing = False
        self._edit.setText(self._spec.bare(self._value) + self._suffix)
        self._edit.setCursorPosition(0)
        exact = format_number(self._value * self._spec.factor, 15)
        rounded = "" if exact == self._spec.bare(self._value) else f"Exactly {minus(exact)}{self._spec.suffix}. "
        self.setToolTip(rounded + self._spec.tooltip)

    def _commit(self) -> None:
        if not self._typing:
            return
        text = self._edit.text()
        number = parse_number(text, self._spec.suffix)
        spec = self._spec
        allowed = f"{'above ' if spec.open_minimum else ''}{spec.shown(spec.minimum)} to {spec.shown(spec.maximum)}"
        if number is None:
            self._refuse(f"{self._title}: “{text.strip()}” is not a number; allowed is {allowed}.")
        elif spec.integer and number != int(number):
            self._refuse(f"{self._title}: {text.strip()} is not a whole number; allowed is {allowed}.")
        elif not spec.allows(spec.from_shown(number)):
            self._refuse(
                f"{self._title}: {minus(format_number(number))}{spec.suffix} is out of bounds; allowed is {allowed}."
            )
        else:
            self._clock.release()
            self._take(spec.from_shown(number))
            self._show_value()

    def _take(self, value: float) -> None:
        target: float | int = round(value) if self._spec.integer else value
        if target == self._value:
            return
        self._value = target
        self._show_value()
        self.edited.emit(target, self._clock.number())

    def _refuse(self, sentence: str) -> None:
        self._show_value()
        self.refused.emit(sentence)


def parse_number(text: str, suffix: str = "") -> float | None:
    """Read what a person typed: the unit may be there or not, a comma may be the decimal point.

    Returns None for anything that is no finite number.
    """
    bare = text.strip().removesuffix(suffix.strip()).strip().replace(",", ".").replace("−", "-")
    try:
        number = float(bare)
    except ValueError:
        return None
    return number if abs(number) < 1e300 else None


class JumpSlider(QSlider):
    """A horizontal slider whose handle jumps to where it is pressed and leaves the wheel to the page."""

    def __init__(self) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        self._grip = 0.0
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)

    def mousePressEvent(self, event: QMouseEvent | None) -> None:
        """Grab the handle; first move it here if needed."""
        if event is None or event.button() != Qt.MouseButton.LeftButton:
            return
        x = event.position().x()
        left, length = self.travel()
        handle = left + length * (self.value() - self.minimum()) / max(1, self.maximum() - self.minimum())
        self._grip = x - handle if abs(x - handle) <= self._handle_width() / 2 else 0.0
        self.setSliderDown(True)
        self._move_to(x)

    def mouseMoveEvent(self, event: QMouseEvent | None) -> None:
        """Drag the handle."""
        if event is not None and self.isSliderDown():
            self._move_to(event.position().x())

    def mouseReleaseEvent(self, event: QMouseEvent | None) -> None:
        """Let go."""
        if event is not None and event.button() == Qt.MouseButton.LeftButton:
            self.setSliderDown(False)

    def wheelEvent(self, event: QWheelEvent | None) -> None:
        """Let the panel scroll unless this slider has the focus."""
        if event is not None and not self.hasFocus():
            event.ignore()
            return
        super().wheelEvent(event)

    def travel(self) -> tuple[float, float]:
        """Return the x of the handle's centre at the minimum, and how far it can move, in pixels."""
        width = self._handle_width()
        return width / 2, max(1.0, self.width() - width)

    def _handle_width(self) -> int:
        option = QStyleOptionSlider()
        self.initStyleOption(option)
        style = self.style()
        return style.pixelMetric(QStyle.PixelMetric.PM_SliderLength, option, self) if style else 12

    def _move_to(self, x: float) -> None:
        left, length = self.travel()
        fraction = min(max((x - self._grip - left) / length, 0.0), 1.0)
        self.setValue(self.minimum() + round(fraction * (self.maximum() - self.minimum())))


class NumberSlider(QWidget):
    """Edits one number of a preset field with a slider and an entry; the unit stands beside it.

    `value` is always exactly what was set or what a person chose; the slider only shows the nearest position.

    Signals
    -------
    valueChanged(value)
        On every change.
    edited(value, gesture: int)
        Changed by the user.
    refused(sentence: str)
    """

    valueChanged = pyqtSignal(object)
    edited = pyqtSignal(object, int)
    refused = pyqtSignal(str)

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__()
        self.spec = spec
        self._scale = Scale(*spec.slider, step=spec.step, log=spec.log)
        self._clock = GestureClock()
        self.slider = JumpSlider()
        self.slider.setRange(0, self._scale.positions)
        self.slider.setPageStep(max(1, self._scale.positions // 10))
        self.slider.setMinimumWidth(50)
        self.slider.setAccessibleName(f"{spec.title} slider")
        self.slider.setToolTip(spec.tooltip)
        self.entry = NumberEntry(spec, shows_unit=False)

        hbox((self.slider, 1), self.entry, within=self, margins=0)

        self.slider.sliderPressed.connect(self._clock.hold)
        self.slider.sliderReleased.connect(self._clock.release)
        self.slider.valueChanged.connect(self._slider_moved)
        self.entry.edited.connect(self._entry_edited)
        self.entry.refused.connect(self.refused)
        self._place_slider(self.entry.value())

    @property
    def tab_stops(self) -> list[QWidget]:
        """Focusable widgets, in tab order."""
        return [self.slider, self.entry]

    def value(self) -> float | int:
        """Return the exact value."""
        return self.entry.value()

    def setValue(self, value: float | int) -> None:
        """Show a value; `edited` is not emitted."""
        if value == self.value() and type(value) is type(self.value()):
            return
        self.entry.setValue(value)
        self._place_slider(value)
        self.valueChanged.emit(value)

    def _place_slider(self, value: float) -> None:
        blocked = self.slider.blockSignals(True)
        self.slider.setValue(round(self._scale.fraction(value) * self._scale.positions))
        self.slider.blockSignals(blocked)

    def _slider_moved(self, position: int) -> None:
        value = self._scale.value(position / self._scale.positions)
        target = round(value) if self.spec.integer else value
        if target == self.value():
            return
        self.entry.setValue(target)
        self.valueChanged.emit(target)
        self.edited.emit(target, self._clock.number())

    def _entry_edited(self, value: float | int, gesture: int) -> None:
        self._place_slider(value)
        self.valueChanged.emit(value)
        self.edited.emit(value, gesture)
