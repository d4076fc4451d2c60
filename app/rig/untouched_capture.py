"""Capturing an untouched frame from the displayed frames, and reading the current preset's one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Final

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import FrameError, PresetError
from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord
from ...core.rig.untouched import UntouchedAverage, average_untouched, load_untouched
from ...core.sources.registry import open_source
from ..document.document import Document
from ..document.untouched_store import UntouchedStore
from ..worker.feed import FrameFeed
from ..worker.jobs import Job, Progress
from ..worker.recorder import Recorder
from ..worker.results import SourceInfo

_SIMULATOR: Final = "sim:"
#: Progress at which the simulator's scene is open, and at which its untouched membrane is computed.
_OPENED: Final = 0.3
_PREPARED: Final = 0.7
#: Interval at which cancelling is checked while no frame arrives, seconds.
_WAIT_S: Final = 0.1


@dataclass(frozen=True, eq=False)
class Captured:
    """A captured untouched frame that is already saved on disk."""

    untouched: UntouchedAverage
    record: UntouchedRecord
    asked: int


class Capture(QObject):
    """Averages the next frames of a feed while nothing touches the membrane.

    For the simulator, frames of the same membrane without its object are used. Frames go through a queue to the
    averaging thread, so that none is held longer than necessary.

    Signals
    -------
    progress(share: float, words: str)
    captured(Captured)
    failed(sentence: str)
        Empty where it was cancelled.
    pausedChanged(paused: bool)
        True when playback was paused before all frames arrived, and again with each frame that is stepped to; False
        when frames arrive again or are no longer needed.
    averaging()
        All frames have arrived and are being averaged.
    """

    progress = pyqtSignal(float, str)
    captured = pyqtSignal(object)
    failed = pyqtSignal(str)
    pausedChanged = pyqtSignal(bool)
    averaging = pyqtSignal()

    def __init__(self, feed: FrameFeed, store: UntouchedStore, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._feed, self._store = feed, store
        self._queue: SimpleQueue[SensorFrame | None] = SimpleQueue()
        self._wanted = 0  # frames that are still to come
        #: Number of frames taken so far.
        self.taken = 0
        self._last: SensorFrame | None = None
        self._has_played = False  # since the start
        self._was_running = False  # at the last change of playback
        self._taken_when_resumed = 0
        self._paused = False  # as last signalled
        self._return_to: int | None = None  # index of the paused frame from which it started
        self._job = Job(self)
        self._job.progress.connect(self.progress)
        self._job.done.connect(self._done)
        self._job.failed.connect(self._failed)
        feed.frameArrived.connect(self._take)
        feed.playbackChanged.connect(self._playback_changed)

    @property
    def busy(self) -> bool:
        """Whether frames are being taken or averaged."""
        return self._job.busy

    @property
    def taking(self) -> bool:
        """Whether more frames of the feed are needed."""
        return self._wanted > 0

    def start(self, count: int) -> None:
        """Average the current frame and the following ones, ``count`` in total or the whole recording once."""
        frame, playback, name = self._feed.frame, self._feed.playback, self._feed.info.name
        if self.busy:
            return
        if name.startswith(_SIMULATOR):
            self._job.start(lambda progress: self._simulated(name, count, progress))
            return
        different = count if playback.length is None else min(count, playback.length)
        self._queue, self._wanted, self.taken, self._last = SimpleQueue(), different, 0, None
        queue, still = self._queue, not playback.running
        self._return_to = playback.index if still and playback.seekable else None
        self._has_played = self._was_running = not still
        self._taken_when_resumed = 0
        shift = playback.index + 1 - frame.sequence
        self._job.start(lambda progress: self._average(_arriving(queue, different, progress), count, shift))
        self._take(frame)
        if self._wanted and still:
            self._feed.play()

    def go_on(self) -> None:
        """Continue after a pause."""
        self._feed.play()

    def use_taken(self) -> None:
        """Take no more frames and average those that arrived."""
        if self._wanted:
            self._queue.put(None)
            self._stop_taking()

    def cancel(self) -> None:
        """Cancel; the preset stays as it is."""
        self._restore_playback()
        self._job.cancel()

    def close(self) -> None:
        """Stop permanently."""
        self._wanted = 0
        self._job.stop()

    def _take(self, frame: SensorFrame) -> None:
        if not self._wanted or frame is self._last:
            return
        self._last = frame
        self._queue.put(frame)
        self._wanted -= 1
        self.taken += 1
        if not self._wanted:
            self._stop_taking()
        elif self._paused:
            self.pausedChanged.emit(True)

    def _playback_changed(self) -> None:
        """Average what arrived if the recording has ended; wait if playback was paused.

        A truncated recording, shorter than it states, pauses like any other but gives no frame when it continues.
        """
        playback = self._feed.playback
        if playback.running and not self._was_running:
            self._taken_when_resumed = self.taken
        halted = self._was_running and not playback.running
        self._was_running = playback.running
        self._has_played = self._has_played or playback.running
        stopped = self._has_played and not playback.running
        ended = stopped and playback.at_end and not playback.loop
        truncated = halted and playback.seekable and self.taken == self._taken_when_resumed
        if ended or truncated:
            self.use_taken()
        self._set_paused(stopped and self._wanted > 0)

    def _set_paused(self, paused: bool) -> None:
        if paused != self._paused:
            self._paused = paused
            self.pausedChanged.emit(paused)

    def _stop_taking(self) -> None:
        self._restore_playback()
        self.averaging.emit()

    def _restore_playback(self) -> None:
        self._wanted = 0
        self._set_paused(False)
        if self._return_to is not None:
            self._feed.pause()
            self._feed.seek(self._return_to)
            self._return_to = None

    def _simulated(self, name: str, count: int, progress: Progress) -> Captured:
        # imported here: only the simulator needs it
        from ...core.rig.untouched import frames_to_average

        def opening(share: float, words: str) -> None:
            progress(_OPENED * share, words)

        def untouched(share: float, words: str) -> None:
            progress(_OPENED + (_PREPARED - _OPENED) * share, words)

        with open_source(name, opening) as source, frames_to_average(source, count, untouched) as frames:
            return self._average(_counted_out(frames, count, progress), count)

    def _average(self, frames: Iterator[SensorFrame], asked: int, shift: int = 0) -> Captured:
        """Average frames. Errors name frames by their sequence number plus ``shift``."""
        averaged = average_untouched(replace(frame, sequence=frame.sequence + shift) for frame in frames)
        averaged = replace(averaged, frame=replace(averaged.frame, sequence=averaged.frame.sequence - shift))
        return Captured(averaged, self._store.keep(averaged.frame, averaged.frames), asked)

    def _done(self, captured: Captured) -> None:
        self._restore_playback()
        self.captured.emit(captured)

    def _failed(self, sentence: str) -> None:
        self._restore_playback()
        self.failed.emit(sentence)


def _arriving(queue: SimpleQueue[SensorFrame | None], count: int, progress: Progress) -> Iterator[SensorFrame]:
    """Yield frames as they arrive, until there are enough or the source ends."""
    for number in range(count):
        frame: SensorFrame | None = None
        arrived = False
        while not arrived:
            progress(number / count, f"Frame {number + 1} of {count}")
            with suppress(Empty):
                frame = queue.get(timeout=_WAIT_S)
                arrived = True
        if frame is None:
            break
        yield frame
    progress(1.0, "Averaging")


def _counted_out(frames: Iterable[SensorFrame], count: int, progress: Progress) -> Iterator[SensorFrame]:
    for number, frame in enumerate(frames):
        progress(_PREPARED + (1.0 - _PREPARED) * number / count, f"Frame {number + 1} of {count}")
        yield frame


class UntouchedKeeper(QObject):
    """Reads the untouched frame of the current preset, on its own thread.

    A preset from a recording has no folder. Its untouched frame is copied from the recording to the store, and is
    saved from there.

    Signals
    -------
    changed()
        `frame` has changed.
    """

    changed = pyqtSignal()

    def __init__(self, document: Document, recorder: Recorder, store: UntouchedStore, parent: QObject) -> None:
        super().__init__(parent)
        self._document, self._recorder, self._store = document, recorder, store
        self._info: SourceInfo | None = None
        self._key: object = None
        self._job = Job(self)
        self._job.done.connect(self._use)
        document.presetChanged.connect(self._look)
        document.fileChanged.connect(self._look)
        self._look()

    @property
    def frame(self) -> SensorFrame | None:
        """The preset's untouched frame; None if there is none, if it cannot be read, or while it is being read."""
        return self._recorder.untouched

    @property
    def busy(self) -> bool:
        """Whether the untouched frame is still being read."""
        return self._job.busy

    def source_opened(self, info: SourceInfo) -> None:
        """Check whether this source contains the preset's untouched frame."""
        self._info = info
        self._look()

    def close(self) -> None:
        """Stop permanently."""
        self._job.stop()

    def _look(self) -> None:
        preset, home = self._document.preset, self._document.untouched_home
        key = (preset.untouched, home, self._info)
        if key == self._key:
            return
        self._key = key
        self._job.cancel()  # its result would belong to another preset or source
        if preset.untouched is not None:
            self._job.start(partial(_read, preset.untouched, preset, home, self._info, self._store))
        self._use(None)

    def _use(self, frame: SensorFrame | None) -> None:
        self._recorder.untouched = frame
        self.changed.emit()


def _read(
    record: UntouchedRecord,
    preset: Preset,
    home: Path | None,
    info: SourceInfo | None,
    store: UntouchedStore,
    progress: Progress,
) -> SensorFrame | None:
    """Return the preset's untouched frame from its folder, else from the recording that contains both, else None."""
    if home is not None:
        with suppress(PresetError, FrameError):  # reported where the frame is needed
            frame = load_untouched(record, home)
            if info is not None:
                frame.check_against(info.rig)
            return frame
    if info is None or info.preset is None or info.preset.untouched != record:
        return None
    found = info.find_untouched(preset, None, progress)
    if found.frame is None or found.warnings:
        return None
    store.keep(found.frame, record.frames)
    return found.frame
