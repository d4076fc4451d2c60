"""The tab Compare methods: their patches side by side on the newest frame, and a table of their numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QGridLayout, QLabel, QWidget

from ...core.lab.methods import method_names, method_problems, method_tip
from ...widgets.basics.layouts import splitter
from ...widgets.basics.messages import Severity
from ...widgets.basics.record_table import Column, RecordTable
from ...widgets.basics.theme import theme_name
from ...widgets.clouds.cloud_view import CloudView, link_cameras
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import Result
from .compare_work import TRUTH, Comparer, Comparison, Outcome, method_color
from .tab import LiveTab, Row

_CHOSEN: Final = "compare/methods"
_AT_FIRST: Final = "fusion-rigid,fusion-membrane,proximity-only,tactile-only,mechanics"
_TRUTH_TIP: Final = "The true contact: from the simulator's contact solver, or stored in the recording"
#: Preferred width over height of a view; points grow by a pixel for each of these pixels of its width.
_ASPECT, _POINT_EVERY = 1.25, 320


class CompareTab(LiveTab):
    """One linked 3D view per method and one of the truth, all on the same frame, and a table of their numbers."""

    COLUMNS = ("frame", "method", "averaged_frames", "median_ms", "points", "area_mm2", "rmse_mm", "iou", "remark")
    EXPORT = "comparison"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.methods = method_names()
        remembered = self.settings.text(_CHOSEN, _AT_FIRST).split(",")
        self.chosen = tuple(name for name in self.methods if name in remembered)
        self._comparer = Comparer()
        self.grid = ViewGrid()
        self.table = RecordTable(
            self._table_columns(),
            "Methods and their numbers",
            "Tick methods to compare (Space); Ctrl+C copies the selected rows, or all",
            key=lambda record: record.name,
        )
        for name, problem in method_problems().items():
            context.messages.show_message(f"method {name}", Severity.WARNING, f"A method is missing: {problem}.")
        self.reset.hide()
        self.export.setToolTip("Save this comparison as a picture, and its numbers as CSV beside it (Ctrl+E)")
        self._show_table(())
        sizes = (520, self.table.full_height() + 40)
        self.sheet = splitter(Qt.Orientation.Vertical, (self.grid, 1), self.table, sizes=sizes)
        self.column.addWidget(self.sheet, 1)
        self.table.ticked.connect(self._tick)
        self.table.copied.connect(
            lambda rows: self.messages.show_message("done", Severity.INFO, f"{rows} rows copied as text.")
        )
        self._show_views()

    def _table_columns(self) -> tuple[Column, ...]:
        def number(title: str, field: str, decimals: int, tip: str, sample: str, factor: float = 1.0) -> Column:
            return Column(title, lambda record: factor * getattr(record, field), tip, decimals, sample=sample)

        return (
            Column(
                "Method",
                lambda record: f"{record.name} ({record.averaged} frames)" if record.averaged > 1 else record.name,
                "Tick a method to see it; every method keeps its colour",
                ticked=lambda record: None if record.name == TRUTH else record.name in self.chosen,
                hint=lambda record: _TRUTH_TIP if record.name == TRUTH else method_tip(record.name),
                swatch=lambda record: method_color(record.name, theme_name()),
                sample="fusion-averaged (15 frames) 0000",
            ),
            number("Time, ms", "ms", 1, "Computation time of one frame, median of the last 15", "00000.0"),
            number("Points", "points", 0, "Points of the patch", "000,000"),
            number("Area, cm²", "area_mm2", 1, "Area of the patch, projected along the optical axis", "0000.0", 0.01),
            number("RMSE, mm", "rmse_mm", 2, "Average symmetric RMSE to the true contact", "000.00"),
            number("IoU", "iou", 3, "Intersection over union of the pixels of patch and truth, 0 to 1", "0.000"),
            Column("Remark", lambda record: record.note, "Why there is no patch", hint=lambda r: r.note, stretch=True),
        )

    # What the base asks

    def begin(self, result: Result) -> None:
        self.grid.clear()

    def work(self, result: Result) -> Work:
        chosen, home, theme = self.chosen, self.context.document.untouched_home, theme_name()

        def compare(progress: Progress) -> Comparison:
            untouched = self.untouched(result, home, progress)
            progress(0.0, "Comparing")
            return self._comparer.compare(result, chosen, untouched, theme)

        return compare

    def show_found(self, result: Result, found: Comparison) -> Row | None:
        self._show_views()
        self._show_table(found.outcomes)
        for outcome in found.outcomes:
            if outcome.name in self.grid.shown():
                view = self.grid.views[outcome.name]
                view.set_cloud(outcome.cloud)
                view.set_message(outcome.note)
                view.set_legend([("contact", method_color(outcome.name, theme_name()))])
        rate = self.rate.rate()
        playing = f" · {rate:.1f} compared per second" if result.playback.playing and rate else ""
        unknown = " · no truth known, so no RMSE and IoU" if result.frame.truth is None else ""
        self.status.setText(f"Frame {result.frame_number} of {result.source.name}{playing}{unknown}")
        # The export holds the shown frame only.
        self.rows = {}
        for number, each in enumerate(found.outcomes):
            numbers = (each.ms, each.points, each.area_mm2, each.rmse_mm, each.iou)
            known = (f"{value:.6g}" if math.isfinite(value) else None for value in numbers)
            self.rows[-1 - number] = (result.frame.sequence, each.name, each.averaged, *known, each.note)
        return None

    def picture(self) -> QWidget | None:
        return self.sheet

    # Choices

    def _tick(self, record: Outcome, on: bool) -> None:
        self.chosen = tuple(name for name in self.methods if (on if name == record.name else name in self.chosen))
        self.settings.set(_CHOSEN, ",".join(self.chosen))
        self._show_views()
        self._show_table(() if self.found is None else self.found.outcomes)
        self.again()

    def _show_views(self) -> None:
        truth = self.result is not None and self.result.frame.truth is not None
        self.grid.show_views([*([TRUTH] if truth else []), *self.chosen])

    def _show_table(self, outcomes: Sequence[Outcome]) -> None:
        known = {outcome.name: outcome for outcome in outcomes}
        first = [known[TRUTH]] if TRUTH in known else []
        blank: Any = None
        rows = [known[name] if name in known and name in self.chosen else Outcome(name, blank) for name in self.methods]
        self.table.set_records([*first, *rows])


class ViewGrid(QWidget):
    """One view for each chosen method, as large as possible, with linked cameras."""

    def __init__(self) -> None:
        super().__init__()
        self.views: dict[str, CloudView] = {}
        self._shown: dict[str, CloudView] = {}
        self._columns = 0
        self._layout = QGridLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setSpacing(4)
        self._empty = QLabel("Tick a method in the table to see its patch here.")
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._layout.addWidget(self._empty, 0, 0)

    def shown(self) -> list[str]:
        return list(self._shown)

    def show_views(self, names: Sequence[str]) -> None:
        """Show only these views; new ones take the camera of those that stay."""
        if list(names) == self.shown():
            return
        stay = [name for name in self._shown if name in names]
        for view in self._shown.values():
            view.hide()
            link_cameras([view])
        for name in names:
            if name not in self.views:
                self.views[name] = CloudView(name)
        self._shown = {name: self.views[name] for name in names}
        link_cameras([self.views[name] for name in (*stay, *(name for name in names if name not in stay))])
        self._place()

    def clear(self) -> None:
        """Empty all views; they frame the next cloud."""
        for view in self.views.values():
            view.set_cloud(None)
            view.set_message("")

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        """Choose the number of columns that makes the views largest."""
        super().resizeEvent(event)
        if best_columns(len(self._shown), self.width(), self.height()) != self._columns:
            self._place()

    def _place(self) -> None:
        columns = self._columns = best_columns(len(self._shown), self.width(), self.height())
        while self._layout.count():
            self._layout.takeAt(0)
        for line in range(max(self._layout.rowCount(), self._layout.columnCount())):
            self._layout.setRowStretch(line, 0)
            self._layout.setColumnStretch(line, 0)
        self._empty.setVisible(not self._shown)
        if not self._shown:
            self._layout.addWidget(self._empty, 0, 0)
        for place, view in enumerate(self._shown.values()):
            row, column = divmod(place, columns)
            self._layout.addWidget(view, row, column)
            self._layout.setRowStretch(row, 1)
            self._layout.setColumnStretch(column, 1)
            view.set_point_size(max(2, round(self.width() / columns / _POINT_EVERY)))
            view.show()


def best_columns(count: int, width: int, height: int) -> int:
    """Return the number of columns with which ``count`` views are the largest in a room of this size."""

    def size(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, _ASPECT * height / rows)

    return max(range(1, count + 1), key=size, default=1)
