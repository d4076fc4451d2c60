"""The comparison as text: table, captions, clipboard and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QIcon, QKeyEvent, QKeySequence, QPixmap
from PyQt6.QtWidgets import QHeaderView, QTableWidget, QTableWidgetItem

from ...widgets.basics.colormaps import Theme
from ...widgets.basics.controls import copy_text, read_only_table
from .comparer import Comparison, Outcome
from .method_looks import TRUTH, method_color, method_tip

#: Title, unit and meaning of each column of the table.
COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("Method", "", "Tick a method to see it; every method keeps its colour"),
    ("Time", "ms", "Computation time of one frame, median of the last 15, while the program does its other work"),
    ("Points", "", "Points of the patch"),
    ("Area", "cm²", "Area of the patch, projected along the optical axis"),
    ("RMSE", "mm", "Average symmetric RMSE to the true contact: mean of the RMS nearest distances in both directions"),
    ("IoU", "", "Intersection over union of the pixels of patch and truth, 0 to 1"),
    ("Remark", "", "Why there is no patch or no comparison"),
)
MISSING = "–"
_CSV_HEADER = (
    "source,preset,frame,method,averaged_frames,median_ms,points,area_mm2,symmetric_rmse_mm,iou,precision,recall,remark"
)  # fmt: skip


def cells(outcome: Outcome) -> tuple[str, ...]:
    """Return the table's columns after the first, without units."""
    scores = outcome.scores
    return (
        MISSING if outcome.ms is None else f"{outcome.ms:.1f}",
        MISSING if scores.points is None else f"{scores.points:,}",
        MISSING if scores.area_mm2 is None else f"{scores.area_mm2 / 100:.1f}",
        MISSING if scores.rmse_mm is None else f"{scores.rmse_mm:.2f}",
        MISSING if scores.iou is None else f"{scores.iou:.3f}",
        outcome.note,
    )


def method_cell(name: str, averaged: int) -> str:
    """Return the table's first column: the method, and the number of averaged frames if greater than 1."""
    return f"{name} ({averaged} frames)" if averaged > 1 else name


def caption(outcome: Outcome, truth: bool) -> str:
    """Return the lines below a view: time and size and, if the truth is known, the agreement with it."""
    time, points, area, rmse, iou, _ = cells(outcome)
    size = "no patch" if outcome.scores.points is None else f"{points} points · {area} cm²"
    first = size if outcome.ms is None else f"{time} ms · {size}"
    if not truth:
        return first
    return f"{first}\n" + ("true contact" if outcome.name == TRUTH else f"RMSE {rmse} mm · IoU {iou}")


def table_text(rows: Iterable[tuple[str, ...]]) -> str:
    """Return rows of the table as tab-separated text under their titles with units."""
    titles = [f"{title} ({unit})" if unit else title for title, unit, _ in COLUMNS]
    return "\n".join("\t".join(row) for row in (titles, *rows))


def comparison_csv(comparison: Comparison) -> str:
    """Return a comparison as CSV, one row per method; missing values are empty, frames count from 0."""
    result = comparison.task.result
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_CSV_HEADER.split(","))
    for outcome in comparison.outcomes:
        scores = outcome.scores
        averages = outcome.name != TRUTH and scores.points is not None
        numbers = (
            outcome.averaged_frames if averages else None,
            outcome.ms,
            scores.points,
            scores.area_mm2,
            scores.rmse_mm,
            scores.iou,
            scores.precision,
            scores.recall,
        )
        shown = [
            "" if number is None else f"{number:.6g}" if isinstance(number, float) else number for number in numbers
        ]
        writer.writerow(
            [result.source.name, result.preset.name, result.frame.sequence, outcome.name, *shown, outcome.note]
        )
    return text.getvalue()


_SWATCH_PX = 12
_PADDING_PX = 18


class CompareTable(QTableWidget):
    """One row for the truth, and one with a check box for each method.

    Signals
    -------
    chosenChanged()
    copied(rows: int)
    """

    chosenChanged = pyqtSignal()
    copied = pyqtSignal(int)

    def __init__(self, methods: Sequence[str], chosen: Sequence[str]) -> None:
        super().__init__(len(methods) + 1, len(COLUMNS))
        self._names = (TRUTH, *methods)
        self._theme: Theme | None = None
        across, _ = read_only_table(
            self,
            "Methods and their numbers",
            "Tick methods to compare (Space); Ctrl+C copies the selected rows, or all",
        )
        across.setStretchLastSection(True)
        across.setHighlightSections(False)
        self.setAlternatingRowColors(True)
        self.setShowGrid(False)
        self._fill(chosen)
        across.setSectionResizeMode(len(COLUMNS) - 1, QHeaderView.ResizeMode.Stretch)
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
        """Show the numbers of these methods and clear the other rows."""
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
            mean = f"\nCurrently the mean of {averaged} frames" if averaged > 1 else ""
            first.setToolTip(method_tip(name) + mean)

    def full_height(self) -> int:
        """Return the height at which all rows are visible."""
        across = self.horizontalHeader()
        assert across is not None
        return across.sizeHint().height() + self.rowCount() * self.rowHeight(1) + 2 * self.frameWidth()

    def copy(self) -> None:
        """Copy the selected rows, or all rows with numbers, to the clipboard."""
        selected = {index.row() for index in self.selectedIndexes()}
        rows = sorted(selected) or [row for row in range(self.rowCount()) if self._at(row, 2).text()]
        texts = [tuple(self._at(row, column).text() for column in range(len(COLUMNS))) for row in rows]
        if texts:
            copy_text(table_text(texts))
            self.copied.emit(len(texts))

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Copy whole rows; the space bar ticks the current row from any column."""
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
            first.setToolTip(method_tip(name))
            if name != TRUTH:
                first.setFlags(flags | Qt.ItemFlag.ItemIsUserCheckable)
                first.setCheckState(Qt.CheckState.Checked if name in chosen else Qt.CheckState.Unchecked)
        metrics = self.fontMetrics()
        boxes = 4 * "0"  # the width of check box and colour
        widest = (method_cell("fusion-averaged", 15) + boxes, "00000.0", "000,000", "0000.0", "00.00", "0.000")
        for column, text in enumerate(widest):
            width = max(metrics.horizontalAdvance(shown) for shown in (text, self._heading(column)))
            self.setColumnWidth(column, width + _PADDING_PX)

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
