"""One row of the parameter panel: label, editor, unit, reset button, a line for a refused value and one for a finding.

Rows that few people need are behind a fold.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Final, Protocol, cast

from PyQt6.QtCore import QObject, Qt, pyqtBoundSignal, pyqtSignal
from PyQt6.QtGui import QFontDatabase, QPalette, QWheelEvent
from PyQt6.QtWidgets import QCheckBox, QComboBox, QGridLayout, QLabel, QWidget

from ..basics.controls import FoldButton, NoteLabel, TintedLabel, push_button, tool_button
from ..basics.fields import FieldSpec
from ..basics.gestures import new_gesture
from ..basics.layouts import vbox
from ..basics.theme import text_font
from .band_slider import RangeEditor, RectangleEditor
from .number_slider import NumberSlider


class Editor(Protocol):
    """Interface of the widget that edits a field."""

    edited: pyqtBoundSignal

    def value(self) -> Any:
        """Return the field's value."""

    def setValue(self, value: Any) -> None:
        """Show a value; `edited` is not emitted."""


class ChoiceEditor(QComboBox):
    """Chooses one of a field's words."""

    edited = pyqtSignal(object, int)

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__()
        self.addItems(list(spec.choices))
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setValue(spec.default)
        self._shown = self.value()
        self.activated.connect(self._activated)

    def value(self) -> str:
        """Return the chosen word."""
        return self.currentText()

    def setValue(self, value: str) -> None:
        """Show a choice; `edited` is not emitted."""
        self.setCurrentText(value)
        self._shown = value

    def wheelEvent(self, event: QWheelEvent | None) -> None:
        """Let the panel scroll."""
        if event is not None:
            event.ignore()

    def _activated(self, _: int) -> None:
        if self.value() != self._shown:
            self._shown = self.value()
            self.edited.emit(self._shown, new_gesture())


class FlagEditor(QCheckBox):
    """Turns something on or off."""

    edited = pyqtSignal(object, int)

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__(spec.title)
        self.setChecked(bool(spec.default))
        self.clicked.connect(lambda checked: self.edited.emit(bool(checked), new_gesture()))

    def value(self) -> bool:
        """Return whether it is on."""
        return self.isChecked()

    def setValue(self, value: bool) -> None:
        """Show a state; `edited` is not emitted."""
        self.setChecked(value)


class MatrixView(QLabel):
    """Shows a matrix as text that can be selected; None is "from the rig"."""

    edited = pyqtSignal(object, int)

    def __init__(self, spec: FieldSpec) -> None:
        super().__init__()
        self._factor = spec.factor
        self._suffix = spec.suffix
        self._value: Any = spec.default
        self.setTextInteractionFlags(
            Qt.TextInteractionFlag.TextSelectableByMouse | Qt.TextInteractionFlag.TextSelectableByKeyboard
        )
        self._show()

    def value(self) -> Any:
        """Return the matrix as nested tuples, or None."""
        return self._value

    def setValue(self, value: Any) -> None:
        """Show a matrix or None."""
        if value != self._value:
            self._value = value
            self._show()

    def _show(self) -> None:
        if self._value is None:
            self.setFont(text_font("body"))
            self.setText("from the rig")
            return
        font = QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont)
        font.setPointSizeF(text_font("caption").pointSizeF())
        self.setFont(font)
        self.setText("\n".join(self._line(row) for row in self._value[:3]))

    def _line(self, row: tuple[float, ...]) -> str:
        if len(row) == 3:
            return " ".join(f"{cell:>10.5g}" for cell in row)
        return " ".join(f"{cell:8.5f}" for cell in row[:3]) + f" | {row[3] * self._factor:8.2f}{self._suffix}"


_EDITORS: dict[str, Any] = {
    "number": NumberSlider,
    "range": RangeEditor,
    "rectangle": RectangleEditor,
    "choice": ChoiceEditor,
    "flag": FlagEditor,
    "matrix": MatrixView,
}


def make_editor(spec: FieldSpec) -> QWidget:
    """Make the widget that edits a field; it is an `Editor`."""
    widget: QWidget = _EDITORS[spec.kind](spec)
    if spec.kind != "matrix":
        widget.setAccessibleName(spec.title)
    widget.setToolTip(spec.tooltip)
    return widget


class MessageLabel(NoteLabel):
    """A sentence about an error; hidden while empty."""

    def __init__(self) -> None:
        super().__init__()
        self.hide()

    def show_sentence(self, sentence: str) -> None:
        """Show a sentence, or hide with an empty one."""
        self.say(sentence, error=True)
        self.setVisible(bool(sentence))


#: Columns of a section's grid: label, editor, unit, reset button.
COLUMNS: Final = 4
_RESET_WIDTH = 20


@dataclass(frozen=True)
class ShownFinding:
    """A finding as it is shown: the sentence, and text and tooltip of its button; without a text there is none."""

    sentence: str
    button: str = ""
    tip: str = ""


class FindingLine(QWidget):
    """A sentence in the colour of warnings and the button below it; hidden while there is no finding.

    Signals
    -------
    pressed()
        The button was pressed.
    """

    pressed = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        self._sentence = TintedLabel(color="warning")
        self._sentence.setWordWrap(True)
        self.button = push_button("", "")
        self.button.clicked.connect(self.pressed)
        layout = vbox(self._sentence, within=self, margins=(0, 0, 0, 4), spacing=4)
        layout.addWidget(self.button, 0, Qt.AlignmentFlag.AlignRight)
        self.hide()

    @property
    def sentence(self) -> str:
        """What is wrong; empty while there is no finding."""
        return self._sentence.text()

    def show_finding(self, finding: ShownFinding | None) -> None:
        """Show a finding, or hide with None."""
        shown = finding or ShownFinding("")
        self._sentence.setText(shown.sentence)
        self.button.setText(shown.button)
        self.button.setToolTip(shown.tip)
        self.button.setVisible(bool(shown.button))
        self.setVisible(finding is not None)


class ParameterRow(QObject):
    """The widgets of one field, placed into a section's grid by `add_to`.

    Signals
    -------
    edited(path: str, value: object, gesture: int)
    """

    edited = pyqtSignal(str, object, int)

    def __init__(self, spec: FieldSpec, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.spec = spec
        self.widget = make_editor(spec)
        self.editor = cast(Editor, self.widget)
        self.label = QLabel(spec.title)
        self.label.setBuddy(getattr(self.widget, "entry", self.tab_stops[0]))
        self.label.setToolTip(spec.tooltip)
        if spec.kind == "flag" and not self.in_header:
            cast(FlagEditor, self.widget).setText("")  # the label stands beside it
        self.unit = QLabel(spec.suffix.strip() if spec.kind in ("number", "range", "rectangle") else "")
        self.unit.setForegroundRole(QPalette.ColorRole.PlaceholderText)
        self.reset = tool_button("", "", f"Reset {spec.title.lower()}", icon_name="restore")
        self.reset.setFixedWidth(_RESET_WIDTH)
        self.reset.clicked.connect(self._reset)
        self.reset.hide()
        self.label.setMinimumHeight(self.reset.sizeHint().height())  # the row keeps its height when it is hidden
        self.message = MessageLabel()
        self.finding = FindingLine()
        self._target: Any = spec.default
        self._grid: QGridLayout | None = None
        self._line = 0
        self._is_wide: bool | None = None
        self._row_shown = True
        self.editor.edited.connect(self._edited)
        refused = getattr(self.widget, "refused", None)
        if refused is not None:
            refused.connect(self.message.show_sentence)
        self.set_reset_target(spec.default, "default")

    @property
    def in_header(self) -> bool:
        """Whether the editor turns its whole section on or off and so belongs into the header."""
        return self.spec.kind == "flag" and self.spec.name == "enabled"

    @property
    def tab_stops(self) -> list[QWidget]:
        """Focusable widgets, in tab order."""
        return list(getattr(self.widget, "tab_stops", [self.widget]))

    def add_to(self, grid: QGridLayout) -> None:
        """Append the row to a grid of `COLUMNS` columns."""
        line = grid.rowCount()
        grid.setColumnMinimumWidth(3, _RESET_WIDTH)
        grid.addWidget(self.label, line, 0)
        grid.addWidget(self.unit, line, 2)
        grid.addWidget(self.reset, line, 3)
        grid.addWidget(self.message, line + 2, 0, 1, COLUMNS)
        grid.addWidget(self.finding, line + 3, 0, 1, COLUMNS)
        self._grid, self._line = grid, line
        self._place_editor()
        self._update_reset(self.widget.isEnabled())

    def set_shown(self, shown: bool) -> None:
        """Show or hide the whole row."""
        self._row_shown = shown
        for widget in (self.label, self.widget, self.unit):
            widget.setVisible(shown)
        self._update_reset(self.widget.isEnabled())
        self.message.setVisible(shown and bool(self.message.text()))
        self.finding.setVisible(shown and bool(self.finding.sentence))

    def set_editable(self, editable: bool) -> None:
        """Grey the row, or not."""
        for widget in (self.label, self.widget, self.unit):
            widget.setEnabled(editable)
        self._update_reset(editable)

    def set_reset_target(self, value: Any, origin: str) -> None:
        """Set the value of the reset button and describe its origin."""
        self._target = value
        self.reset.setToolTip(f"Reset to {self.spec.describe(value)} ({origin})")
        self._update_reset(self.widget.isEnabled())

    @property
    def reset_target(self) -> Any:
        """The value that the reset button goes back to."""
        return self._target

    def show_value(self, value: Any) -> None:
        """Show a value without emitting; a changed one clears the message."""
        if value != self.editor.value():
            self.message.show_sentence("")
        self.editor.setValue(value)
        self._place_editor()
        self._update_reset(self.widget.isEnabled())

    def _place_editor(self) -> None:
        """Put the editor beside the label, or below it if it is too wide."""
        if self._grid is None:
            return
        wide = self.spec.kind == "rectangle" or (self.spec.kind == "matrix" and self.editor.value() is not None)
        if wide != self._is_wide:
            self._is_wide = wide
            if wide:
                self._grid.addWidget(self.widget, self._line + 1, 0, 1, COLUMNS)
            else:
                self._grid.addWidget(self.widget, self._line, 1)

    def _update_reset(self, editable: bool) -> None:
        """Show the reset button only where it would change something."""
        wanted = self._row_shown and editable and self.editor.value() != self._target
        if not wanted and self.reset.hasFocus():
            self.tab_stops[0].setFocus()
        self.reset.setVisible(wanted and self.reset.parentWidget() is not None)

    def _edited(self, value: Any, gesture: int) -> None:
        self.message.show_sentence("")
        self._update_reset(True)
        self.edited.emit(self.spec.path, value, gesture)

    def _reset(self) -> None:
        if self.editor.value() != self._target:
            self.show_value(self._target)
            self._edited(self._target, new_gesture())


def align_columns(rows: Collection[ParameterRow]) -> None:
    """Give labels, number fields and units of all rows equal widths, so that columns are aligned across sections."""
    labels = max(row.label.sizeHint().width() for row in rows)
    units = max(row.unit.sizeHint().width() for row in rows)
    sliders = [row.widget for row in rows if isinstance(row.widget, NumberSlider)]
    entries = max(slider.entry.sizeHint().width() for slider in sliders)
    for row in rows:
        row.label.setMinimumWidth(labels)
        row.unit.setMinimumWidth(units)
    for slider in sliders:
        slider.entry.setMinimumWidth(entries)


class AdvancedFold(QWidget):
    """A button *More* above rows that few people need; closed at first.

    It opens by itself when one of its values begins to differ from the default, so that no such value is overlooked.
    """

    def __init__(self, title: str) -> None:
        super().__init__()
        self.rows: list[ParameterRow] = []
        self._differs = False
        self.button = FoldButton(
            "More", f"More of {title.lower()}", f"Show or hide the fields of {title.lower()} that are seldom changed"
        )
        self.button.clicked.connect(lambda: self.set_open(not self.is_open))
        self._body = QWidget()
        self.grid = QGridLayout(self._body)
        self.grid.setContentsMargins(0, 0, 0, 0)
        vbox(self.button, self._body, within=self, margins=0, spacing=4)
        self.set_open(False)

    @property
    def is_open(self) -> bool:
        """Whether the rows are shown."""
        return not self._body.isHidden()

    def set_open(self, opened: bool) -> None:
        """Show or hide the rows."""
        self._body.setVisible(opened)
        self.button.show_folded(not opened)

    def add(self, row: ParameterRow) -> None:
        """Append a row."""
        row.add_to(self.grid)
        self.rows.append(row)

    def open_if_changed(self) -> None:
        """Open the fold if a value differs from the default now and none did before."""
        differs = any(row.editor.value() != row.spec.default for row in self.rows)
        if differs and not self._differs:
            self.set_open(True)
        self._differs = differs
