"""The widgets that edit one field: numbers exactly by entry and slider, choices, flags; and what shows a matrix.

Each has ``value``, ``setValue``, which never emits, and the signal ``edited(value, gesture)``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from PyQt6.QtCore import QEvent, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QFocusEvent, QFontDatabase, QKeyEvent, QKeySequence, QValidator, QWheelEvent
from PyQt6.QtWidgets import QAbstractSpinBox, QCheckBox, QComboBox, QLabel, QLineEdit, QWidget

from ...core.errors import minus
from ..basics.controls import GestureClock, caption, named, new_gesture
from ..basics.fields import FieldSpec, format_number
from ..basics.layouts import Part, hbox
from ..basics.theme import text_font
from .slider import Scale, Slider

_UNDO_KEYS = (QKeySequence.StandardKey.Undo, QKeySequence.StandardKey.Redo)


class NumberEntry(QAbstractSpinBox):
    """A spin box for one number of a preset field.

    The value stays the exact number given to `setValue`; only what a person types or steps changes it.
    Typing takes effect on Enter, which gives the keyboard back to the window, or when the focus leaves; Esc brings back
    the text. Before anything is typed, space bar and comma belong to the window: no number begins with them.
    """

    edited = pyqtSignal(object, int)  # value, gesture
    refused = pyqtSignal(str)  # sentence: what was typed is no number or out of bounds; the old value stays

    def __init__(self, spec: FieldSpec, *, title: str) -> None:
        super().__init__()
        self._spec = spec
        self._title = title
        self._value: float | int = round(spec.slider[0]) if spec.integer else spec.slider[0]
        self._typing = False
        self._clock = GestureClock()
        self._edit = self.lineEdit() or QLineEdit(self)
        self._edit.setAlignment(Qt.AlignmentFlag.AlignRight)
        self._edit.textEdited.connect(lambda _: setattr(self, "_typing", True))
        self.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)  # the room is the slider's; keys step
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(self._title)
        self.editingFinished.connect(self._commit)
        self._show_value()

    def value(self) -> float | int:
        return self._value

    def setValue(self, value: float | int) -> None:
        if value == self._value and type(value) is type(self._value):
            return
        self._value = value
        self._show_value()

    def stepBy(self, steps: int) -> None:
        self._commit()
        step, place = self._spec.step, self._value / self._spec.step
        start = math.floor(place + 1e-9) if steps > 0 else math.ceil(place - 1e-9)
        target = float(f"{(start + steps) * step:.12g}")  # 3 x 0.1 is 0.3
        low = step if self._spec.open_minimum else self._spec.minimum
        self._take(min(max(target, low), self._spec.maximum))
        self.selectAll()

    def stepEnabled(self) -> QAbstractSpinBox.StepEnabledFlag:
        step = QAbstractSpinBox.StepEnabledFlag
        return step.StepUpEnabled | step.StepDownEnabled  # `stepBy` stops at the ends

    def validate(self, text: str | None, position: int) -> tuple[QValidator.State, str, int]:
        """Accept any text; `refused` reports an invalid one once it is entered."""
        return QValidator.State.Acceptable, text or "", position

    def sizeHint(self) -> QSize:
        spec = self._spec
        ends = (*spec.slider, -spec.step if spec.minimum < 0 else spec.step)
        texts = [f"{end * spec.factor:.{spec.decimals}f}" for end in ends]
        return QSize(max(map(self.fontMetrics().horizontalAdvance, texts)) + 8, super().sizeHint().height())

    minimumSizeHint = sizeHint

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
        assert event is not None
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
        if event is not None and not self.hasFocus():
            event.ignore()
            return
        super().wheelEvent(event)

    def focusOutEvent(self, event: QFocusEvent | None) -> None:
        super().focusOutEvent(event)
        self._clock.release()

    def _show_value(self) -> None:
        self._typing = False
        self._edit.setText(self._spec.bare(self._value))
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
        allowed = number is not None and spec.allows(number / spec.factor) and not (spec.integer and number % 1)
        if allowed and number is not None:
            self._clock.release()
            self._take(spec.from_shown(number))
        self._show_value()
        if not allowed:
            self.refused.emit(
                f"{self._title}: “{text.strip()}” is not allowed, but a {'whole ' if spec.integer else ''}number "
                f"{'above' if spec.open_minimum else 'from'} {spec.shown(spec.minimum)} to {spec.shown(spec.maximum)}."
            )

    def _take(self, value: float) -> None:
        target: float | int = round(value) if self._spec.integer else value
        if target == self._value:
            return
        self._value = target
        self._show_value()
        self.edited.emit(target, self._clock.number())


def parse_number(text: str, suffix: str = "") -> float | None:
    """Return the number that a person typed, with or without its unit, with a point or a comma; None if it is none."""
    bare = text.strip().removesuffix(suffix.strip()).strip().replace(",", ".").replace("−", "-")
    try:
        number = float(bare)
    except ValueError:
        return None
    return number if abs(number) < 1e300 else None


_NAMES = {
    "number": ("",),
    "range": (", low end", ", high end"),
    "rectangle": (", left", ", top", ", width", ", height"),
}


class NumbersEditor(QWidget):
    """Edits one number, both ends of a range or a rectangle: an entry for each, and a slider for the first two.

    `value` is always exactly what was set or what a person chose; the slider only shows the nearest position.
    """

    edited = pyqtSignal(object, int)  # value, gesture: changed by the user
    refused = pyqtSignal(str)  # sentence

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__()
        self.spec = spec
        self.entries = [NumberEntry(spec, title=spec.title + name) for name in _NAMES[spec.kind]]
        self.entry = self.entries[0]
        self.slider: Slider | None = None
        for entry in self.entries:
            entry.edited.connect(lambda _, gesture: self._take([entry.value() for entry in self.entries], gesture))
            entry.refused.connect(self.refused)
        parts: list[Part] = list(self.entries)
        if spec.kind == "rectangle":
            lettered = zip("xywh", self.entries, strict=True)
            parts = [part for letter, entry in lettered for part in (caption(letter, entry), (entry, 1))]
        else:
            # whole numbers may coincide (one hue); a range of lengths must not be empty
            gap = 0.0 if spec.integer else spec.step
            scale = Scale(*spec.slider, step=spec.step, log=spec.log)
            slider = Slider(scale, len(self.entries), wraps=spec.wraps, gap=gap)
            self.slider = named(slider, f"{spec.title} slider", spec.tooltip)
            self.slider.edited.connect(self._take)
            parts.insert(len(self.entries) - 1, (self.slider, 1))
        hbox(*parts, within=self, margins=0, spacing=4)
        self.setValue(spec.default)

    @property
    def tab_stops(self) -> list[QWidget]:
        stops: list[QWidget] = list(self.entries)
        if self.slider is not None:
            stops.insert(len(stops) - 1, self.slider)
        return stops

    def value(self) -> Any:
        return self.entry.value() if self.spec.kind == "number" else tuple(entry.value() for entry in self.entries)

    def setValue(self, value: Any) -> None:
        numbers = (value,) if self.spec.kind == "number" else tuple(value)
        for entry, number in zip(self.entries, numbers, strict=True):
            entry.setValue(number)
        if self.slider is not None:
            self.slider.set_values(*numbers)

    def _take(self, numbers: Sequence[float], gesture: int) -> None:
        numbers = tuple(round(number) if self.spec.integer else number for number in numbers)
        self.setValue(numbers[0] if self.spec.kind == "number" else numbers)
        self.edited.emit(self.value(), gesture)


class ChoiceEditor(QComboBox):
    """Chooses one of a field's words."""

    edited = pyqtSignal(object, int)

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__()
        self.addItems(list(spec.choices))
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setValue(spec.default)
        self.activated.connect(lambda _: self.edited.emit(self.value(), new_gesture()))

    def value(self) -> str:
        return self.currentText()

    def setValue(self, value: str) -> None:
        self.setCurrentText(value)

    def wheelEvent(self, event: QWheelEvent | None) -> None:
        if event is not None:
            event.ignore()


class FlagEditor(QCheckBox):
    """Turns something on or off."""

    edited = pyqtSignal(object, int)

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__(spec.title)
        self.setChecked(bool(spec.default))
        self.clicked.connect(lambda checked: self.edited.emit(bool(checked), new_gesture()))

    def value(self) -> bool:
        return self.isChecked()

    def setValue(self, value: bool) -> None:
        self.setChecked(value)


class MatrixView(QLabel):
    """Shows a matrix as text that can be selected; None is "from the rig"."""

    edited = pyqtSignal(object, int)

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__()
        font = QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont)
        font.setPointSizeF(text_font("caption").pointSizeF())
        self.setFont(font)
        self.setTextInteractionFlags(
            Qt.TextInteractionFlag.TextSelectableByMouse | Qt.TextInteractionFlag.TextSelectableByKeyboard
        )
        self.setValue(spec.default)

    def value(self) -> Any:
        return self._value

    def setValue(self, value: Any) -> None:
        self._value = value
        rows = [" ".join(f"{cell:>9.5g}" for cell in row) for row in value or ()]
        self.setText("\n".join(rows) or "from the rig")


def make_editor(spec: FieldSpec) -> Any:
    kind: Any = {"choice": ChoiceEditor, "flag": FlagEditor, "matrix": MatrixView}.get(spec.kind, NumbersEditor)
    widget = named(kind(spec), spec.title, spec.tooltip)
    if spec.kind == "matrix":
        widget.setAccessibleName("")  # a name would keep a screen reader from its numbers
    return widget
