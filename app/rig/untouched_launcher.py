"""What the main window needs to know of untouched frames: capture one, keep it, pass frames on, close."""

from __future__ import annotations

from PyQt6.QtCore import QObject, pyqtSignal

from ...widgets.basics.message_bar import Severity
from ..calibration.feed import WorkerFeed
from ..context import Context
from ..document.untouched_store import UntouchedStore
from ..worker.results import SourceInfo
from .untouched_keeper import UntouchedKeeper
from .untouched_window import CaptureWindow


class UntouchedControls(QObject):
    """Owns the store, follows the preset, and keeps at most one window.

    Signals
    -------
    saveRequested()
        Save the preset, whose untouched frame was captured.
    """

    saveRequested = pyqtSignal()

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self._feed: WorkerFeed | None = None
        self.window: CaptureWindow | None = None
        self.store = UntouchedStore(context.data_folder / "untouched")
        self.store.tidy(context.data_folder)
        context.document.untouched_store = self.store
        context.document.warned.connect(
            lambda sentence: context.messages.show_message("untouched", Severity.WARNING, sentence)
        )
        self.keeper = UntouchedKeeper(context.document, context.worker.recorder, self.store, self)
        context.worker.opened.connect(self._source_opened)
        context.frameShown.connect(self._frame_shown)

    def open(self) -> None:
        """Open the window on the present source, or bring it to the front."""
        context = self._context
        if context.result is None:
            context.messages.show_message(
                "untouched", Severity.WARNING, "There is no frame to capture yet: open a source first."
            )
            return
        if self.window is None:
            self._feed = WorkerFeed(context.worker, context.result, context.playback, self)
            self.window = CaptureWindow(context.document, self._feed, self.store, self.keeper, context.window)
            self.window.saveRequested.connect(self.saveRequested)
            self.window.finished.connect(self._closed)
        self.window.show()
        self.window.raise_()
        self.window.activateWindow()

    def close(self) -> None:
        """Stop capturing, close the window and stop following the preset."""
        if self.window is not None:
            self.window.reject()
        self.keeper.close()

    def _closed(self) -> None:
        if self.window is not None:
            self.window.deleteLater()
        if self._feed is not None:
            self._feed.deleteLater()
        self.window, self._feed = None, None

    def _source_opened(self, info: SourceInfo) -> None:
        self.keeper.source_opened(info)
        if self.window is not None and self._feed is not None:
            self.window.source_changed()
            if info.rig != self._feed.rig:
                self.window.reject()

    def _frame_shown(self) -> None:
        if self._feed is not None and self._context.result is not None:
            self._feed.show_result(self._context.result)
