"""The tab Compare methods: their patches side by side on the newest frame, and a table of their numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor, QResizeEvent
from PyQt6.QtWidgets import QGridLayout, QLabel, QWidget

from ...core.lab.methods import method_names, method_problems, method_tip
from ...widgets.basics.colormaps import Theme
from ...widgets.basics.controls import ChoiceBox, caption
from ...widgets.basics.layouts import splitter, vbox
from ...widgets.basics.messages import Severity
from ...widgets.basics.record_table import Column, RecordTable
from ...widgets.basics.theme import theme_name
from ...widgets.clouds.cloud_view import CloudView, link_cameras
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import Result
from .compare_work import (
    FALSE_RGB,
    MISSED_RGB,
    RIGHT_RGB,
    TRUTH,
    Comparer,
    Comparison,
    Outcome,
    method_color,
)
from .live_tab import LiveTab, Row

_CHOSEN: Final = "compare/methods"
_AT_FIRST: Final = "fusion-rigid,fusion-membrane,proximity-only,tactile-only,mechanics"
_TRUTH_TIP: Final = "The true contact: from the simulator's contact solver, or stored in the recording"
_CHOOSE: Final = "Tick a method in the table to see its patch here."
#: Preferred width over height of a view; points grow by a pixel for each of these pixels of its width.
_ASPECT, _POINT_EVERY = 1.25, 320


class CompareTab(LiveTab):
    """One linked 3D view per method and one of the truth, all on the same frame, and a table of their numbers."""

    COLUMNS = ("frame", "method", "averaged_frames", "median_ms", "points", "area_mm2", "rmse_mm", "iou", "remark")
    EXPORT = "comparison"
    KEEPS_ALL = False

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.methods = method_names()
        remembered = self.settings.text(_CHOSEN, _AT_FIRST).split(",")
        self.chosen = tuple(name for name in self.methods if name in remembered)
        self._comparer = Comparer()
        self.grid, self.color_by = TileGrid(), ChoiceBox()
        self.table = RecordTable(
            self._table_columns(),
            "Methods and their numbers",
            "Tick methods to compare (Space); Ctrl+C copies the selected rows, or all",
            key=lambda record: record.name,
        )
        for name, problem in method_problems().items():
            context.messages.show_message(f"method {name}", Severity.WARNING, f"A method is missing: {problem}.")
        self.color_by.addItems(["Method", "Agreement with the truth"])
        self.color_by.setToolTip(
            "Each method in its own colour, or correct, false and missed parts if the truth is known"
        )
        self.color_by.setAccessibleName("Colour by")
        self.color_by.setEnabled(False)
        self.reset.hide()
        self.export.setToolTip("Save this comparison as a picture, and its numbers as CSV beside it (Ctrl+E)")
        for part in (caption("Colour &by", self.color_by), self.color_by):
            self.top.addWidget(part)
        self.top.addStretch(1)
        self._show_table(())
        self.sheet = splitter(
            Qt.Orientation.Vertical, (self.grid, 1), self.table, sizes=(520, self.table.full_height() + 40)
        )
        self.column.addWidget(self.sheet, 1)
        self.table.ticked.connect(self._tick)
        self.table.copied.connect(
            lambda rows: self.messages.show_message("done", Severity.INFO, f"{rows} rows copied as text.")
        )
        self.color_by.currentIndexChanged.connect(self.again)
        self._show_tiles()

    def _table_columns(self) -> tuple[Column, ...]:
        def shown(name: str) -> bool | None:
            return None if name == TRUTH else name in self.chosen

        def number(title: str, field: str, decimals: int, tip: str, sample: str, factor: float = 1.0) -> Column:
            return Column(title, lambda record: factor * getattr(record, field), tip, decimals, sample=sample)

        return (
            Column(
                "Method",
                lambda record: f"{record.name} ({record.averaged} frames)" if record.averaged > 1 else record.name,
                "Tick a method to see it; every method keeps its colour",
                ticked=lambda record: shown(record.name),
                hint=lambda record: _tip(record.name),
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
        """Empty the views; they frame the next cloud."""
        self.grid.clear()

    def work(self, result: Result) -> Work:
        """Return the comparison of the chosen methods."""
        chosen, home, theme = self.chosen, self.context.document.untouched_home, theme_name()
        by_truth = self.color_by.currentIndex() == 1

        def compare(progress: Progress) -> Comparison:
            found = self.untouched(result, home, progress)
            return self._comparer.compare(
                result, chosen, found.frame, " ".join(found.warnings), theme, by_truth,
                lambda name: progress(0.0, f"Setting up {name}"),
            )  # fmt: skip

        return compare

    def show_found(self, result: Result, found: Comparison) -> Row | None:
        """Show views and table."""
        truth = result.frame.truth is not None
        self.color_by.setEnabled(truth)
        self._show_tiles()
        self._show_table(found.outcomes)
        for outcome in found.outcomes:
            if outcome.name in self.grid.shown():
                self.grid.tiles[outcome.name].show_outcome(outcome, truth, found.by_truth, theme_name())
        rate = self.rate.rate()
        playing = f" · {rate:.1f} compared per second" if result.playback.running and rate else ""
        unknown = "" if truth else " · no truth known, so no RMSE and IoU"
        self.status.setText(f"Frame {result.frame_number} of {result.source.name}{playing}{unknown}")
        # The export holds the shown frame only.
        self.rows = {
            -1 - number: (result.frame.sequence, each.name, each.averaged, *map(_known, _numbers(each)), each.note)
            for number, each in enumerate(found.outcomes)
        }
        return None

    def picture(self) -> QWidget | None:
        """Return views and table."""
        return self.sheet

    # Choices

    def _tick(self, record: Outcome, on: bool) -> None:
        self.chosen = tuple(name for name in self.methods if (on if name == record.name else name in self.chosen))
        self.settings.set(_CHOSEN, ",".join(self.chosen))
        self._show_tiles()
        self._show_table(() if self.found is None else self.found.outcomes)
        self.again()

    def _show_tiles(self) -> None:
        truth = self.result is not None and self.result.frame.truth is not None
        self.grid.show_tiles([*([TRUTH] if truth else []), *self.chosen])

    def _show_table(self, outcomes: Sequence[Outcome]) -> None:
        known = {outcome.name: outcome for outcome in outcomes}
        first = [known[TRUTH]] if TRUTH in known else []
        blank: Any = None
        rows = [known[name] if name in known and name in self.chosen else Outcome(name, blank) for name in self.methods]
        self.table.set_records([*first, *rows])


def _numbers(outcome: Outcome) -> tuple[float, ...]:
    return outcome.ms, outcome.points, outcome.area_mm2, outcome.rmse_mm, outcome.iou


def _known(number: float) -> str | None:
    return f"{number:.6g}" if math.isfinite(number) else None


def _tip(name: str) -> str:
    return _TRUTH_TIP if name == TRUTH else method_tip(name)


class Tile(QWidget):
    """One method's patch, and its numbers below."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.view = CloudView(name)
        self.caption = QLabel("\n")
        self.caption.setTextFormat(Qt.TextFormat.PlainText)
        self.caption.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.caption.setToolTip(_tip(name))
        self.caption.setAccessibleName(f"Numbers of {name}")
        vbox((self.view, 1), self.caption, within=self, margins=0, spacing=0)

    def show_outcome(self, outcome: Outcome, truth: bool, by_truth: bool, theme: Theme) -> None:
        """Show patch and numbers; with truth, also the agreement with it."""
        self.view.set_cloud(outcome.cloud)
        legend = [("contact", method_color(self.name, theme))]
        if by_truth:
            colors = (("right", RIGHT_RGB), ("false", FALSE_RGB), ("missed", MISSED_RGB))
            legend = [(word, QColor(*rgb)) for word, rgb in colors]
        if legend != self.view.legend():
            self.view.set_legend(legend)
        self.view.set_message(outcome.note)
        words = [f"{outcome.ms:.1f} ms"] * math.isfinite(outcome.ms)
        if math.isfinite(outcome.points):
            words += [f"{outcome.points:,.0f} points", f"{outcome.area_mm2 / 100:.1f} cm²"]
        lines = [" · ".join(words) or "no patch"]
        if truth:
            scores = f"RMSE {outcome.rmse_mm:.2f} mm · IoU {outcome.iou:.3f}".replace("nan", "–")
            lines.append("true contact" if outcome.name == TRUTH else scores)
        self.caption.setText("\n".join(lines))


class TileGrid(QWidget):
    """One tile for each chosen method, as large as possible, with linked cameras."""

    def __init__(self) -> None:
        super().__init__()
        self.tiles: dict[str, Tile] = {}
        self._shown: list[Tile] = []
        self._columns = 0
        self._layout = QGridLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setSpacing(4)
        self._empty = QLabel(_CHOOSE)
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._layout.addWidget(self._empty, 0, 0)

    def shown(self) -> list[str]:
        """Return the names of the visible tiles in order."""
        return [tile.name for tile in self._shown]

    def show_tiles(self, names: Sequence[str]) -> None:
        """Show only these tiles; new ones take the camera of those that stay."""
        if list(names) == self.shown():
            return
        stay = [tile for tile in self._shown if tile.name in names]
        for name in names:
            if name not in self.tiles:
                self.tiles[name] = Tile(name)
        for tile in self._shown:
            tile.hide()
            link_cameras([tile.view])
        self._shown = [self.tiles[name] for name in names]
        link_cameras([tile.view for tile in (*stay, *(tile for tile in self._shown if tile not in stay))])
        self._place()

    def clear(self) -> None:
        """Empty all views; they frame the next cloud."""
        for tile in self.tiles.values():
            tile.view.set_cloud(None)
            tile.view.set_message("")
            tile.caption.setText("")

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
        for place, tile in enumerate(self._shown):
            row, column = divmod(place, columns)
            self._layout.addWidget(tile, row, column)
            self._layout.setRowStretch(row, 1)
            self._layout.setColumnStretch(column, 1)
            tile.view.set_point_size(max(2, round(self.width() / columns / _POINT_EVERY)))
            tile.show()


def best_columns(count: int, width: int, height: int) -> int:
    """Return the number of columns with which ``count`` views are the largest in a room of this size."""

    def size(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, _ASPECT * height / rows)

    return max(range(1, count + 1), key=size, default=1)
