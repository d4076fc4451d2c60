"""What the main window needs to know of calibration: open the wizard, check again, pass frames on."""

from __future__ import annotations

from dataclasses import replace

from PyQt6.QtCore import QObject

from ...widgets.basics.message_bar import Severity
from ..context import Context
from ..worker.feed import WorkerFeed
from .recheck_window import RecheckWindow
from .wizard import CalibrationWizard

_NO_FRAME = "There is no frame to calibrate on yet: open a source first."


class CalibrationLauncher(QObject):
    """Keeps at most one wizard and one check window, and feeds them."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self._feed: WorkerFeed | None = None
        self.wizard: CalibrationWizard | None = None
        self.recheck: RecheckWindow | None = None
        context.frameShown.connect(self._frame_shown)

    def open_wizard(self) -> None:
        """Open the wizard on the present source, or bring it to the front."""
        context = self._context
        if context.result is None:
            context.messages.show_message("calibration", Severity.WARNING, _NO_FRAME)
            return
        if self.wizard is None:
            self._feed = WorkerFeed(context.worker, context.result, context.playback, self)
            self.wizard = CalibrationWizard(
                self._feed,
                context.document,
                context.data_folder / "calibration",
                context.dialogs.native,
                context.cloud_backend,
                context.window,
            )
            self.wizard.finished.connect(self._wizard_closed)
        self.wizard.show()
        self.wizard.raise_()
        self.wizard.activateWindow()

    def open_recheck(self) -> None:
        """Check the preset's alignment on the present frame."""
        context = self._context
        if context.result is None:
            context.messages.show_message("calibration", Severity.WARNING, _NO_FRAME)
            return
        if self.recheck is None:
            self.recheck = RecheckWindow(context.window)
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

    def _frame_shown(self) -> None:
        if self._feed is not None and self._context.result is not None:
            self._feed.show_result(self._context.result)

    def _check(self) -> None:
        document, result = self._context.document, self._context.result
        if self.recheck is not None and result is not None:
            frame = replace(result.frame, sequence=result.frame_number)  # errors name frames by their numbers
            self.recheck.check(document.preset, result.source.rig, frame, document.untouched_home)

    def _wizard_closed(self) -> None:
        if self.wizard is not None:
            self.wizard.deleteLater()
        if self._feed is not None:
            self._feed.deleteLater()
        self.wizard, self._feed = None, None
