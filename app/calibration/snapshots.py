"""Taking snapshots: waits for frames and averages them on another thread."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration.snapshots import take_snapshot as take_median
from ...core.model.clouds import valid_depth
from ...core.model.frames import SensorFrame
from ..worker.feed import FrameFeed
from ..worker.jobs import Job, Progress
from ..worker.results import SourceInfo
from .session import Snapshot


def take_snapshot(frames: Sequence[SensorFrame], number: int, info: SourceInfo, progress: Progress) -> Snapshot:
    """Average frames into one snapshot, named after its first frame; frames count from 1."""
    progress(0.0, "Averaging")
    taken = take_median(frames)
    last = number + frames[-1].sequence - frames[0].sequence
    name = f"Frame {number}" if len(frames) == 1 else f"Frames {number} to {last}"
    moved = moved_m(frames, info.rig.tactile.depth_unit_m)
    return Snapshot(taken.sha256, name, taken.frame, len(frames), moved, info.name)


def moved_m(frames: Sequence[SensorFrame], unit_m: float) -> float:
    """Return how much the tactile depth changed from the first to the last frame, metres.

    This is the 95th percentile over the pixels: sensitive to a small moving object, robust to noise.
    """
    before, after = frames[0].tactile_depth[::4, ::4], frames[-1].tactile_depth[::4, ::4]
    valid = valid_depth(before) & valid_depth(after)
    if not valid.any() or len(frames) == 1:
        return 0.0
    change = np.abs(before[valid].astype(np.float64) - after[valid]) * unit_m
    return float(np.percentile(change, 95))


#: Movement of the membrane that blurs an averaged frame, metres; the noise of real cameras stays below.
MOVED_LIMIT_M = 0.0025
#: Upper limit of frames to average; more would take gigabytes and add nothing.
MAX_FRAMES = 60
_WAITING_SHARE = 0.5


class Collector(QObject):
    """Averages the next frames of a feed into one snapshot: fewer where a recording ends.

    A recording is read frame by frame, because frames that play may be dropped. From a paused frame on, only those are
    averaged that show the membrane in the same place.

    ``asked`` is the number of frames that were asked for, ``moved_on`` whether the snapshot ended where the membrane
    moves away from the paused frame.
    """

    progress = pyqtSignal(float, str)
    taken = pyqtSignal(object)
    failed = pyqtSignal(str)  # empty if the job was cancelled

    def __init__(self, feed: FrameFeed, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._feed = feed
        self._frames: list[SensorFrame] = []
        self._number = 0  # of the first frame, from 1
        self._index = -1  # of the last frame taken
        self._wanted = 0
        self.asked = 0
        self.moved_on = False
        self._return_to: int | None = None  # index of the paused frame from which it started
        self._goes_on = False  # whether the recording played before, and will again
        self._job = Job(self)
        self._job.progress.connect(
            lambda share, words: self.progress.emit(_WAITING_SHARE + (1 - _WAITING_SHARE) * share, words)
        )
        self._job.done.connect(self._done)
        self._job.failed.connect(self.failed)
        feed.frameArrived.connect(self._take)

    @property
    def busy(self) -> bool:
        """Whether a snapshot is being taken."""
        return self._wanted > 0 or self._job.busy

    def start(self, count: int) -> None:
        """Use the current frame and the following ones, ``count`` in total, or as many as there are."""
        frame, playback = self._feed.frame, self._feed.playback
        if self.busy:
            return
        self._frames, self._wanted = [], max(1, min(count, MAX_FRAMES))
        self.asked, self.moved_on = self._wanted, False
        self._number, self._index = playback.index + 1, -1
        still = not playback.playing or playback.frozen
        self._return_to = playback.index if still and playback.seekable else None
        self._goes_on = playback.seekable and not still
        if self._goes_on:
            self._feed.pause()
        self._take(frame)
        if self._wanted and not playback.seekable:
            self._feed.play()

    def cancel(self) -> None:
        """Stop taking the snapshot."""
        if self._wanted:
            self._end_gathering()
            self.failed.emit("")
        self._job.cancel()

    def close(self) -> None:
        """Stop permanently."""
        if self._wanted:
            self._end_gathering()
        self._job.stop()

    def _take(self, frame: SensorFrame) -> None:
        if not self._wanted or any(frame is old for old in self._frames):
            return
        playback = self._feed.playback
        is_next = not self._frames or playback.index == self._index + 1
        if playback.seekable and not is_next:  # it played before it was paused
            self._feed.seek(self._index + 1)
            return
        if self._return_to is not None and self._frames:  # from a paused frame on
            unit_m = self._feed.info.rig.tactile.depth_unit_m
            self.moved_on = moved_m((self._frames[0], frame), unit_m) > MOVED_LIMIT_M
            if self.moved_on:
                self._average()
                return
        self._index = playback.index
        self._frames.append(frame)
        self.progress.emit(
            _WAITING_SHARE * len(self._frames) / self._wanted, f"Frame {len(self._frames)} of {self._wanted}"
        )
        if len(self._frames) == self._wanted or playback.at_end:
            self._average()
        elif playback.seekable:
            self._feed.seek(playback.index + 1)

    def _average(self) -> None:
        frames, number = tuple(self._frames), self._number
        self._end_gathering()
        self._job.start(lambda progress: take_snapshot(frames, number, self._feed.info, progress))

    def _end_gathering(self) -> None:
        self._wanted, self._frames = 0, []
        if self._return_to is not None:
            self._feed.pause()
            self._feed.seek(self._return_to)
            self._return_to = None
        if self._goes_on:
            self._feed.play()
            self._goes_on = False

    def _done(self, snapshot: Snapshot) -> None:
        self.taken.emit(snapshot)
