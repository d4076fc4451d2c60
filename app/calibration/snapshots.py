"""Taking snapshots: waits for frames and averages them on another thread."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration.snapshots import take_snapshot as take_median
from ...core.model.clouds import valid_depth
from ...core.model.frames import SensorFrame
from ..worker.jobs import Job
from ..worker.results import SourceInfo
from ..worker.worker import FrameFeed
from .session import Snapshot

#: Frames averaged for a snapshot: noise falls to a third.
FRAMES = 10
#: Movement of the membrane that would blur an averaged frame, metres; the noise of real cameras stays below.
MOVED_LIMIT_M = 0.0025


def take_snapshot(frames: Sequence[SensorFrame], number: int, info: SourceInfo) -> Snapshot:
    """Average frames into one snapshot, named after its first frame; frames count from 1."""
    taken = take_median(frames)
    last = number + frames[-1].sequence - frames[0].sequence
    name = f"Frame {number}" if len(frames) == 1 else f"Frames {number} to {last}"
    return Snapshot(taken.sha256, name, taken.frame, len(frames), info.name)


def moved_m(before: SensorFrame, after: SensorFrame, unit_m: float) -> float:
    """Return the 95th percentile of the tactile depth's change, metres: a small moving object shows, noise does not."""
    first, last = before.tactile_depth[::4, ::4], after.tactile_depth[::4, ::4]
    valid = valid_depth(first) & valid_depth(last)
    if not valid.any():
        return 0.0
    return float(np.percentile(np.abs(first[valid].astype(np.float64) - last[valid]) * unit_m, 95))


class Collector(QObject):
    """Averages a feed's next frames, also of a recording, into a snapshot while the membrane stands still."""

    progress = pyqtSignal(str)
    taken = pyqtSignal(object)
    failed = pyqtSignal(str)

    def __init__(self, feed: FrameFeed, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._feed = feed
        self._frames: list[SensorFrame] = []
        self._gathering = False
        self._before = feed.playback  # when the snapshot began
        #: Whether the last snapshot ended where the membrane moves.
        self.moved_on = False
        self._job = Job(self)
        self._job.done.connect(self.taken)
        self._job.failed.connect(self.failed)
        feed.frameArrived.connect(self._take)

    def start(self) -> None:
        """Take a snapshot; one that waits for frames begins anew."""
        if self._gathering:
            self._end_gathering()
        self._frames, self._gathering, self.moved_on = [], True, False
        self._before = self._feed.playback
        if self._before.seekable and self._before.playing:
            self._feed.pause()
        self._take(self._feed.frame)
        if self._gathering and not self._before.seekable:
            self._feed.play()

    def close(self) -> None:
        """Stop permanently."""
        if self._gathering:
            self._end_gathering()
        self._job.stop()

    def _take(self, frame: SensorFrame) -> None:
        if not self._gathering or any(frame is old for old in self._frames):
            return
        playback, expected = self._feed.playback, self._before.index + len(self._frames)
        if playback.seekable and playback.index != expected:  # it played before it was paused
            self._feed.seek(expected)
            return
        if self._frames and moved_m(self._frames[0], frame, self._feed.rig.tactile.depth_unit_m) > MOVED_LIMIT_M:
            self.moved_on = True
            self._average()
            return
        self._frames.append(frame)
        self.progress.emit(f"Frame {len(self._frames)} of {FRAMES}…")
        if len(self._frames) == FRAMES or playback.at_end:
            self._average()
        elif playback.seekable:
            self._feed.seek(playback.index + 1)

    def _average(self) -> None:
        frames, number = tuple(self._frames), self._before.index + 1
        self._end_gathering()
        self._job.start(lambda _: take_snapshot(frames, number, self._feed.info))

    def _end_gathering(self) -> None:
        self._gathering, self._frames = False, []
        if self._before.playing:
            self._feed.play()
        elif self._before.seekable:
            self._feed.pause()
            self._feed.seek(self._before.index)
