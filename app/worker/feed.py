"""Frames of the current source for other windows, from the main window's worker."""

from __future__ import annotations

from dataclasses import replace

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.model.frames import Rig, SensorFrame
from .playback import PlaybackState
from .results import Result
from .worker import Worker


class FrameFeed(QObject):
    """The current source, its newest frame, and the controls that taking snapshots needs.

    The main window, whose worker it is, continues to show the frames.

    Signals
    -------
    frameArrived(SensorFrame)
    playbackChanged()
        `playback` has changed: playing, paused or frozen.
    """

    frameArrived = pyqtSignal(object)
    playbackChanged = pyqtSignal()

    def __init__(
        self, worker: Worker, result: Result, playback: PlaybackState | None = None, parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        shown = result.playback
        self.info = result.source
        self.frame: SensorFrame = result.frame
        self.playback = replace(playback or shown, index=shown.index, length=shown.length)
        self.play, self.pause, self.seek = worker.play, worker.pause, worker.seek
        worker.playbackChanged.connect(self._playback_changed)

    @property
    def rig(self) -> Rig:
        return self.info.rig

    def show_result(self, result: Result) -> None:
        """Deliver the frame of a result, unless it was delivered before or is of another rig."""
        if result.frame is self.frame:
            return
        if result.source is not self.info:
            if result.source.rig != self.info.rig:
                return
            self.info = result.source
        self.deliver(result.frame, replace(self.playback, index=result.playback.index, length=result.playback.length))

    def deliver(self, frame: SensorFrame, playback: PlaybackState) -> None:
        self.frame, self.playback = frame, playback
        self.frameArrived.emit(frame)

    def _playback_changed(self, state: PlaybackState) -> None:
        """Note a new state of playback; while the source is paused, no frame reports it."""
        self.playback = replace(state, index=self.playback.index)
        self.playbackChanged.emit()
