"""The tab Compare methods: their patches side by side on the live frame."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import Qt, QTimer, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout

from ...core.methods.registry import method_names, method_problems
from ...widgets.basics.controls import ChoiceBox, caption, push_button
from ...widgets.basics.layouts import splitter
from ...widgets.basics.messages import Severity
from ...widgets.basics.theme import theme_name
from ..context import Context
from ..worker.results import Result
from .compare_grid import TileGrid
from .compare_table import CompareTable, comparison_csv
from .comparer import CompareThread, Comparison, Task
from .measuring_tab import MeasuringTab
from .method_looks import TRUTH

_CHOSEN = "compare/methods"
_AT_FIRST = ("fusion-rigid", "fusion-membrane", "proximity-only", "tactile-only", "mechanics")
_WAITING = "Waiting for a frame: open a source in the main window."
#: Delay after which setting up a method is shown, in ms.
_SETUP_DELAY_MS = 300


class CompareTab(MeasuringTab):
    """One linked 3D view per method and one of the truth, all on the same frame, and a table of their numbers.

    Signals
    -------
    shown(Comparison)
    """

    shown = pyqtSignal(object)

    def __init__(self, context: Context) -> None:
        super().__init__(context, _WAITING)
        self.comparison: Comparison | None = None
        self._setting_up = ""
        methods = method_names()
        for name, problem in method_problems().items():
            context.messages.show_message(f"method {name}", Severity.WARNING, f"A method is missing: {problem}.")
        remembered = self._settings.text(_CHOSEN, ",".join(_AT_FIRST)).split(",")
        self.grid = TileGrid()
        self.table = CompareTable(methods, remembered)
        self.thread_ = CompareThread(self)
        self._late = QTimer(self)
        self._late.setSingleShot(True)
        self._late.setInterval(_SETUP_DELAY_MS)
        self.color_by = ChoiceBox()
        self.give_up = push_button("Cancel", "Cancel preparing the untouched frame, or try again")
        self._lay_out()
        self._connect()
        self._show_tiles()

    # What the window calls

    def show_result(self, result: Result) -> None:
        """Compare this frame next."""
        if self._result is None or self._result.source is not result.source:
            self.grid.clear()
            self.status.setText("Setting up the methods…")
        self._result = result
        self.untouched.look(result)
        self._send()

    def shut_down(self) -> None:
        """Stop all threads, for good."""
        super().shut_down()
        self._late.stop()
        self.thread_.shut_down()

    # Building

    def _lay_out(self) -> None:
        self.color_by.addItems(["Method", "Agreement with the truth"])
        self.color_by.setToolTip(
            "Each method in its own colour, or correct, false and missed parts if the truth is known"
        )
        self.color_by.setAccessibleName("Colour by")
        self.color_by.setEnabled(False)
        self.export.setToolTip(
            "Save this comparison as a picture, and its numbers as CSV beside it (Ctrl+E); files count frames from 0"
        )
        self.progress.setToolTip("Marked methods need an untouched frame; the others continue meanwhile")
        self.give_up.hide()
        row = QHBoxLayout()
        label = caption("Colour &by", self.color_by)
        row.addWidget(self.status, 1)
        for part in (self.progress, self.give_up, label, self.color_by, self.export):
            row.addWidget(part)
        sizes = (520, self.table.full_height())
        self.sheet = splitter(Qt.Orientation.Vertical, (self.grid, 1), self.table, sizes=sizes)
        self._lay_out_around(self.sheet, row)

    def _connect(self) -> None:
        self.thread_.compared.connect(self._show_newest)
        self.thread_.settingUp.connect(self._note_setting_up)
        self.thread_.failed.connect(self._complain)
        self._late.timeout.connect(self._show_setting_up)
        self.table.chosenChanged.connect(self._choose)
        self.table.copied.connect(lambda rows: self._say(f"{rows} row{'' if rows == 1 else 's'} copied as text."))
        self.color_by.currentIndexChanged.connect(self._send)
        self.grid.stepChanged.connect(self._send)
        self.untouched.changed.connect(self._untouched_changed)
        self.untouched.progress.connect(self._show_progress)
        self.give_up.clicked.connect(self._cancel_or_retry)
        self.export.clicked.connect(self._ask_where)

    # Frames

    def _choose(self) -> None:
        self._settings.set(_CHOSEN, ",".join(self.table.chosen()))
        self._show_tiles()
        self._send()

    def _show_tiles(self) -> None:
        truth = self._result is not None and self._result.frame.truth is not None
        self.grid.show_tiles([*([TRUTH] if truth else []), *self.table.chosen()])

    def _send(self) -> None:
        """Compare the newest frame with the present choices."""
        result = self._result
        if result is None:
            return
        if not self.thread_.isRunning():
            self.thread_.start()
        self.thread_.compare(
            Task(
                result,
                self.table.chosen(),
                self.untouched.frame,
                self.untouched.sentence,
                theme_name(),
                by_truth=self.color_by.currentIndex() == 1 and result.frame.truth is not None,
                step=self.grid.step,
            )
        )

    def _show_newest(self) -> None:
        comparison, result = self.thread_.take(), self._result
        if comparison is None or result is None or comparison.task.result.source is not result.source:
            return
        self._late.stop()
        if self.comparison is None or self.comparison.task.result.frame is not comparison.task.result.frame:
            self._rate.tick()
        self.comparison = comparison
        task = comparison.task
        truth = task.result.frame.truth is not None
        self.color_by.setEnabled(truth)
        self.export.setEnabled(True)
        self._show_tiles()
        self.table.set_theme(task.theme)
        self.table.show_outcomes({outcome.name: outcome for outcome in comparison.outcomes})
        for outcome in comparison.outcomes:
            if outcome.name in self.grid.shown():
                self.grid.tiles[outcome.name].show_outcome(outcome, truth, task.by_truth, task.theme)
        self._show_status(task, truth)
        self.shown.emit(comparison)

    def _show_status(self, task: Task, truth: bool) -> None:
        result = task.result
        parts = [f"Frame {result.frame_number} of {result.source.name}"]
        rate = self._rate.rate()
        if result.playback.running and rate:
            parts.append(f"{rate:.1f} compared per second, {self.thread_.skipped} skipped")
        if not truth:
            parts.append("no truth known, so no RMSE and IoU")
        if self.untouched.warning:
            parts.append(self.untouched.warning)
        self.status.setText(" · ".join(parts))

    def _note_setting_up(self, name: str) -> None:
        self._setting_up = name
        if not self._late.isActive():
            self._late.start()

    def _show_setting_up(self) -> None:
        if self._setting_up in self.grid.shown():
            self.grid.tiles[self._setting_up].show_setting_up()

    def _show_progress(self, share: float) -> None:
        """Show the progress of preparing the untouched frame."""
        self.progress.show_share(share)
        if self.untouched.searching:
            self.progress.show()
            self.give_up.show()

    def _untouched_changed(self) -> None:
        searching = self.untouched.searching
        self.progress.setVisible(searching and self.progress.isVisible())
        self.give_up.setVisible(self.progress.isVisible() or self.untouched.cancelled)
        self.give_up.setText("Cancel" if searching else "Try again")
        self._send()

    def _cancel_or_retry(self) -> None:
        (self.untouched.cancel if self.untouched.searching else self.untouched.retry)()

    # Export

    def _ask_where(self) -> None:
        if self.comparison is None:
            return
        name = f"comparison_{self.comparison.task.result.frame.sequence:06d}.png"
        self._dialogs.save_file("export", "Save comparison", name, ["PNG picture, CSV beside it (*.png)"], self.save_to)

    def save_to(self, path: Path) -> None:
        """Write views and table as a picture, and the numbers as CSV beside it."""
        comparison = self.comparison
        if comparison is not None:
            what = f"Frame {comparison.task.result.frame_number} was"
            self._write(self.sheet.grab().toImage(), comparison_csv(comparison), path, what)
