"""Frames for the wizard, from whatever shows them: the main window's worker, or a test."""

from __future__ import annotations

from dataclasses import replace

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.model.frames import Rig, SensorFrame
from .playback import PlaybackState
from .results import Result, SourceInfo
from .worker import Worker


class FrameFeed(QObject):
    """The present source, and the few orders that taking snapshots needs.

    Signals
    -------
    frameArrived(SensorFrame)
    playbackChanged()
        Playing, held or frozen now; `playback` tells.
    """

    frameArrived = pyqtSignal(object)
    playbackChanged = pyqtSignal()

    def __init__(self, info: SourceInfo, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.info = info
        self.frame: SensorFrame | None = None
        self.playback = PlaybackState()

    @property
    def rig(self) -> Rig:
        """The rig that takes the frames."""
        return self.info.rig

    def play(self) -> None:
        """Let frames come."""

    def pause(self) -> None:
        """Stand still."""

    def seek(self, index: int) -> None:
        """Show another frame of a recording."""

    def deliver(self, frame: SensorFrame, playback: PlaybackState) -> None:
        """Pass a frame on."""
        self.frame, self.playback = frame, playback
        self.frameArrived.emit(frame)


class WorkerFeed(FrameFeed):
    """Frames from the worker of the main window, which goes on showing them."""

    def __init__(
        self, worker: Worker, result: Result, playback: PlaybackState | None = None, parent: QObject | None = None
    ) -> None:
        super().__init__(result.source, parent)
        self._worker = worker
        shown = result.playback
        self.frame = result.frame
        self.playback = replace(playback or shown, index=shown.index, length=shown.length)
        worker.playbackChanged.connect(self._playback_changed)

    def play(self) -> None:
        """Let frames come."""
        self._worker.play()

    def pause(self) -> None:
        """Stand still."""
        self._worker.pause()

    def seek(self, index: int) -> None:
        """Show another frame of a recording."""
        self._worker.seek(index)

    def show_result(self, result: Result) -> None:
        """Take what the main window shows, unless it is the same frame processed again or of another rig."""
        if result.frame is self.frame:
            return
        if result.source is not self.info:
            if result.source.rig != self.info.rig:
                return
            self.info = result.source
        self.deliver(result.frame, replace(self.playback, index=result.playback.index, length=result.playback.length))

    def _playback_changed(self, state: PlaybackState) -> None:
        """Take the orders' effect, which no frame tells while the source stands still."""
        self.playback = replace(state, index=self.playback.index)
        self.playbackChanged.emit()
