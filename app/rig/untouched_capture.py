"""Capturing an untouched frame from the frames that are shown, and reading that of the preset in use."""

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
#: Shares of the progress at which the simulator's scene is open, and its untouched membrane is ready.
_OPENED: Final = 0.3
_PREPARED: Final = 0.7
#: How soon a person who cancels is obeyed while no frame comes.
_WAIT_S: Final = 0.1


@dataclass(frozen=True, eq=False)
class Captured:
    """An untouched frame that is kept already, and what it is made of."""

    untouched: UntouchedAverage
    record: UntouchedRecord
    asked: int


class Capture(QObject):
    """Takes the next frames of a feed while nothing touches the membrane.

    The simulator's are those of the same membrane with the object away. Frames go through a queue to
    the thread that averages them, so none is held longer than averaging needs it.

    Signals
    -------
    progress(share: float, words: str)
    captured(Captured)
    failed(sentence: str)
        Empty where it was cancelled.
    pausedChanged(paused: bool)
        Frames have stopped coming, because playback was paused, or one more was taken while they had; or they come
        again, or are no longer needed.
    averaging()
        No more frames are taken; those that came are averaged now.
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
        self._wanted = 0
        #: Frames that were taken so far.
        self.taken = 0
        self._last: SensorFrame | None = None
        self._played = False
        self._running = False
        self._taken_before = 0
        self._paused = False
        self._return_to: int | None = None
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
        """Whether frames of the feed are still to come."""
        return self._wanted > 0

    def start(self, count: int) -> None:
        """Average the frame that is shown and those that follow it, ``count`` in all, or the whole recording once."""
        frame, playback, name = self._feed.frame, self._feed.playback, self._feed.info.name
        if self.busy or frame is None:
            return
        if name.startswith(_SIMULATOR):
            self._job.start(lambda progress: self._simulated(name, count, progress))
            return
        different = count if playback.length is None else min(count, playback.length)
        self._queue, self._wanted, self.taken, self._last = SimpleQueue(), different, 0, None
        queue, still = self._queue, not playback.running
        self._return_to = playback.index if still and playback.seekable else None
        self._played = self._running = not still
        self._taken_before = 0
        shift = playback.index + 1 - frame.sequence
        self._job.start(lambda progress: self._average(_arriving(queue, different, progress), count, shift))
        self._take(frame)
        if self._wanted and still:
            self._feed.play()

    def go_on(self) -> None:
        """Play on after a pause."""
        self._feed.play()

    def make_do(self) -> None:
        """Take no more frames: average those that came."""
        if self._wanted:
            self._queue.put(None)
            self._take_no_more()

    def cancel(self) -> None:
        """Stop; the preset keeps what it has."""
        self._stand_as_before()
        self._job.cancel()

    def close(self) -> None:
        """Stop for good."""
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
            self._take_no_more()
        elif self._paused:
            self.pausedChanged.emit(True)

    def _playback_changed(self) -> None:
        """Make do with what there is where a recording has ended; wait where playback was paused.

        A recording that ends before the length that it states pauses like any other, but gives no frame when it
        is played on.
        """
        playback = self._feed.playback
        if playback.running and not self._running:
            self._taken_before = self.taken
        halted = self._running and not playback.running
        self._running = playback.running
        self._played = self._played or playback.running
        stopped = self._played and not playback.running
        nothing_came = halted and playback.seekable and self.taken == self._taken_before
        if nothing_came or (stopped and playback.at_end and not playback.loop):
            self.make_do()
        self._set_paused(stopped and self._wanted > 0)

    def _set_paused(self, paused: bool) -> None:
        if paused != self._paused:
            self._paused = paused
            self.pausedChanged.emit(paused)

    def _take_no_more(self) -> None:
        self._stand_as_before()
        self.averaging.emit()

    def _stand_as_before(self) -> None:
        self._wanted = 0
        self._set_paused(False)
        if self._return_to is not None:
            self._feed.pause()
            self._feed.seek(self._return_to)
            self._return_to = None

    def _simulated(self, name: str, count: int, progress: Progress) -> Captured:
        # only the simulator's frames need what it is made of
        from ...core.rig.untouched import frames_to_average

        def opening(share: float, words: str) -> None:
            progress(_OPENED * share, words)

        def untouched(share: float, words: str) -> None:
            progress(_OPENED + (_PREPARED - _OPENED) * share, words)

        with open_source(name, opening) as source, frames_to_average(source, count, untouched) as frames:
            return self._average(_counted_out(frames, count, progress), count)

    def _average(self, frames: Iterator[SensorFrame], asked: int, shift: int = 0) -> Captured:
        """Average frames; errors name them by their numbers ``shift`` further on, the untouched frame keeps its own."""
        averaged = average_untouched(replace(frame, sequence=frame.sequence + shift) for frame in frames)
        averaged = replace(averaged, frame=replace(averaged.frame, sequence=averaged.frame.sequence - shift))
        return Captured(averaged, self._store.keep(averaged.frame, averaged.frames), asked)

    def _done(self, captured: Captured) -> None:
        self._stand_as_before()
        self.captured.emit(captured)

    def _failed(self, sentence: str) -> None:
        self._stand_as_before()
        self.failed.emit(sentence)


def _arriving(queue: SimpleQueue[SensorFrame | None], count: int, progress: Progress) -> Iterator[SensorFrame]:
    """Yield frames as they come, until there are enough or the source ends."""
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
    """Reads the untouched frame of whichever preset is in use, on a thread of its own.

    A preset that came out of a recording has no folder: its untouched frame is taken from the recording into
    the store, from which it is saved.

    Signals
    -------
    changed()
        `frame` is another.
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
        """The untouched frame of the preset; None where it has none, or none that can be read, or not yet."""
        return self._recorder.untouched

    @property
    def busy(self) -> bool:
        """Whether the untouched frame is still being read."""
        return self._job.busy

    def source_opened(self, info: SourceInfo) -> None:
        """Look whether this source holds the preset's untouched frame."""
        self._info = info
        self._look()

    def close(self) -> None:
        """Stop, for good."""
        self._job.stop()

    def _look(self) -> None:
        preset, home = self._document.preset, self._document.untouched_home
        key = (preset.untouched, home, self._info)
        if key == self._key:
            return
        self._key = key
        self._job.cancel()  # what it finds is another preset's or source's
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
    """Return the preset's own untouched frame from where it lies, else from the recording that held both, else None."""
    if home is not None:
        with suppress(PresetError, FrameError):  # whoever needs it says so
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
