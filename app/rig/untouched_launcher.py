"""What the main window needs to know of untouched frames: capture one, keep it, pass frames on, close."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PyQt6.QtCore import QObject

from ...widgets.basics.message_bar import Severity
from ..calibration.feed import WorkerFeed
from ..document.untouched_store import UntouchedStore
from ..worker.playback import PlaybackState
from .untouched_keeper import UntouchedKeeper
from .untouched_window import CaptureWindow

if TYPE_CHECKING:
    from ..window.main_window import MainWindow
    from ..worker.results import SourceInfo


class UntouchedControls(QObject):
    """Owns the store, follows the preset, and keeps at most one window."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._main = window
        self._playback: PlaybackState | None = None
        self._feed: WorkerFeed | None = None
        self.window: CaptureWindow | None = None
        self.store = UntouchedStore(window.data_folder / "untouched")
        self.store.tidy(window.data_folder)
        window.document.untouched_store = self.store
        window.document.warned.connect(
            lambda sentence: window.messages.show_message("untouched", Severity.WARNING, sentence)
        )
        self.keeper = UntouchedKeeper(window.document, window.worker.recorder, self.store, self)
        window.worker.playbackChanged.connect(self._playback_changed)
        window.worker.opened.connect(self._source_opened)
        window.frameShown.connect(self._frame_shown)
        window.actions_.capture_untouched.triggered.connect(self.open)

    def open(self) -> None:
        """Open the window on the present source, or bring it to the front."""
        main = self._main
        if main.result is None:
            main.messages.show_message(
                "untouched", Severity.WARNING, "There is no frame to capture yet: open a source first."
            )
            return
        if self.window is None:
            self._feed = WorkerFeed(main.worker, main.result, self._playback, self)
            self.window = CaptureWindow(main.document, self._feed, self.store, self.keeper, main)
            self.window.saveRequested.connect(main.actions_.save.trigger)
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

    def _playback_changed(self, state: PlaybackState) -> None:
        self._playback = state

    def _source_opened(self, info: SourceInfo) -> None:
        self.keeper.source_opened(info)
        if self.window is not None and self._feed is not None:
            self.window.source_changed()
            if info.rig != self._feed.rig:
                self.window.reject()

    def _frame_shown(self) -> None:
        if self._feed is not None and self._main.result is not None:
            self._feed.show_result(self._main.result)
