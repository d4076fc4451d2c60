"""What an analysis tab is, and the base of those that work on the newest frame on another thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from PyQt6.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

from ...core.model.files import write_csv
from ...widgets.basics.controls import ElidedLabel, push_button
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.basics.messages import Messages, Severity
from ..context import Context
from ..worker.jobs import Job, JobRow, Progress, Work
from ..worker.results import Result

#: The entry-point group for tabs of other packages: each entry names a `TabKind`.
TABS: Final = "tactune.tabs"


class AnalysisTab(QWidget):
    """One way to judge the frames of the main window. Long work belongs on a thread of the tab's own."""

    @property
    def goes_on(self) -> bool:
        """Whether the tab wants frames behind other tabs, too, as long as the window is open."""
        return False

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window while this tab is visible or `goes_on`; must return at once."""

    def shut_down(self) -> None:
        """Stop all threads, for good."""


@dataclass(frozen=True)
class TabKind:
    """An analysis tab before it is opened; the Analysis menu and window list these."""

    title: str  # also the menu entry; an ampersand marks the key
    tip: str  # one sentence that says what the tab is for
    make: Callable[[Context], AnalysisTab]  # called when the tab is first looked at
    shortcut: str = ""  # such as "F7"


WAITING: Final = "Waiting for a frame: open a source in the main window."
#: Rows of the newest frames that are kept: an hour at 30 frames/s.
_MAX_ROWS: Final = 108_000

Row = tuple[Any, ...]


class LiveTab(AnalysisTab):
    """Works on the newest frame; a subclass fills `top` and `column`, computes (`work`) and shows (`show_found`)."""

    #: Columns of the CSV.
    COLUMNS: tuple[str, ...] = ()
    #: Name of the exported file without its suffix.
    EXPORT = "frames"

    def __init__(self, context: Context) -> None:
        super().__init__()
        self.context = context
        self.result: Result | None = None
        #: The rows of the source's frames by frame number, the newest last.
        self.rows: dict[int, Row] = {}
        self.messages = Messages(self)
        self.job = Job(self, self._done, partial(self._complain, "work"))
        tell = partial(self.messages.show_message, "done", Severity.INFO)
        self._writing = Job(self, tell, partial(self._complain, "export"))
        self.status, self.working = ElidedLabel(WAITING), JobRow(self.job)
        self.export = push_button("&Export…", "Save the numbers of all frames as CSV (Ctrl+E)")
        self.export.setShortcut("Ctrl+E")
        self.export.clicked.connect(self._ask_where)
        self.top = QHBoxLayout()
        self.column = QVBoxLayout()
        state = hbox((self.status, 1), self.working, self.export)
        vbox(self.top, state, (self.column, 1), within=self, margins=0)
        self._offer()

    # What a tab says of itself

    def work(self, result: Result) -> Work:
        """Return the work on a frame with the present entries; it runs on another thread."""
        raise NotImplementedError

    def show_found(self, result: Result, found: Any) -> Row | None:
        """Show what the work has found, and return the frame's row of `COLUMNS`; None for none."""
        raise NotImplementedError

    def begin(self, result: Result) -> None:
        """Forget the former source."""

    def rows_changed(self) -> None:
        """Show `rows`."""

    # Frames

    def show_result(self, result: Result) -> None:
        former, self.result = self.result, result
        if former is None or result.source is not former.source:
            self.job.cancel()
            self.begin(result)
            self.forget()
        self.again()

    def again(self, *_: object) -> None:
        if (result := self.result) is not None:
            work = self.work(result)
            self.job.start(lambda progress: (result, work(progress)))

    def shut_down(self) -> None:
        self.job.stop()
        self._writing.stop()

    def _done(self, done: tuple[Result, Any]) -> None:
        result, found = done
        if self.result is None or result.source is not self.result.source:
            return
        self.status.setText(f"Frame {result.frame_number} of {result.source.name}")
        row = self.show_found(result, found)
        self.rows.pop(result.frame.sequence, None)  # as in a loop, the newest is the last
        if row is not None:
            self.rows[result.frame.sequence] = row
            if len(self.rows) > _MAX_ROWS:
                del self.rows[next(iter(self.rows))]
            self.rows_changed()
        self._offer()

    # Rows

    def forget(self) -> None:
        """Remove all rows."""
        self.rows = {}
        self.rows_changed()
        self._offer()

    def _offer(self) -> None:
        self.export.setEnabled(bool(self.rows))

    def _ask_where(self) -> None:
        dialogs = self.context.dialogs.over(self.window() or self)
        dialogs.save_file("export", "Export", f"{self.EXPORT}.csv", ["Table (*.csv)"], self.save_to)

    def save_to(self, path: Path) -> None:
        """Write the rows as CSV in the order of their first column, on another thread."""
        rows = [dict(zip(self.COLUMNS, row, strict=True)) for row in sorted(self.rows.values(), key=lambda row: row[0])]

        def write(_: Progress) -> str:
            write_csv(path, rows)
            return f"The numbers were written to {path}."

        self._writing.start(write)

    def _complain(self, key: str, sentence: str) -> None:
        if sentence:
            self.messages.show_message(key, Severity.ERROR, sentence)
