"""What the main window needs to know of calibration: open the wizard, check again, pass frames on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QWidget

from ...widgets.basics.message_bar import MessageBar, Severity
from ...widgets.clouds.cloud_view import BackendChoice
from ..document.document import Document
from ..worker.playback import PlaybackState
from ..worker.results import Result
from ..worker.worker import Worker
from .feed import WorkerFeed
from .recheck_window import RecheckWindow
from .wizard import CalibrationWizard

_NO_FRAME = "There is no frame to calibrate on yet: open a source first."


class CalibrationLauncher(QObject):
    """Keeps at most one wizard and one check window, and feeds them."""

    def __init__(
        self,
        worker: Worker,
        document: Document,
        messages: MessageBar,
        folder: Path,
        window: QWidget,
        native_dialogs: bool = True,
        backend: BackendChoice = "auto",
    ) -> None:
        super().__init__(window)
        self._worker, self._document, self._messages = worker, document, messages
        self._folder, self._window = folder, window
        self._native, self._backend = native_dialogs, backend
        self._result: Result | None = None
        self._playback: PlaybackState | None = None
        self._feed: WorkerFeed | None = None
        self.wizard: CalibrationWizard | None = None
        self.recheck: RecheckWindow | None = None
        worker.playbackChanged.connect(self._playback_changed)

    def show_result(self, result: Result | None) -> None:
        """Take the newest frame of the main window."""
        if result is None:
            return
        self._result = result
        if self._feed is not None:
            self._feed.show_result(result)

    def open_wizard(self) -> None:
        """Open the wizard on the present source, or bring it to the front."""
        if self._result is None:
            self._messages.show_message("calibration", Severity.WARNING, _NO_FRAME)
            return
        if self.wizard is None:
            self._feed = WorkerFeed(self._worker, self._result, self._playback, self)
            self.wizard = CalibrationWizard(
                self._feed, self._document, self._folder, self._native, self._backend, self._window
            )
            self.wizard.finished.connect(self._wizard_closed)
        self.wizard.show()
        self.wizard.raise_()
        self.wizard.activateWindow()

    def open_recheck(self) -> None:
        """Check the preset's alignment on the present frame."""
        if self._result is None:
            self._messages.show_message("calibration", Severity.WARNING, _NO_FRAME)
            return
        if self.recheck is None:
            self.recheck = RecheckWindow(self._window)
            self.recheck.againRequested.connect(self._check)
            self.recheck.calibrateRequested.connect(self.open_wizard)
        self.recheck.show()
        self.recheck.raise_()
        self._check()

    def close(self) -> None:
        """Close both windows; the wizard's state is kept."""
        for opened in (self.wizard, self.recheck):
            if opened is not None:
                opened.close()

    def _playback_changed(self, state: PlaybackState) -> None:
        self._playback = state

    def _check(self) -> None:
        if self.recheck is not None and self._result is not None:
            document, result = self._document, self._result
            frame = replace(result.frame, sequence=result.frame_number)  # errors name frames by their numbers
            self.recheck.check(document.preset, result.source.rig, frame, document.untouched_home)

    def _wizard_closed(self) -> None:
        if self.wizard is not None:
            self.wizard.deleteLater()
        if self._feed is not None:
            self._feed.deleteLater()
        self.wizard, self._feed = None, None
