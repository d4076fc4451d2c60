"""All methods in a table: tick them to see them, read their numbers, copy them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QGuiApplication, QIcon, QKeyEvent, QKeySequence, QPixmap
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QTableWidget, QTableWidgetItem, QWidget

from ...widgets.basics.colormaps import Theme
from .compare_text import COLUMNS, cells, method_cell, table_text
from .comparer import Outcome
from .method_looks import TIPS, TRUTH, method_color

_SWATCH_PX = 12
_ROOM_PX = 18


class CompareTable(QTableWidget):
    """One row for the truth, and one for each method with a box to tick.

    Signals
    -------
    chosenChanged()
    copied(rows: int)
    """

    chosenChanged = pyqtSignal()
    copied = pyqtSignal(int)

    def __init__(self, methods: Sequence[str], chosen: Sequence[str], parent: QWidget | None = None) -> None:
        super().__init__(len(methods) + 1, len(COLUMNS), parent)
        self._names = (TRUTH, *methods)
        self._theme: Theme | None = None
        self.setAccessibleName("Methods and their numbers")
        self.setToolTip("Tick methods to compare (Space); Ctrl+C copies the selected rows, or all")
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setAlternatingRowColors(True)
        self.setShowGrid(False)
        self.setTabKeyNavigation(False)
        self._fill(chosen)
        self.setRowHidden(0, True)
        self.itemChanged.connect(self._item_changed)

    def chosen(self) -> tuple[str, ...]:
        """Return the methods that are ticked, in the table's order."""
        return tuple(name for row, name in enumerate(self._names) if row and self._checked(row))

    def set_theme(self, theme: Theme) -> None:
        """Show the methods' colours for a theme."""
        if theme == self._theme:
            return
        self._theme = theme
        with QSignalBlocker(self):
            for row, name in enumerate(self._names):
                swatch = QPixmap(_SWATCH_PX, _SWATCH_PX)
                swatch.fill(method_color(name, theme))
                self._at(row, 0).setIcon(QIcon(swatch))

    def show_outcomes(self, outcomes: Mapping[str, Outcome]) -> None:
        """Show the numbers of these methods; the other rows are empty."""
        with QSignalBlocker(self):
            for row, name in enumerate(self._names):
                outcome = outcomes.get(name)
                self._show_name(row, name, outcome.averaged_frames if outcome is not None else 1)
                texts = cells(outcome) if outcome is not None else ("",) * (len(COLUMNS) - 1)
                for column, text in enumerate(texts, start=1):
                    item = self._at(row, column)
                    if item.text() != text:
                        item.setText(text)
                        item.setToolTip(text if column == len(COLUMNS) - 1 else "")
        self.setRowHidden(0, TRUTH not in outcomes)
        viewport = self.viewport()
        assert viewport is not None
        viewport.update()

    def _show_name(self, row: int, name: str, averaged: int) -> None:
        first, text = self._at(row, 0), method_cell(name, averaged)
        if first.text() != text:
            first.setText(text)
            mean = f"\nAt the moment: mean of {averaged} frames" if averaged > 1 else ""
            first.setToolTip(TIPS.get(name, "") + mean)

    def full_height(self) -> int:
        """Return the height at which no row is hidden."""
        across = self.horizontalHeader()
        assert across is not None
        return across.sizeHint().height() + self.rowCount() * self.rowHeight(1) + 2 * self.frameWidth()

    def copy(self) -> None:
        """Put the selected rows, or all that have numbers, on the clipboard."""
        selected = {index.row() for index in self.selectedIndexes()}
        rows = sorted(selected) or [row for row in range(self.rowCount()) if self._at(row, 2).text()]
        texts = [tuple(self._at(row, column).text() for column in range(len(COLUMNS))) for row in rows]
        clipboard = QGuiApplication.clipboard()
        if clipboard is not None and texts:
            clipboard.setText(table_text(texts))
            self.copied.emit(len(texts))

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Copy whole rows; the space bar ticks the present row, whatever its column."""
        if event is not None and event.matches(QKeySequence.StandardKey.Copy):
            self.copy()
            return
        if event is not None and event.key() == Qt.Key.Key_Space and self.currentRow() > 0:
            other = Qt.CheckState.Unchecked if self._checked(self.currentRow()) else Qt.CheckState.Checked
            self._at(self.currentRow(), 0).setCheckState(other)
            return
        super().keyPressEvent(event)

    def _fill(self, chosen: Sequence[str]) -> None:
        for column, (title, unit, tip) in enumerate(COLUMNS):
            head = QTableWidgetItem(f"{title} [{unit}]" if unit else title)
            head.setToolTip(tip)
            self.setHorizontalHeaderItem(column, head)
        flags = Qt.ItemFlag.ItemIsEnabled | Qt.ItemFlag.ItemIsSelectable
        for row, name in enumerate(self._names):
            for column in range(len(COLUMNS)):
                item = QTableWidgetItem(name if column == 0 else "")
                item.setFlags(flags)
                if 0 < column < len(COLUMNS) - 1:
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.setItem(row, column, item)
            first = self._at(row, 0)
            first.setToolTip(TIPS.get(name, ""))
            if name != TRUTH:
                first.setFlags(flags | Qt.ItemFlag.ItemIsUserCheckable)
                first.setCheckState(Qt.CheckState.Checked if name in chosen else Qt.CheckState.Unchecked)
        across, down = self.horizontalHeader(), self.verticalHeader()
        assert across is not None and down is not None
        down.hide()
        down.setDefaultSectionSize(self.fontMetrics().height() + 7)
        across.setStretchLastSection(True)
        across.setHighlightSections(False)
        metrics = self.fontMetrics()
        boxes = 4 * "0"  # as wide as the box to tick and the colour
        widest = (method_cell("fusion-averaged", 15) + boxes, "00000.0", "000,000", "0000.0", "00.00", "0.000")
        for column, text in enumerate(widest):
            width = max(metrics.horizontalAdvance(shown) for shown in (text, self._heading(column)))
            self.setColumnWidth(column, width + _ROOM_PX)
        across.setSectionResizeMode(len(COLUMNS) - 1, QHeaderView.ResizeMode.Stretch)

    def _heading(self, column: int) -> str:
        head = self.horizontalHeaderItem(column)
        assert head is not None
        return head.text()

    def _at(self, row: int, column: int) -> QTableWidgetItem:
        item = self.item(row, column)
        assert item is not None
        return item

    def _checked(self, row: int) -> bool:
        return self._at(row, 0).checkState() == Qt.CheckState.Checked

    def _item_changed(self, item: QTableWidgetItem) -> None:
        if item.column() == 0:
            self.chosenChanged.emit()
