"""A form of fields: for each a label, its editor, the unit, a reset button, and a line for a refusal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtGui import QPalette
from PyQt6.QtWidgets import QCheckBox, QGridLayout, QLabel, QWidget

from ..basics.controls import FoldButton, NoteLabel, TintedLabel, keep_place, new_gesture, tool_button
from ..basics.fields import FieldSpec
from ..basics.layouts import hbox, vbox
from .editors import NumbersEditor, make_editor

#: Columns of a form: reset button, label, editor, unit.
COLUMNS: Final = 4
_RESET_WIDTH = 20


class ParameterRow(QObject):
    """The widgets of one field, placed into a grid by `add_to`."""

    edited = pyqtSignal(str, object, int)  # path, value, gesture

    def __init__(self, spec: FieldSpec, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.spec = spec
        self.editor: Any = make_editor(spec)
        self.widget: QWidget = self.editor
        self.label = TintedLabel(spec.title)
        self.label.setBuddy(getattr(self.widget, "entry", self.widget))
        self.label.setToolTip(spec.tooltip)
        if isinstance(self.widget, QCheckBox) and not self.in_header:
            self.widget.setText("")  # the label stands beside it
        self.unit = QLabel(spec.suffix.strip() if isinstance(self.widget, NumbersEditor) else "")
        self.unit.setForegroundRole(QPalette.ColorRole.PlaceholderText)
        self.reset = tool_button("", "", f"Reset {spec.title.lower()}", icon_name="restore")
        self.reset.setFixedWidth(_RESET_WIDTH)
        self.reset.clicked.connect(self._reset)
        self.reset.hide()
        self.message = NoteLabel()
        self.message.hide()
        self._is_placed, self._is_shown = False, True
        self.editor.edited.connect(self._edited)
        if isinstance(self.widget, NumbersEditor):
            self.widget.refused.connect(self.refuse)
        self.set_reset_target(spec.default, "default")

    @property
    def in_header(self) -> bool:
        return self.spec.kind == "flag" and self.spec.path.endswith(".enabled")

    @property
    def tab_stops(self) -> list[QWidget]:
        return list(getattr(self.widget, "tab_stops", [self.widget]))

    def add_to(self, grid: QGridLayout) -> None:
        line, self._is_placed = grid.rowCount(), True
        grid.addWidget(self.reset, line, 0)
        grid.addWidget(self.label, line, 1)
        grid.addWidget(self.unit, line, 3)
        grid.addWidget(self.message, line + 2, 1, 1, COLUMNS - 1)
        if self.spec.kind in ("rectangle", "matrix"):
            grid.addWidget(self.widget, line + 1, 1, 1, COLUMNS - 1)
        else:
            grid.addWidget(self.widget, line, 2, 1, 1 if self.unit.text() or self.spec.kind == "number" else 2)
        self._update_reset()

    def set_shown(self, shown: bool) -> None:
        self._is_shown = shown
        for widget in (self.label, self.widget, self.unit):
            widget.setVisible(shown)
        self.message.setVisible(shown and bool(self.message.text()))
        self._update_reset()

    def set_editable(self, editable: bool) -> None:
        for widget in (self.label, self.widget, self.unit):
            widget.setEnabled(editable)
        self._update_reset()

    def set_reset_target(self, value: Any, origin: str) -> None:
        self.reset_target = value
        self.reset.setToolTip(f"Reset to {self.spec.describe(value)} ({origin})")
        self._update_reset()

    def differs(self) -> bool:
        return bool(self.editor.value() != self.reset_target)

    def show_value(self, value: Any) -> None:
        """Show a value without emitting; a changed one clears the refusal."""
        if value != self.editor.value():
            self.refuse("")
        self.editor.setValue(value)
        self._update_reset()

    def refuse(self, sentence: str) -> None:
        self.message.say(sentence, error=True)
        self.message.setVisible(bool(sentence))

    def show_finding(self, sentence: str) -> None:
        """Mark the label of a field with which something is wrong, and say what in its tooltip; "" ends that."""
        self.label.tint("warning" if sentence else "")
        self.label.setToolTip(sentence or self.spec.tooltip)

    def _update_reset(self) -> None:
        wanted = self._is_shown and self.widget.isEnabled() and self.differs()
        if not wanted and self.reset.hasFocus():
            self.tab_stops[0].setFocus()
        keep_place(self.reset, self._is_shown)
        self.reset.setVisible(wanted and self._is_placed)

    def _edited(self, value: Any, gesture: int) -> None:
        self.refuse("")
        self._update_reset()
        self.edited.emit(self.spec.path, value, gesture)

    def _reset(self) -> None:
        if self.differs():
            self.show_value(self.reset_target)
            self._edited(self.reset_target, new_gesture())


class Form(QWidget):
    """Rows for fields; advanced ones are behind a fold, which opens when a value begins to differ from the default."""

    edited = pyqtSignal(str, object, int)  # path, value, gesture

    def __init__(self, rows: Iterable[ParameterRow] = (), title: str = "the settings") -> None:
        super().__init__()
        self.rows: dict[str, ParameterRow] = {}
        self._differs = False
        seen, self._body = QWidget(), QWidget()
        self._grid, self._hidden = _grid(seen), _grid(self._body)
        tip = f"Show or hide the fields of {title} that are seldom changed"
        self.more = FoldButton("More", f"More of {title}", tip, self._body)
        more = hbox(_RESET_WIDTH, self.more, spacing=0)
        vbox(seen, more, self._body, within=self, margins=(0, 4, 4, 4), spacing=4)
        self.more.hide()
        self.more.fold(True)
        for row in rows:
            self.add(row)

    @property
    def advanced(self) -> list[ParameterRow]:
        return [row for row in self.rows.values() if row.spec.advanced]

    def add(self, row: ParameterRow) -> None:
        """Append a row; one that belongs into a section's header only with its line for a refusal."""
        self.rows[row.spec.path] = row
        row.edited.connect(self.edited)
        if row.in_header:
            self.add_line(row.message)
        elif row.spec.advanced:
            row.add_to(self._hidden)
            self.more.show()
        else:
            row.add_to(self._grid)

    def add_line(self, widget: QWidget, title: str = "") -> None:
        """Append a widget in a line of its own, or after a title."""
        line, column = self._grid.rowCount(), 1
        if title:
            self._grid.addWidget(QLabel(title), line, 1)
            column = 2
        self._grid.addWidget(widget, line, column, 1, COLUMNS - column)

    def align_columns(self) -> None:
        """Give labels, number fields and units equal widths: those behind the fold stand in a grid of their own."""
        rows = [row for row in self.rows.values() if not row.in_header]
        entries = [row.editor.entry for row in rows if row.spec.kind == "number"]
        for widgets in ([row.label for row in rows], [row.unit for row in rows], entries):
            width = max((widget.sizeHint().width() for widget in widgets), default=0)
            for widget in widgets:
                widget.setMinimumWidth(width)

    def open_if_changed(self) -> None:
        """Open the fold if a value differs from the default now and none did before."""
        differs = any(row.editor.value() != row.spec.default for row in self.advanced)
        if differs and not self._differs:
            self.more.fold(False)
        self._differs = differs


def _grid(within: QWidget) -> QGridLayout:
    grid = QGridLayout(within)
    grid.setContentsMargins(0, 0, 0, 0)
    grid.setHorizontalSpacing(4)
    grid.setVerticalSpacing(4)
    grid.setColumnMinimumWidth(0, _RESET_WIDTH)
    grid.setColumnStretch(2, 1)
    return grid
