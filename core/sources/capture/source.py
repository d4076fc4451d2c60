"""A source that is opened in a separate process, which is started again when it dies, hangs or fails."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from dataclasses import replace
from multiprocessing.shared_memory import SharedMemory
from multiprocessing.util import Finalize
from threading import Condition, Event, Thread, current_thread
from typing import Any, Final

from ...errors import SourceError, TactuneError
from ...model.frames import DepthCamera, Rig, SensorFrame
from ..base import CameraOption, CameraRole, FrameSource, Health, Progress
from .process import POLL_S, CaptureProcess, Patience
from .protocol import (
    SLOTS,
    Call,
    Ended,
    FrameReady,
    GiveBack,
    Heartbeat,
    Opened,
    Opener,
    Opening,
    Reply,
    Start,
    read_frame,
)

#: Longest queue of frames of a live source; then the oldest frame is dropped.
_MAX_WAITING: Final = SLOTS - 2
#: Seconds that a notice stays in the health message.
_NOTICE_S: Final = 10.0
_CALL_S: Final = 3.0
#: Pause before a restart where the process did not capture for long, seconds.
_PAUSE_S: Final = 0.5
_SOON_S: Final = 5.0


class ProcessSource(FrameSource):
    """A live source in a separate process.

    Frames come through shared memory, copied once. A capture process that dies, hangs or fails is restarted. Meanwhile
    `health` states the cause and marks the last frame as stale, and `wait` returns False. Sequence numbers and times
    keep increasing. Frames that are not fetched in time are dropped, the oldest first, and counted in `health`. All
    methods may be called from any thread.

    ``opener`` is called in the capture process with a progress callable. It is pickled, so it must be a function of a
    module (not of the main script or a notebook), or `functools.partial` of one. An exception of ``progress`` cancels
    opening. With ``lossless`` no frame is dropped: the capture process waits for the caller, and after a failure
    `next_frame` raises an error. Errors of opening have the class and message that they have without the process.
    """

    def __init__(self, opener: Opener, progress: Progress | None = None, *, lossless: bool = False) -> None:
        self._supervisor = Supervisor(Start(opener, lossless))
        # Also called when an unclosed source is collected, and at exit before multiprocessing waits for its processes.
        self._close = Finalize(self, self._supervisor.stop, exitpriority=10)
        try:
            opened = self._supervisor.wait_until_open(progress)
        except BaseException:
            self._close()
            raise
        self.name = opened.name
        self._rig = opened.rig
        self._frame_rate_hz = opened.frame_rate_hz

    @property
    def rig(self) -> Rig:
        """The rig that takes the frames."""
        return self._rig

    @property
    def frame_rate_hz(self) -> float:
        """The rate at which frames are taken, in Hz."""
        return self._frame_rate_hz

    @property
    def capture_pid(self) -> int | None:
        """Process number of the capture process; None while it is not running."""
        return self._supervisor.pid

    def next_frame(self) -> SensorFrame | None:
        """Return the next frame, or None at the end; block until there is one. `TactuneError` if it cannot continue."""
        return self._supervisor.next_frame()

    def wait(self, timeout_s: float) -> bool:
        """Wait until `next_frame` will not block, at most ``timeout_s``; return whether it will not."""
        return self._supervisor.wait(timeout_s)

    def health(self) -> Health:
        """Return the health of the source and of its process."""
        return self._supervisor.health()

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings of the cameras; `SourceError` if the capture process does not answer in time."""
        options: tuple[CameraOption, ...] = self._supervisor.call("options")
        return options

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change one setting of a camera; it is kept when the capture process is restarted."""
        self._supervisor.call("set_option", camera, name, value)
        self._supervisor.kept_options[camera, name] = value

    def untouched(self) -> SensorFrame | None:
        """Return a frame of the untouched membrane, or None if the source has none."""
        untouched: SensorFrame | None = self._supervisor.call("untouched")
        return untouched

    def close(self) -> None:
        """End the capture process. Closing twice is harmless."""
        self._close()


class Supervisor:
    """One thread that runs one capture process at a time; one condition guards all state."""

    def __init__(self, start: Start) -> None:
        self.kept_options: dict[tuple[CameraRole, str], float] = {}
        self._start = start
        self._changed = Condition()
        self._stop = Event()
        self._process: CaptureProcess | None = None
        self._serving: CaptureProcess | None = None
        self._waiting: deque[tuple[CaptureProcess, SharedMemory, FrameReady]] = deque()
        self._opening = Opening(0.0, "")
        self._opened: Opened | None = None
        self._error: TactuneError | None = None
        self._ended = False
        self._numbers = itertools.count()
        self._replies: dict[int, Reply | None] = {}
        # Health: what the present process says, the counts of the former ones, and what happened to them.
        self._health = Health()
        self._dropped = self._unmatched = 0
        self._stale = False
        self._notice, self._notice_until_s = "", 0.0
        # Numbers and times go on where another process starts over.
        self._last: tuple[CaptureProcess, int, float, float] | None = None
        self._shift = 0, 0.0
        self._thread = Thread(target=self._supervise, name="capture supervisor", daemon=True)
        self._thread.start()

    # From any thread

    def wait_until_open(self, progress: Progress | None) -> Opened:
        """Wait for the opened source and pass on its progress; an exception of ``progress`` ends the wait."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._opened is not None or self._finished, POLL_S)
                opened, error, opening = self._opened, self._error, self._opening
            if opened is not None:
                return opened
            if error is not None:
                raise type(error)(str(error))
            if progress is not None:
                progress(opening.fraction, opening.text)

    def wait(self, timeout_s: float | None) -> bool:
        """Wait until `next_frame` does not block."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._waiting) or self._finished, timeout_s)

    def next_frame(self) -> SensorFrame | None:
        """Wait for a frame and return the oldest one; None at the end."""
        with self._changed:
            self.wait(None)
            if not self._waiting:
                if self._error is not None:
                    raise type(self._error)(str(self._error))
                return None
            process, memory, ready = self._waiting.popleft()
        frame = read_frame(memory, ready)
        process.send(GiveBack(ready.slot))
        with self._changed:
            return self._renumbered(process, frame)

    def _renumbered(self, process: CaptureProcess, frame: SensorFrame) -> SensorFrame:
        """Return a frame whose number and times are later than those of the frames of former processes."""
        now_s = time.monotonic()
        if self._last is not None and self._last[0] is not process:
            _, number, time_s, at_s = self._last
            starts_over = frame.proximity_time_s <= time_s
            self._shift = (
                number + 1 - frame.sequence,
                time_s + now_s - at_s - frame.proximity_time_s if starts_over else 0.0,
            )
        if self._shift != (0, 0.0):
            frame = replace(
                frame,
                sequence=frame.sequence + self._shift[0],
                proximity_time_s=frame.proximity_time_s + self._shift[1],
                tactile_time_s=frame.tactile_time_s + self._shift[1],
            )
        self._last = process, frame.sequence, frame.proximity_time_s, now_s
        return frame

    def health(self) -> Health:
        """Return the health of the source and of its process."""
        with self._changed:
            now, stale = self._health, self._stale or self._error is not None
            notice = str(self._error or (self._notice if time.monotonic() < self._notice_until_s else ""))
            return replace(
                now,
                ok=now.ok and not stale,
                message=" ".join(filter(None, (notice, now.message))),
                dropped=self._dropped + now.dropped,
                stale=now.stale or stale,
                unmatched=self._unmatched + now.unmatched,
            )

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the source and return what it returns; `TactuneError` if the process does not answer."""
        number = next(self._numbers)
        with self._changed:
            process = self._serving
            self._replies[number] = None
        try:
            if process is None:
                raise SourceError(f"{self._name}: the capture process is not running at present; try again")
            process.send(Call(number, method, arguments))
            with self._changed:
                self._changed.wait_for(lambda: self._replies[number] is not None or self._finished, _CALL_S)
                reply = self._replies[number]
        finally:
            with self._changed:
                del self._replies[number]
        if reply is None:
            raise SourceError(f"{self._name}: the capture process has not answered for {_CALL_S:g} s; try again")
        if reply.error is not None:
            raise type(reply.error)(str(reply.error))  # a raised reply would keep itself and the shared memory
        return reply.value

    def stop(self) -> None:
        """End the process and the thread."""
        self._stop.set()
        if self._thread is not current_thread():  # a forgotten source may be collected in any thread
            self._thread.join()

    @property
    def pid(self) -> int | None:
        """Process number of the capture process; None while it is not running."""
        with self._changed:
            return self._process.pid if self._process is not None else None

    @property
    def _finished(self) -> bool:
        return self._ended or self._error is not None

    @property
    def _name(self) -> str:
        return self._opened.name if self._opened is not None else "capture"

    # The thread

    def _supervise(self) -> None:
        try:
            while not (self._stop.is_set() or self._ended):
                began_s = time.monotonic()
                problem = self._run_process()
                if not (self._stop.is_set() or self._ended):
                    self._note_failure(problem)
                    self._stop.wait(_PAUSE_S if time.monotonic() - began_s < _SOON_S else 0.0)
        except TactuneError as error:
            self._error = error.with_traceback(None)  # otherwise the traceback would keep the shared memory
        except Exception as error:  # a caller that waits for a frame must get this error
            self._error = SourceError(f"{self._name}: capturing failed ({type(error).__name__}: {error})")
        finally:
            with self._changed:
                if self._stop.is_set():
                    self._waiting.clear()
                    self._error = SourceError(f"{self._name}: the source is closed; open it again")
                self._changed.notify_all()

    def _run_process(self) -> TactuneError | str:
        """Run one process to its end; return its error, or why it ended."""
        process = CaptureProcess(self._start)
        with self._changed:
            self._process = process
        problem: TactuneError | str = ""
        try:
            problem = self._serve(process)
        finally:
            with self._changed:
                self._process = self._serving = None
            ending = process.end(politely=not (isinstance(problem, str) and problem))
        return problem or ending

    def _serve(self, process: CaptureProcess) -> TactuneError | str:
        """Obey messages until the process ends or hangs; return its error, or how it hangs, or an empty string."""
        patience = Patience()
        memory: SharedMemory | None = None
        while not self._stop.is_set():
            began_s = time.monotonic()
            try:
                message = process.receive()
            except (EOFError, OSError):
                return ""
            if message is None:
                patience.silent(time.monotonic() - began_s)
                if not process.running:
                    return ""
            else:
                patience.heard(message)
            if patience.problem:
                return patience.problem
            if isinstance(message, Opened):
                memory = SharedMemory(message.memory)
                memory.unlink()  # both processes have it, so the system frees it with them
                self._use(process, message)
            elif isinstance(message, FrameReady) and memory is not None:
                self._take(process, memory, message)
            elif isinstance(message, Ended):
                if message.error is not None:
                    return message.error
                with self._changed:
                    self._ended = True
                    self._changed.notify_all()
            elif message is not None:
                self._note(message)
        return ""

    def _use(self, process: CaptureProcess, opened: Opened) -> None:
        """Continue with a process that has opened the source; check that the rig is the same."""
        before = self._opened
        if before is not None:
            _check_same_rig(before.name, before.rig, opened.rig)
            for (camera, name), value in list(self.kept_options.items()):
                process.send(Call(next(self._numbers), "set_option", (camera, name, value)))
        with self._changed:
            if before is not None:
                self._notice = self._notice.replace("is being restarted.", "has been restarted.")
                self._notice_until_s = time.monotonic() + _NOTICE_S
            self._health = opened.health
            self._opened = before or opened
            self._serving = process
            self._changed.notify_all()

    def _take(self, process: CaptureProcess, memory: SharedMemory, ready: FrameReady) -> None:
        """Queue a frame; drop the oldest one if the queue is full."""
        with self._changed:
            self._waiting.append((process, memory, ready))
            oldest = None
            if not self._start.lossless and len(self._waiting) > _MAX_WAITING:
                oldest = self._waiting.popleft()
                self._dropped += 1
            self._stale = False
            self._changed.notify_all()
        if oldest is not None:
            oldest[0].send(GiveBack(oldest[2].slot))

    def _note(self, message: Opening | Heartbeat | Reply) -> None:
        with self._changed:
            if isinstance(message, Opening):
                self._opening = message
            elif isinstance(message, Heartbeat):
                if self._serving is not None:
                    self._health = message.health
            elif message.number in self._replies:
                self._replies[message.number] = message
            elif message.error is not None:  # an option that the restarted source refuses
                self._notice = f"{self._notice} {message.error}"
            self._changed.notify_all()

    def _note_failure(self, problem: TactuneError | str) -> None:
        """Keep the problem for the health message; raise it before the first frame, or if the source is lossless."""
        first = self._opened is None
        if first or self._start.lossless:
            if isinstance(problem, TactuneError):
                raise problem
            raise SourceError(f"{self._name}: the capture process {problem}{' while opening' if first else ''}")
        with self._changed:
            self._stale = True
            if isinstance(problem, TactuneError):
                notice = f"Capturing failed: {str(problem).rstrip('.')}. The capture process"
            else:
                notice = f"The capture process {problem} and"
            self._notice, self._notice_until_s = f"{notice} is being restarted.", math.inf
            now, restarting = self._health, "The capture process is being restarted."
            self._dropped, self._unmatched = self._dropped + now.dropped, self._unmatched + now.unmatched
            self._health = Health(
                cameras=tuple(replace(camera, state="stalled", message=restarting) for camera in now.cameras)
            )


def _check_same_rig(name: str, before: Rig, now: Rig) -> None:
    """Raise `SourceError` if the rig after a restart is another one than before."""

    def facts(camera: DepthCamera) -> str:
        lens = camera.intrinsics
        return f"{camera.model} {camera.serial} with {lens.width} x {lens.height} pixels of {camera.depth_unit_m:g} m"

    for role, old, new in (("proximity", before.proximity, now.proximity), ("tactile", before.tactile, now.tactile)):
        if facts(old) != facts(new):
            raise SourceError(
                f"{name}: after a restart the {role} camera is {facts(new)} instead of {facts(old)}; "
                "open the source again"
            )
    if before.proximity_color_shape != now.proximity_color_shape:
        raise SourceError(f"{name}: after a restart the proximity colour image has another size; open the source again")
