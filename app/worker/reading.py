"""Opening a source and reading its frames: recordings ahead of time, live cameras on their own thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import Protocol

from ...core.errors import TactuneError
from ...core.model.frames import SensorFrame
from ...core.sources.base import CameraOption, CameraRole, FrameSource, Health, Progress
from .errors import explain
from .results import SourceState
from .threads import Mailbox

_PROGRESS_INTERVAL_S = 0.05


@dataclass(frozen=True)
class SourceRequest:
    """A source to open; an ``exclusive`` one, cameras, needs the present source closed first."""

    name: str
    open: Callable[[Progress], FrameSource]
    exclusive: bool = False


class OpeningCancelledError(TactuneError):
    """Opening was cancelled by the user or by another request."""


def open_requested(
    request: SourceRequest, wanted: Callable[[], bool], report: Callable[[float, str], None]
) -> FrameSource:
    last_report_s = 0.0

    def progress(fraction: float, text: str) -> None:
        nonlocal last_report_s
        if not wanted():
            raise OpeningCancelledError(f"opening {request.name} was cancelled")
        if time.perf_counter() - last_report_s > _PROGRESS_INTERVAL_S:
            last_report_s = time.perf_counter()
            report(fraction, text)

    report(0.0, "")
    source = request.open(progress)
    if not wanted():
        source.close()
        raise OpeningCancelledError(f"opening {request.name} was cancelled")
    return source


class FrameReader:
    """Owns an open recording, and reads one frame ahead on its thread; a seek drops that frame."""

    def __init__(self, source: FrameSource) -> None:
        self.source = source
        self._thread = ThreadPoolExecutor(1, "reader")
        self._ahead: tuple[int, Future[SensorFrame | None]] | None = None

    def read(self, index: int) -> SensorFrame | None:
        ahead, self._ahead = self._ahead, None
        if ahead is not None and ahead[0] == index:
            return ahead[1].result()
        return self._thread.submit(self._read, index).result()

    def read_ahead(self, index: int | None) -> None:
        """Start reading the frame that is probably next; `read` raises its errors."""
        if self._ahead is None and index is not None:
            self._ahead = index, self._thread.submit(self._read, index)

    def close(self) -> None:
        """Close the source after the read in progress."""
        self._thread.submit(self.source.close)
        self._thread.shutdown(wait=True)

    def _read(self, index: int) -> SensorFrame | None:
        if self.source.position != index:
            self.source.seek(index)
        return self.source.next_frame()


#: Longest wait for a frame before orders (close, set an option) are obeyed.
POLL_S = 0.05
HEALTH_INTERVAL_S = 0.2
#: Age after which the last frame counts as stale, even if the source reports no problem.
STALE_AFTER_S = 1.0
#: Delay before a failed read is retried.
RETRY_S = 0.25
#: Grace period before a hung driver is abandoned, so that the window can close.
PATIENCE_S = 5.0


class LiveListener(Protocol):
    """Receives events on the reader's thread; every method must return at once."""

    def frame_arrived(self, reader: LiveReader) -> None: ...
    def state_changed(self, reader: LiveReader, state: SourceState) -> None: ...
    def options_changed(self, reader: LiveReader, options: tuple[CameraOption, ...]) -> None: ...
    def option_refused(self, reader: LiveReader, sentence: str) -> None: ...


class LiveReader:
    """Owns an open live source; only its own thread touches it.

    Every frame goes to ``record``; the newest waits for `take`, older ones are dropped and counted.
    An error becomes part of the source's state, and reading is retried, because cameras reconnect.
    """

    def __init__(self, source: FrameSource, record: Callable[[SensorFrame], None], listener: LiveListener) -> None:
        self.source = source
        self._record = record
        self._listener = listener
        self._frames: Mailbox[SensorFrame] = Mailbox()
        self._wishes: dict[tuple[CameraRole, str], float] = {}
        self._wishes_lock = Lock()
        self._closing = Event()
        self._problem = ""
        self._ended = False
        self._last_frame_s = time.monotonic()
        self._looked_s = 0.0
        self._told: SourceState | None = None
        self._cameras: tuple[tuple[str, str, bool], ...] | None = None
        self._thread = Thread(target=self._run, name="live reader", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of frames that were replaced before `take` was called."""
        return self._frames.dropped

    def take(self) -> SensorFrame | None:
        return self._frames.take()

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change a camera setting between two frames; of several waiting values, the newest is used."""
        with self._wishes_lock:
            self._wishes[camera, name] = value

    def close(self) -> None:
        self._closing.set()
        self._thread.join(PATIENCE_S)

    # The thread

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._set_options()
                self._read()
                self._look_after()
        finally:
            self._set_options()
            self.source.close()

    def _read(self) -> None:
        """Read one frame if it arrives within `POLL_S`."""
        if self._ended:
            self._closing.wait(POLL_S)
            return
        try:
            if not self.source.wait(POLL_S):
                return
            frame = self.source.next_frame()
        except Exception as error:
            self._problem = explain(error, f"no frame can be read from {self.source.name}")
            self._closing.wait(RETRY_S)
            return
        if frame is None:
            self._ended = True
            self._problem = f"{self.source.name} has ended: open it again, or choose another source."
            return
        self._problem = ""
        self._last_frame_s = time.monotonic()
        self._record(frame)
        if self._frames.put(frame):
            self._listener.frame_arrived(self)

    def _look_after(self) -> None:
        """Check the source every `HEALTH_INTERVAL_S` and report changes."""
        now = time.monotonic()
        if self._told is not None and now - self._looked_s < HEALTH_INTERVAL_S:
            return
        self._looked_s = now
        try:
            health = self.source.health()
            cameras = tuple((camera.role, camera.serial, camera.state != "missing") for camera in health.cameras)
            if cameras != self._cameras:
                self._cameras = cameras
                self._listener.options_changed(self, self.source.options())
        except Exception as error:
            health = Health(ok=False, message=explain(error, f"{self.source.name} does not report its state"))
        stale = health.stale or self._ended or now - self._last_frame_s > STALE_AFTER_S
        state = SourceState(health, stale, self._problem)
        if state != self._told:
            self._told = state
            self._listener.state_changed(self, state)

    def _set_options(self) -> None:
        with self._wishes_lock:
            wishes, self._wishes = self._wishes, {}
        if not wishes:
            return
        for (camera, name), value in wishes.items():
            try:
                self.source.set_option(camera, name, value)
            except Exception as error:
                sentence = explain(error, f"the {camera} camera refused {name} = {value:g}")
                self._listener.option_refused(self, sentence)
        try:
            self._listener.options_changed(self, self.source.options())
        except Exception as error:
            self._listener.option_refused(self, explain(error, f"{self.source.name} does not report its settings"))
