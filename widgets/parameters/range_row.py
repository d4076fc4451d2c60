"""Editors for two numbers that belong together (a range) and for four (a rectangle)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import QAbstractSpinBox, QHBoxLayout, QLabel, QWidget

from .band_slider import BandSlider
from .fields import FieldSpec
from .number_entry import NumberEntry
from .scales import Scale

Numbers = tuple[float, ...]


class _Entries(QWidget):
    """Numeric entries for a tuple; the base of the editors below.

    Signals
    -------
    valueChanged(value: tuple)
        For whatever reason.
    edited(value: tuple, gesture: int)
        By a person.
    refused(sentence: str)
    """

    valueChanged = pyqtSignal(object)
    edited = pyqtSignal(object, int)
    refused = pyqtSignal(str)

    def __init__(self, spec: FieldSpec, names: Sequence[str], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.spec = spec
        # the row's label carries the unit, once
        bare = replace(spec, suffix="")
        self.entries = [NumberEntry(bare, title=f"{spec.title}, {name}") for name in names]
        for entry in self.entries:
            entry.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)
            entry.edited.connect(self._entry_edited)
            entry.refused.connect(self.refused)
        self._value: Numbers = tuple(spec.default)
        for entry, number in zip(self.entries, self._value, strict=True):
            entry.setValue(number)

    @property
    def tab_stops(self) -> list[QWidget]:
        """What takes the focus, in order."""
        return list(self.entries)

    def value(self) -> Numbers:
        """Return the exact numbers."""
        return self._value

    def setValue(self, value: Sequence[float]) -> None:
        """Show numbers without telling that a person edited them."""
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

    def __init__(self, spec: FieldSpec, parent: QWidget | None = None) -> None:
        super().__init__(spec, ("low end", "high end"), parent)
        # whole numbers may coincide (one hue); a range of lengths must not be empty
        gap = 0.0 if spec.integer else spec.step
        self.slider = BandSlider(Scale(*spec.slider, step=spec.step, log=spec.log), wraps=spec.wraps, gap=gap)
        self.slider.setAccessibleName(f"{spec.title} slider")
        self.slider.setToolTip(spec.tooltip)
        self.slider.setValue(*self._value)
        self.slider.edited.connect(self._slider_edited)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.entries[0])
        layout.addWidget(self.slider, 1)
        layout.addWidget(self.entries[1])

    @property
    def tab_stops(self) -> list[QWidget]:
        """What takes the focus, in order."""
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

    def __init__(self, spec: FieldSpec, parent: QWidget | None = None) -> None:
        names = ("left", "top", "width", "height")
        super().__init__(spec, names, parent)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        for text, entry in zip(("x", "y", "w", "h"), self.entries, strict=True):
            label = QLabel(text)
            label.setBuddy(entry)
            layout.addWidget(label)
            layout.addWidget(entry, 1)
