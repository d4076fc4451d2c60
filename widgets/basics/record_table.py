"""A table of records: a person reads, sorts, ticks and selects rows; the records change elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

from PyQt6.QtCore import QAbstractTableModel, QItemSelection, QItemSelectionModel, QModelIndex, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QKeyEvent
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QTableView

from ...core.errors import minus
from .controls import named
from .theme import THEME

_Role = Qt.ItemDataRole
#: Background of a row that needs a look.
_MARKED: Final = {"light": QColor(255, 214, 209), "dark": QColor(104, 38, 34)}
_MISSING = "–"


@dataclass(frozen=True)
class Column:
    """One column: how a record's cell reads and looks.

    ``value`` gives the text of a record, or its number where ``decimals`` is given; nan is shown as a dash. A column
    with ``ticked`` has check boxes. ``hint`` is the tooltip of a cell. The column is as wide as ``sample``, or as its
    content, or takes the room that is left.
    """

    title: str
    value: Callable[[Any], float | str]
    tip: str = ""
    decimals: int | None = None
    ticked: Callable[[Any], bool] | None = None
    hint: Callable[[Any], str] | None = None
    sample: str = ""
    stretch: bool = False

    @property
    def alignment(self) -> Qt.AlignmentFlag:
        side = Qt.AlignmentFlag.AlignLeft if self.decimals is None else Qt.AlignmentFlag.AlignRight
        return side | Qt.AlignmentFlag.AlignVCenter

    def text(self, record: Any) -> str:
        value = self.value(record)
        if isinstance(value, str):
            return value
        return minus(f"{value:z,.{self.decimals}f}") if isfinite(value) else _MISSING

    def place(self, record: Any) -> Any:
        """Return what a record is sorted by; what is not known comes before all numbers."""
        value = self.value(record)
        if self.decimals is not None:
            return -1e300 if isinstance(value, str) or not isfinite(value) else value
        return value if self.ticked is None else self.ticked(record)


class _Model(QAbstractTableModel):
    """Gives Qt the cells of the records, in the order in which they are shown."""

    ticked = pyqtSignal(object, bool)

    def __init__(
        self, columns: Sequence[Column], key: Callable[[Any], Any], marked: Callable[[Any], bool] | None
    ) -> None:
        super().__init__()
        self.columns, self.key = tuple(columns), key
        self.given: tuple[Any, ...] = ()
        self.records: tuple[Any, ...] = ()
        self._marked = marked
        self._sorted: tuple[Column, bool] | None = None

    def show(self, records: Sequence[Any]) -> None:
        self.given = shown = tuple(records)
        if self._sorted is not None:
            column, falls = self._sorted
            shown = tuple(sorted(records, key=column.place, reverse=falls))
        if shown and [*map(self.key, shown)] == [*map(self.key, self.records)]:
            self.records = shown
            self.dataChanged.emit(self.index(0, 0), self.index(len(shown) - 1, len(self.columns) - 1))
        else:
            self.beginResetModel()
            self.records = shown
            self.endResetModel()

    def sort(self, column: int, order: Qt.SortOrder = Qt.SortOrder.AscendingOrder) -> None:
        self._sorted = self.columns[column], order == Qt.SortOrder.DescendingOrder
        self.show(self.given)

    def rowCount(self, parent: QModelIndex | None = None) -> int:
        return 0 if parent is not None and parent.isValid() else len(self.records)

    def columnCount(self, parent: QModelIndex | None = None) -> int:
        return 0 if parent is not None and parent.isValid() else len(self.columns)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = _Role.DisplayRole) -> Any:
        column = self.columns[section] if orientation == Qt.Orientation.Horizontal else None
        attributes = {_Role.DisplayRole: "title", _Role.ToolTipRole: "tip", _Role.TextAlignmentRole: "alignment"}
        shown = attributes.get(_Role(role))
        return None if column is None or shown is None else getattr(column, shown)

    def flags(self, index: QModelIndex) -> Qt.ItemFlag:
        flags = Qt.ItemFlag.ItemIsEnabled | Qt.ItemFlag.ItemIsSelectable
        has_box = self.columns[index.column()].ticked is not None
        return flags | Qt.ItemFlag.ItemIsUserCheckable if has_box else flags

    def data(self, index: QModelIndex, role: int = _Role.DisplayRole) -> Any:
        record, column = self.records[index.row()], self.columns[index.column()]
        answer: Any = None
        if role == _Role.DisplayRole:
            answer = column.text(record)
        elif role == _Role.CheckStateRole and column.ticked is not None:
            answer = Qt.CheckState.Checked if column.ticked(record) else Qt.CheckState.Unchecked
        elif role == _Role.TextAlignmentRole:
            answer = column.alignment
        elif role == _Role.ToolTipRole:
            answer = (column.hint(record) if column.hint is not None else "") or column.tip
        elif role == _Role.BackgroundRole and self._marked is not None and self._marked(record):
            answer = _MARKED[THEME.name]
        return answer

    def setData(self, index: QModelIndex, value: Any, role: int = _Role.EditRole) -> bool:
        if role != _Role.CheckStateRole:
            return False
        self.ticked.emit(self.records[index.row()], Qt.CheckState(value) == Qt.CheckState.Checked)
        return True


class RecordTable(QTableView):
    """Shows records in columns. Whoever listens to its signals changes the records and calls `set_records`.

    Space ticks the selected rows. A record stays selected by its ``key``; the rows of ``marked`` records are
    highlighted.
    """

    ticked = pyqtSignal(object, bool)  # record, on
    selectionEdited = pyqtSignal(object)  # keys: a person selected other rows
    deleteRequested = pyqtSignal()

    def __init__(
        self,
        columns: Sequence[Column],
        name: str,
        tip: str = "",
        *,
        key: Callable[[Any], Any] = lambda record: record,
        marked: Callable[[Any], bool] | None = None,
        sortable: bool = False,
    ) -> None:
        super().__init__()
        self._box = next((column.ticked for column in columns if column.ticked is not None), None)
        self._showing = False
        self._model = _Model(columns, key, marked)
        self.setModel(self._model)
        self._kept: tuple[Any, ...] = ()  # keys of the selected rows while all are replaced
        self._model.modelAboutToBeReset.connect(lambda: setattr(self, "_kept", self.selected_keys()))
        self._model.modelReset.connect(lambda: self.select(self._kept))
        named(self, name, tip)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        self.setTabKeyNavigation(False)
        self.setAlternatingRowColors(True)
        self.setShowGrid(False)
        self.setWordWrap(False)
        across, down = self.horizontalHeader(), self.verticalHeader()
        assert across is not None and down is not None
        across.setHighlightSections(False)
        across.setStretchLastSection(True)
        down.hide()
        down.setDefaultSectionSize(self.fontMetrics().height() + 6)
        for number, column in enumerate(columns):
            if column.stretch:
                across.setSectionResizeMode(number, QHeaderView.ResizeMode.Stretch)
            elif column.sample:
                width = max(map(self.fontMetrics().horizontalAdvance, (column.sample, column.title)))
                self.setColumnWidth(number, width + 18)
            else:
                across.setSectionResizeMode(number, QHeaderView.ResizeMode.ResizeToContents)
        if sortable:
            self.setSortingEnabled(True)
            self.sortByColumn(0, Qt.SortOrder.AscendingOrder)
        self._model.ticked.connect(self.ticked)
        self._selection.selectionChanged.connect(self._selection_changed)

    def records(self) -> tuple[Any, ...]:
        return self._model.given

    def set_records(self, records: Sequence[Any]) -> None:
        self._model.show(records)

    def selected_keys(self) -> tuple[Any, ...]:
        return tuple(map(self._model.key, self._selected()))

    def select(self, keys: Sequence[Any]) -> None:
        """Select the rows with these keys and scroll to the first; never emits."""
        rows = [row for row, record in enumerate(self._model.records) if self._model.key(record) in keys]
        if sorted(index.row() for index in self._selection.selectedRows()) == rows:
            return
        chosen = QItemSelection()
        for row in rows:
            chosen.select(self._model.index(row, 0), self._model.index(row, len(self._model.columns) - 1))
        self._showing = True
        self._selection.select(chosen, QItemSelectionModel.SelectionFlag.ClearAndSelect)
        if rows:
            self._selection.setCurrentIndex(self._model.index(rows[0], 0), QItemSelectionModel.SelectionFlag.NoUpdate)
            self.scrollTo(self._model.index(rows[0], 0))
        self._showing = False

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        assert event is not None
        if event.key() in {Qt.Key.Key_Delete, Qt.Key.Key_Backspace}:
            self.deleteRequested.emit()
        elif event.key() == Qt.Key.Key_Space and self._box is not None:
            box, chosen = self._box, self._selected()
            off = [record for record in chosen if not box(record)]
            for record in off or chosen:
                self.ticked.emit(record, bool(off))
        else:
            super().keyPressEvent(event)

    @property
    def _selection(self) -> QItemSelectionModel:
        selection = self.selectionModel()
        assert selection is not None
        return selection

    def _selected(self) -> list[Any]:
        return [self._model.records[row] for row in sorted(index.row() for index in self._selection.selectedRows())]

    def _selection_changed(self, *_: object) -> None:
        if not self._showing:
            self.selectionEdited.emit(self.selected_keys())
