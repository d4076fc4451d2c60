"""The list of markers: go to one, rename and delete, with undo."""

from __future__ import annotations

from collections.abc import Callable

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtGui import QKeySequence, QShortcut
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QDialog,
    QHeaderView,
    QLabel,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from ...core.output.markers import Marks
from ...widgets.basics.controls import push_button
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from .marks import MarksKeeper

_EMPTY = "No markers yet: M adds one at the frame on the screen."
_FULL = "A click goes to the frame, a double click renames."


class MarkerList(QDialog):
    """Shows the markers of the open source. ``seek`` shows a frame."""

    def __init__(self, keeper: MarksKeeper, seek: Callable[[int], object], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Markers – Tactune")
        self._keeper, self._seek = keeper, seek
        self.table = QTableWidget(0, 3)
        self.table.setHorizontalHeaderLabels(["Name", "Time, s", "Frame"])
        self.table.setAccessibleName("Markers")
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setToolTip("Time in seconds since the first frame; frames count from 1. F2 renames, Del deletes.")
        header, rows = self.table.horizontalHeader(), self.table.verticalHeader()
        assert header is not None and rows is not None
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        rows.hide()
        self.table.cellChanged.connect(self._renamed)
        self.table.itemSelectionChanged.connect(self._show_selected)
        self.hint = QLabel()
        self.delete = push_button("&Delete", "Delete the selected markers (Del)", "Del")
        self.delete.clicked.connect(self._delete)
        stack = keeper.undo_stack
        self.undo = push_button("&Undo", "Undo the last change of the marks (Ctrl+Z)", "Ctrl+Z")
        self.redo = push_button("&Redo", "Redo the last change of the marks (Ctrl+Shift+Z)", "Ctrl+Shift+Z")
        leave = push_button("Close", "Close this window (Esc)")
        for button, act, can in (
            (self.undo, stack.undo, stack.canUndoChanged),
            (self.redo, stack.redo, stack.canRedoChanged),
        ):
            button.clicked.connect(act)
            can.connect(button.setEnabled)
        self.undo.setEnabled(stack.canUndo())
        self.redo.setEnabled(stack.canRedo())
        leave.clicked.connect(self.reject)
        QShortcut(QKeySequence("Ctrl+Y"), self, self.redo.click)
        buttons = hbox(self.delete, self.undo, self.redo, STRETCH, leave)
        vbox((self.table, 1), self.hint, buttons, within=self)
        self.resize(460, 320)
        keeper.changed.connect(self._fill)
        self._fill(keeper.marks)

    def _fill(self, marks: Marks) -> None:
        with QSignalBlocker(self.table):
            self.table.setRowCount(len(marks.markers))
            for row, marker in enumerate(marks.markers):
                for column, text in enumerate((marker.name, f"{marker.time_s:.2f}", str(marker.frame + 1))):
                    item = QTableWidgetItem(text)
                    if column:
                        item.setFlags(item.flags() & ~Qt.ItemFlag.ItemIsEditable)
                        item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                    self.table.setItem(row, column, item)
        for column in (1, 2):  # the mode ResizeToContents would measure all rows again for each item
            self.table.resizeColumnToContents(column)
        self.delete.setEnabled(bool(marks.markers))
        self.hint.setText(_FULL if marks.markers else _EMPTY)

    def _renamed(self, row: int, column: int) -> None:
        item = self.table.item(row, column)
        if item is not None and column == 0:
            self._keeper.rename(row, item.text())
            self._fill(self._keeper.marks)  # an empty name changes nothing

    def _delete(self) -> None:
        self._keeper.delete(self._selected())

    def _show_selected(self) -> None:
        rows = self._selected()
        if len(rows) == 1:
            self._seek(self._keeper.marks.markers[rows.pop()].frame)

    def _selected(self) -> set[int]:
        return {index.row() for index in self.table.selectedIndexes()}
