"""The table of point pairs: where they are, how deep, and how well they agree with the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, Final

from PyQt6.QtCore import (
    QAbstractTableModel,
    QEvent,
    QItemSelection,
    QItemSelectionModel,
    QModelIndex,
    QSortFilterProxyModel,
    Qt,
    pyqtSignal,
)
from PyQt6.QtGui import QBrush, QColor, QKeyEvent
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QTableView

from ...core.errors import minus
from .controls import read_only_table
from .theme import theme_name

_Role = Qt.ItemDataRole


@dataclass(frozen=True)
class PointRow:
    """One pair as the table shows it; nan is shown as a dash.

    Attributes
    ----------
    left, right : (float, float)
        Places in pixels.
    depth_m : float
        Tactile depth in metres.
    dx, dy, residual_px : float
        Residual in the left image, pixels.
    residual_mm : float
        The same at the point's depth.
    left_out_px : float
        Residual when the fit was made without this pair.
    note : str
        Where the pair comes from.
    hint : str
        What to do about it, as a tooltip.
    """

    key: int
    enabled: bool
    left: tuple[float, float] = (nan, nan)
    right: tuple[float, float] = (nan, nan)
    depth_m: float = nan
    dx: float = nan
    dy: float = nan
    residual_px: float = nan
    residual_mm: float = nan
    left_out_px: float = nan
    note: str = ""
    worst: bool = False
    hint: str = ""


@dataclass(frozen=True)
class _Column:
    title: str
    tip: str
    value: Callable[[PointRow], float | str]
    decimals: int = 2


COLUMNS: Final = (
    _Column("#", "Number of the pair", lambda row: float(row.key), 0),
    _Column("On", "Whether the fit uses the pair (space switches)", lambda row: float(row.enabled), 0),
    _Column("Left u", "Column in the left image, pixels", lambda row: row.left[0]),
    _Column("Left v", "Row in the left image, pixels", lambda row: row.left[1]),
    _Column("Right u", "Column in the right image, pixels", lambda row: row.right[0]),
    _Column("Right v", "Row in the right image, pixels", lambda row: row.right[1]),
    _Column("Depth mm", "Tactile depth at the right point, millimetres", lambda row: 1e3 * row.depth_m, 1),
    _Column("dX px", "Horizontal residual in the left image, pixels, positive to the right", lambda row: row.dx),
    _Column("dY px", "Vertical residual in the left image, pixels, positive downwards", lambda row: row.dy),
    _Column("Res. px", "Length of the residual in the left image, pixels", lambda row: row.residual_px),
    _Column("Res. mm", "The residual at the point's depth, millimetres", lambda row: row.residual_mm),
    _Column(
        "Left out px",
        "Residual in a fit without this pair, pixels. Much larger than the residual: the fit depends on this pair",
        lambda row: row.left_out_px,
    ),
    _Column("Origin", "Image and snapshot that were clicked, or the helper that found it", lambda row: row.note),
)
_ENABLED = 1
#: Columns that a fit fills.
_FITTED: Final = ("dX px", "dY px", "Res. px", "Res. mm", "Left out px")
_WORST = {"light": QColor(255, 214, 209), "dark": QColor(104, 38, 34)}


class _Model(QAbstractTableModel):
    """Rows by key; a check mark in the second column."""

    toggled = pyqtSignal(int, bool)

    def __init__(self) -> None:
        super().__init__()
        self.rows: tuple[PointRow, ...] = ()
        self.pending = False

    def set_rows(self, rows: Sequence[PointRow]) -> None:
        """Replace the rows; equal keys in equal order only repaint."""
        rows = tuple(rows)
        same = [row.key for row in rows] == [row.key for row in self.rows]
        if same:
            self.rows = rows
            if rows:
                self.dataChanged.emit(self.index(0, 0), self.index(len(rows) - 1, len(COLUMNS) - 1))
            return
        self.beginResetModel()
        self.rows = rows
        self.endResetModel()

    def rowCount(self, parent: QModelIndex | None = None) -> int:
        return 0 if parent is not None and parent.isValid() else len(self.rows)

    def columnCount(self, parent: QModelIndex | None = None) -> int:
        return 0 if parent is not None and parent.isValid() else len(COLUMNS)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = _Role.DisplayRole) -> Any:
        if orientation == Qt.Orientation.Horizontal:
            if role == _Role.DisplayRole:
                return COLUMNS[section].title
            if role == _Role.ToolTipRole:
                return COLUMNS[section].tip
        return None

    def flags(self, index: QModelIndex) -> Qt.ItemFlag:
        flags = Qt.ItemFlag.ItemIsEnabled | Qt.ItemFlag.ItemIsSelectable
        return flags | Qt.ItemFlag.ItemIsUserCheckable if index.column() == _ENABLED else flags

    def data(self, index: QModelIndex, role: int = _Role.DisplayRole) -> Any:
        row, column = self.rows[index.row()], COLUMNS[index.column()]
        value = column.value(row)
        answer: Any = None
        if role == _Role.CheckStateRole and index.column() == _ENABLED:
            answer = Qt.CheckState.Checked if row.enabled else Qt.CheckState.Unchecked
        elif role == _Role.UserRole:
            answer = value if isinstance(value, str) or isfinite(value) else -1e300
        elif role == _Role.DisplayRole and index.column() != _ENABLED:
            fitted = self.pending and row.enabled and column.title in _FITTED
            answer = _shown(value, column.decimals, "…" if fitted else "–")
        elif role == _Role.TextAlignmentRole and isinstance(value, float):
            answer = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        elif role == _Role.BackgroundRole and row.worst:
            answer = QBrush(_WORST[theme_name()])
        elif role == _Role.ToolTipRole:
            answer = row.hint or (isinstance(value, str) and value) or column.tip
        return answer

    def setData(self, index: QModelIndex, value: Any, role: int = _Role.EditRole) -> bool:
        if role != _Role.CheckStateRole or index.column() != _ENABLED:
            return False
        self.toggled.emit(self.rows[index.row()].key, Qt.CheckState(value) == Qt.CheckState.Checked)
        return True


def _shown(value: float | str, decimals: int, missing: str) -> str:
    if isinstance(value, str):
        return value
    return minus(f"{value:z.{decimals}f}") if isfinite(value) else missing


class PointTable(QTableView):
    """Shows pairs; sorted by any column, the worst highlighted.

    Signals
    -------
    enabledToggled(key: int, enabled: bool)
        A person ticked or cleared a check mark; whoever listens answers with `set_rows`.
    selectionEdited(keys: tuple[int, ...])
        A person selected other rows.
    deleteRequested()
    """

    enabledToggled = pyqtSignal(int, bool)
    selectionEdited = pyqtSignal(object)
    deleteRequested = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        self._model = _Model()
        self._sorted = QSortFilterProxyModel(self)
        self._sorted.setSourceModel(self._model)
        self._sorted.setSortRole(_Role.UserRole)
        self._showing = False
        self.setModel(self._sorted)
        header, _ = read_only_table(
            self,
            "Point pairs: left is proximity, right is tactile",
            "Point pairs and their residuals: left is proximity, right is tactile",
        )
        self.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        self.setAlternatingRowColors(True)
        self.setShowGrid(False)
        self.setSortingEnabled(True)
        self.sortByColumn(0, Qt.SortOrder.AscendingOrder)
        self.setWordWrap(False)
        header.setSectionResizeMode(QHeaderView.ResizeMode.Interactive)
        header.setStretchLastSection(True)
        header.setHighlightSections(False)
        self._size_columns()
        self._model.toggled.connect(self.enabledToggled)
        selection = self.selectionModel()
        assert selection is not None
        selection.selectionChanged.connect(self._selection_changed)

    def show_worst_first(self) -> None:
        """Sort by the residual, the largest on top; pairs without a residual come last."""
        column = next(number for number, column in enumerate(COLUMNS) if column.title == "Res. px")
        self.sortByColumn(column, Qt.SortOrder.DescendingOrder)

    def rows(self) -> tuple[PointRow, ...]:
        """Return the rows, unsorted."""
        return self._model.rows

    def set_rows(self, rows: Sequence[PointRow]) -> None:
        """Show these rows; the selection stays with its pairs."""
        selected = self.selected_keys()
        self._showing = True
        self._model.set_rows(rows)
        self._showing = False
        self.select(selected)

    def show_pending(self, pending: bool) -> None:
        """Show that a fit is being computed: "…" instead of a dash where a residual is not known yet."""
        self._model.pending = pending
        viewport = self.viewport()
        if viewport is not None:
            viewport.update()

    def selected_keys(self) -> tuple[int, ...]:
        """Return the keys of the selected rows, in the order shown."""
        selection = self.selectionModel()
        assert selection is not None
        indexes = sorted(selection.selectedRows(), key=lambda index: index.row())
        return tuple(self._model.rows[self._sorted.mapToSource(index).row()].key for index in indexes)

    def select(self, keys: Sequence[int]) -> None:
        """Select the rows with these keys and scroll to the first; never emits."""
        selection = self.selectionModel()
        assert selection is not None
        if set(keys) == set(self.selected_keys()):
            return
        chosen = QItemSelection()
        shown = []
        for number, row in enumerate(self._model.rows):
            if row.key in set(keys):
                index = self._sorted.mapFromSource(self._model.index(number, 0))
                chosen.select(index, self._sorted.index(index.row(), len(COLUMNS) - 1))
                shown.append(index)
        self._showing = True
        selection.select(chosen, QItemSelectionModel.SelectionFlag.ClearAndSelect)
        if shown:
            selection.setCurrentIndex(shown[0], QItemSelectionModel.SelectionFlag.NoUpdate)
            self.scrollTo(shown[0])
        self._showing = False

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Delete removes; space switches the selected pairs on or off."""
        if event is None:
            return
        if event.key() in {Qt.Key.Key_Delete, Qt.Key.Key_Backspace}:
            self.deleteRequested.emit()
        elif event.key() == Qt.Key.Key_Space:
            rows = {row.key: row.enabled for row in self._model.rows}
            keys = self.selected_keys()
            enable = not all(rows[key] for key in keys)
            for key in keys:
                if rows[key] != enable:
                    self.enabledToggled.emit(key, enable)
        else:
            super().keyPressEvent(event)

    def changeEvent(self, event: QEvent | None) -> None:
        """Take the highlight of the other theme."""
        super().changeEvent(event)
        viewport = self.viewport()
        if event is not None and event.type() == QEvent.Type.PaletteChange and viewport is not None:
            viewport.update()

    def _size_columns(self) -> None:
        metrics = self.fontMetrics()
        for number, column in enumerate(COLUMNS[:-1]):
            sample = "000" if number <= _ENABLED else "-0000.00"
            title = metrics.horizontalAdvance(column.title) + 24  # with the arrow that shows the order
            self.setColumnWidth(number, max(title, metrics.horizontalAdvance(sample) + 12))

    def _selection_changed(self, *_: object) -> None:
        if not self._showing:
            self.selectionEdited.emit(self.selected_keys())
