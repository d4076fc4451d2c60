"""What an analysis tab is, and the base of those that work on the newest frame on another thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from PyQt6.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

from ...core.errors import as_sentence
from ...widgets.basics.controls import ElidedLabel
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.basics.messages import Messages, Severity
from ..context import Context
from ..worker.jobs import Job, JobRow, Work
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


class LiveTab(AnalysisTab):
    """Works on the newest frame; a subclass fills `top` and `column`, computes (`work`) and shows (`show_found`)."""

    def __init__(self, context: Context) -> None:
        super().__init__()
        self.context = context
        self.result: Result | None = None
        self.job = Job(self)
        self.job.done.connect(self._done)
        self.job.failed.connect(self._complain)
        self.status, self.messages, self.working = ElidedLabel(WAITING), Messages(self), JobRow(self.job)
        self.top = QHBoxLayout()
        self.column = QVBoxLayout()
        state = hbox((self.status, 1), self.working)
        vbox(self.top, state, (self.column, 1), within=self, margins=0)

    # What a tab says of itself

    def work(self, result: Result) -> Work:
        """Return the work on a frame with the present entries; it runs on another thread."""
        raise NotImplementedError

    def show_found(self, result: Result, found: Any) -> None:
        """Show what the work has found."""
        raise NotImplementedError

    def begin(self, result: Result) -> None:
        """Forget the former source."""

    # Frames

    def show_result(self, result: Result) -> None:
        former, self.result = self.result, result
        if former is None or result.source is not former.source:
            self.job.cancel()
            self.begin(result)
        self.again()

    def again(self, *_: object) -> None:
        if (result := self.result) is not None:
            work = self.work(result)
            self.job.start(lambda progress: (result, work(progress)))

    def shut_down(self) -> None:
        self.job.stop()

    def _done(self, done: tuple[Result, Any]) -> None:
        result, found = done
        if self.result is None or result.source is not self.result.source:
            return
        self.status.setText(f"Frame {result.frame_number} of {result.source.name}")
        self.show_found(result, found)

    def _complain(self, sentence: str) -> None:
        if sentence:
            self.messages.show_message("work", Severity.ERROR, as_sentence(sentence))
