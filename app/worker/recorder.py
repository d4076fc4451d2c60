"""Records frames into a file, from the thread that reads them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Lock, Thread

from ...core.errors import FrameError, TactuneError
from ...core.model.frames import Rig, SensorFrame
from ...core.output.writer import RecordingStatus, SessionWriter
from ...core.preset import Preset
from .errors import explain


class Recorder:
    """Writes at most one file at a time, from any thread.

    ``ended`` is called for each, on a thread of its own, with the reason if the recording stopped by itself.
    """

    def __init__(
        self, ended: Callable[[RecordingStatus, str], None], writer: Callable[..., SessionWriter] = SessionWriter
    ) -> None:
        self._ended = ended
        self._open = writer
        self._lock = Lock()
        self._writer: SessionWriter | None = None
        self._refused = 0
        self._watcher: tuple[Callable[[SensorFrame], object], Callable[[str], object]] | None = None
        self._finishing: list[Thread] = []

    def status(self) -> RecordingStatus | None:
        writer = self._writer
        return None if writer is None else self._with_refused(writer.status())

    def start(
        self, path: Path, rig: Rig, preset: Preset, frame_rate_hz: float, untouched: SensorFrame | None = None
    ) -> None:
        """Start a file while no recording runs; `TactuneError` if it cannot be written."""
        with self._lock:
            try:
                self._writer = self._open(path, rig, preset=preset, frame_rate_hz=frame_rate_hz, untouched=untouched)
                self._refused = 0
            except OSError as error:
                raise TactuneError(
                    f"{path} cannot be recorded: {error.strerror or error}; choose another folder"
                ) from error

    def watch(self, see: Callable[[SensorFrame], object], failed: Callable[[str], object]) -> None:
        """Pass every frame to ``see`` too, on the thread that reads; if it raises, ``failed`` gets the reason."""
        self._watcher = see, failed

    @property
    def watched(self) -> bool:
        return self._watcher is not None

    def unwatch(self) -> None:
        self._watcher = None

    def put(self, frame: SensorFrame, number: int | None = None) -> None:
        """Record a frame if a recording runs; one that does not fit its rig counts as dropped."""
        number = frame.sequence if number is None else number
        self._show(frame, number)
        if self._writer is None:
            return
        problem = ""
        with self._lock:
            if self._writer is not None:
                try:
                    self._writer.put(frame, wait=False)
                except FrameError:
                    self._refused += 1
                except Exception as error:
                    problem = explain(error, f"frame {number} could not be recorded")
        if problem:
            self.stop(problem)

    def stop(self, reason: str = "") -> None:
        """Stop recording and finish the file; ``ended`` is called when that is done."""
        with self._lock:
            writer, self._writer = self._writer, None
            if writer is None:
                return
            thread = Thread(target=lambda: self._finish(writer, reason), name="recording finisher")
            self._finishing = [*filter(Thread.is_alive, self._finishing), thread]
            thread.start()

    def close(self) -> None:
        self.stop()
        with self._lock:
            finishing, self._finishing = self._finishing, []
        for thread in finishing:
            thread.join()

    def _show(self, frame: SensorFrame, number: int) -> None:
        watcher = self._watcher
        if watcher is None:
            return
        see, failed = watcher
        try:
            see(frame)
        except Exception as error:  # the reading thread must continue
            if self._watcher is watcher:
                self._watcher = None
            failed(explain(error, f"frame {number} could not be used"))

    def _finish(self, writer: SessionWriter, reason: str) -> None:
        try:
            status = writer.close()
        except Exception as error:
            status = writer.status()
            reason = explain(error, f"{status.path} could not be finished")
        self._ended(self._with_refused(status), reason)

    def _with_refused(self, status: RecordingStatus) -> RecordingStatus:
        return replace(status, dropped=status.dropped + self._refused)
