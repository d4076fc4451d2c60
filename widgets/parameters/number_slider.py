"""A slider and a numeric entry for one number."""

from __future__ import annotations

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QMouseEvent, QWheelEvent
from PyQt6.QtWidgets import QHBoxLayout, QSlider, QStyle, QStyleOptionSlider, QWidget

from .fields import FieldSpec
from .gestures import GestureClock
from .number_entry import NumberEntry
from .scales import Scale


class JumpSlider(QSlider):
    """A horizontal slider whose handle jumps to where it is pressed and leaves the wheel to the page."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(Qt.Orientation.Horizontal, parent)
        self._grip = 0.0
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)

    def mousePressEvent(self, event: QMouseEvent | None) -> None:
        """Grip the handle, or bring it here first."""
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
    """Edits one number of a preset field with a slider and an entry.

    `value` is always exactly what was set or what a person chose; the slider only shows the nearest position.

    Signals
    -------
    valueChanged(value)
        For whatever reason.
    edited(value, gesture: int)
        By a person.
    refused(sentence: str)
    """

    valueChanged = pyqtSignal(object)
    edited = pyqtSignal(object, int)
    refused = pyqtSignal(str)

    def __init__(self, spec: FieldSpec, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.spec = spec
        self._scale = Scale(*spec.slider, step=spec.step, log=spec.log)
        self._clock = GestureClock()
        self.slider = JumpSlider()
        self.slider.setRange(0, self._scale.positions)
        self.slider.setPageStep(max(1, self._scale.positions // 10))
        self.slider.setMinimumWidth(60)
        self.slider.setAccessibleName(f"{spec.title} slider")
        self.slider.setToolTip(spec.tooltip)
        self.entry = NumberEntry(spec)

        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.slider, 1)
        layout.addWidget(self.entry)

        self.slider.sliderPressed.connect(self._clock.hold)
        self.slider.sliderReleased.connect(self._clock.release)
        self.slider.valueChanged.connect(self._slider_moved)
        self.entry.edited.connect(self._entry_edited)
        self.entry.refused.connect(self.refused)
        self._place_slider(self.entry.value())

    @property
    def tab_stops(self) -> list[QWidget]:
        """What takes the focus, in order."""
        return [self.slider, self.entry]

    def value(self) -> float | int:
        """Return the exact value."""
        return self.entry.value()

    def setValue(self, value: float | int) -> None:
        """Show a value without telling that a person edited it."""
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
