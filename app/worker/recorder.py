"""The recording that is running, if any: frames go in from the thread that reads them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock, Thread
from typing import Protocol

from ...core.errors import FrameError, TactuneError
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.recording.writer import RecordingStatus, SessionWriter
from .errors import explain


class Writer(Protocol):
    """What a recorder asks of a file that is being written; see `SessionWriter`."""

    def put(self, frame: SensorFrame, *, wait: bool) -> bool:
        """Take a frame; False where there was no room for it."""

    def status(self) -> RecordingStatus:
        """Return how far the file is."""

    def close(self) -> RecordingStatus:
        """Finish the file."""


@dataclass(frozen=True)
class RecordingRequest:
    """What to record into which file."""

    path: Path
    rig: Rig
    preset: Preset
    frame_rate_hz: float
    untouched: SensorFrame | None = None


@dataclass(frozen=True)
class RecordingEnd:
    """How a recording ended: the finished file, and why where nobody asked for it."""

    status: RecordingStatus
    reason: str = ""


@dataclass(frozen=True)
class _Watcher:
    """Somebody who is shown every frame."""

    see: Callable[[SensorFrame], object]
    failed: Callable[[str], object]


def open_writer(request: RecordingRequest) -> Writer:
    """Begin a file."""
    return SessionWriter(
        request.path,
        request.rig,
        preset=request.preset,
        frame_rate_hz=request.frame_rate_hz,
        untouched=request.untouched,
    )


class Recorder:
    """Writes at most one file at a time; every method may be called from any thread.

    Parameters
    ----------
    ended : callable
        Told of each finished file, on a thread of its own: finishing one takes as long as its disk.
    writer : callable
        Makes the writer of a file.
    """

    def __init__(
        self, ended: Callable[[RecordingEnd], None], writer: Callable[[RecordingRequest], Writer] = open_writer
    ) -> None:
        self._ended = ended
        self._open = writer
        self._lock = Lock()
        self._writer: Writer | None = None
        self._refused = 0
        self._watcher: _Watcher | None = None
        #: The preset's untouched frame, which recordings hold instead of the source's.
        self.untouched: SensorFrame | None = None
        self._finishing: list[Thread] = []

    @property
    def running(self) -> bool:
        """Whether frames are being recorded."""
        return self._writer is not None

    def status(self) -> RecordingStatus | None:
        """Return how far the recording is, or None where there is none."""
        writer = self._writer
        return None if writer is None else self._with_refused(writer.status())

    def start(self, request: RecordingRequest) -> None:
        """Begin a file; a recording that is running goes on instead.

        Raises
        ------
        TactuneError
            The file cannot be written.
        """
        with self._lock:
            if self._writer is not None:
                return
            if self.untouched is not None:
                request = replace(request, untouched=self.untouched)
            try:
                self._writer = self._open(request)
                self._refused = 0
            except OSError as error:
                raise TactuneError(
                    f"{request.path} cannot be recorded: {error.strerror or error}; choose another folder"
                ) from error

    def watch(self, see: Callable[[SensorFrame], object], failed: Callable[[str], object]) -> None:
        """Show every frame to somebody else, too, on the thread that reads it.

        Whoever cannot take a frame is told why through ``failed``, on that thread, and is shown no more.
        """
        self._watcher = _Watcher(see, failed)

    def unwatch(self) -> None:
        """Show frames to nobody else any more."""
        self._watcher = None

    def put(self, frame: SensorFrame, number: int | None = None, *, wait: bool = False) -> None:
        """Record a frame, if there is a recording; one that does not fit its rig counts as dropped.

        Parameters
        ----------
        frame : SensorFrame
        number : int, optional
            As windows show it, for messages; default: that of a live frame.
        wait : bool
            Wait while the disk is behind. Live frames do not wait: what finds no room is counted.
        """
        number = frame.sequence + 1 if number is None else number
        self._show(frame, number)
        if self._writer is None:
            return
        problem = ""
        with self._lock:
            if self._writer is not None:
                try:
                    self._writer.put(frame, wait=wait)
                except FrameError:
                    self._refused += 1
                except Exception as error:
                    problem = explain(error, f"frame {number} could not be recorded")
        if problem:
            self.stop(problem)

    def stop(self, reason: str = "") -> None:
        """Take no more frames and finish the file; ``ended`` is told once that is done."""
        with self._lock:
            writer, self._writer = self._writer, None
            if writer is None:
                return
            thread = Thread(target=lambda: self._finish(writer, reason), name="recording finisher")
            self._finishing = [*filter(Thread.is_alive, self._finishing), thread]
            thread.start()

    def close(self) -> None:
        """Finish the file and wait until it lies on the disk."""
        self.stop()
        with self._lock:
            finishing, self._finishing = self._finishing, []
        for thread in finishing:
            thread.join()

    def _show(self, frame: SensorFrame, number: int) -> None:
        watcher = self._watcher
        if watcher is None:
            return
        try:
            watcher.see(frame)
        except Exception as error:  # the thread that reads must go on
            if self._watcher is watcher:
                self._watcher = None
            watcher.failed(explain(error, f"frame {number} could not be watched"))

    def _finish(self, writer: Writer, reason: str) -> None:
        try:
            status = writer.close()
        except Exception as error:
            status = writer.status()
            reason = explain(error, f"{status.path} could not be finished")
        self._ended(RecordingEnd(self._with_refused(status), reason))

    def _with_refused(self, status: RecordingStatus) -> RecordingStatus:
        return replace(status, dropped=status.dropped + self._refused)
