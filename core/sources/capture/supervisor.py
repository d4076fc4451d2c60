"""Supervises the capture process: receives its frames, detects when it dies or hangs, restarts it."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field, replace
from threading import Condition, Event, Thread, current_thread
from typing import Any, Final

from ...errors import SourceError, TactuneError
from ...model.frames import DepthCamera, Rig, SensorFrame
from ..base import CameraRole, Health, Progress
from .launch import CaptureProcess, ending_in_words
from .protocol import (
    SLOTS,
    Call,
    Ended,
    Failure,
    FrameReady,
    GiveBack,
    Heartbeat,
    Opened,
    Opening,
    Reply,
    Ring,
    Start,
    frame_of,
)

#: Longest queue of frames of a live source; then the oldest frame is dropped.
_MAX_WAITING: Final = SLOTS - 2
#: Seconds that a notice stays in the health message.
_NOTICE_S: Final = 10.0
_CALL_S: Final = 3.0
#: Longest wait for a message of the process, seconds.
_POLL_S: Final = 0.1
#: Seconds without a heartbeat after which the process counts as hung: while it opens the source, because a driver may
#: hold the interpreter lock; while a camera is stalled or missing; otherwise.
_SILENT_OPENING_S: Final = 20.0
_SILENT_TROUBLE_S: Final = 5.0
_SILENT_S: Final = 1.0
#: Longest call of the source, seconds: opening without progress, the first frame, later frames.
_BUSY_OPENING_S: Final = 120.0
_BUSY_FIRST_FRAME_S: Final = 20.0
_BUSY_S: Final = 1.5
#: A wait of `_POLL_S` that takes longer than this is not counted: the machine is too busy, seconds.
_LATE_S: Final = 0.25
#: Pauses before the first, second and further restarts, seconds.
_PAUSES_S: Final = (0.0, 0.2, 0.5, 1.0, 2.0)
#: Message of each camera during a restart.
_RESTARTING: Final = "The capture process is being restarted."
#: A process that has captured this long has recovered, seconds.
_RECOVERED_S: Final = 5.0


class Supervisor:
    """One thread that runs one capture process at a time; one condition guards all state.

    Parameters
    ----------
    start : Start
        First message to each process. A lossless source is not restarted: frames would be missing.
    """

    def __init__(self, start: Start) -> None:
        self._start = start
        self._changed = Condition()
        self._stop = Event()
        self._process: CaptureProcess | None = None
        self._serving: CaptureProcess | None = None
        self._waiting: deque[tuple[CaptureProcess, Ring, FrameReady]] = deque()
        self._opening = Opening(0.0, "")
        self._opened: Opened | None = None
        self._error: TactuneError | None = None
        self._ended = False
        self._stale = False
        self._notice = ""
        self._notice_until_s = 0.0
        self._record = HealthRecord()
        self._numbering = Numbering()
        self._numbers = itertools.count()
        self._replies: dict[int, Reply | None] = {}
        self._options: dict[tuple[CameraRole, str], float] = {}
        self._thread = Thread(target=self._supervise, name="capture supervisor", daemon=True)
        self._thread.start()

    # From any thread

    def wait_until_open(self, progress: Progress | None) -> Opened:
        """Wait for the opened source and pass on its progress; an exception of ``progress`` ends the wait.

        Raises
        ------
        TactuneError
            The source cannot be opened; class and sentence as in the capture process.
        """
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._opened is not None or self._finished, _POLL_S)
                opened, error, opening = self._opened, self._error, self._opening
            if opened is not None:
                return opened
            if error is not None:
                raise type(error)(str(error))
            if progress is not None:
                progress(opening.fraction, opening.text)

    def wait(self, timeout_s: float) -> bool:
        """Wait until `next_frame` does not block."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._waiting) or self._finished, timeout_s)

    def next_frame(self) -> SensorFrame | None:
        """Wait for a frame and return the oldest one; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._waiting) or self._finished)
            if not self._waiting:
                if self._error is not None:
                    raise type(self._error)(str(self._error))
                return None
            process, ring, ready = self._waiting.popleft()
        arrays = ring.read(ready.slot, ready.places)
        self._give_back(process, ready.slot)
        return frame_of(ready, arrays)

    def health(self) -> Health:
        """Return the health of the source and of its process."""
        with self._changed:
            if self._error is not None:
                return self._record.health(str(self._error), stale=True)
            told = time.monotonic() < self._notice_until_s
            return self._record.health(self._notice if told else "", stale=self._stale)

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the source and return what it returns.

        Raises
        ------
        TactuneError
            The source raised it, or the process does not answer.
        """
        number = next(self._numbers)
        with self._changed:
            process = self._serving
            self._replies[number] = None
        try:
            if process is None:
                raise SourceError(f"{self._name}: the capture process is not running at present; try again")
            with suppress(OSError):  # it has just ended, so it does not answer
                process.send(Call(number, method, arguments))
            with self._changed:
                self._changed.wait_for(lambda: self._replies[number] is not None or self._finished, _CALL_S)
                reply = self._replies[number]
        finally:
            with self._changed:
                del self._replies[number]
        if reply is None:
            raise SourceError(f"{self._name}: the capture process has not answered for {_CALL_S:g} s; try again")
        if reply.failure is not None:
            raise reply.failure.error()
        return reply.value

    def remember_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Set this option again after a restart."""
        with self._changed:
            self._options[camera, name] = value

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
            self._keep_capturing()
        except TactuneError as error:
            self._fail(error)
        except Exception as error:  # a caller that waits for a frame must get this error
            self._fail(SourceError(f"{self._name}: capturing failed ({type(error).__name__}: {error})"))
        finally:
            with self._changed:
                if self._stop.is_set():
                    self._waiting.clear()
                    self._error = SourceError(f"{self._name}: the source is closed; open it again")
                self._changed.notify_all()

    def _fail(self, error: TactuneError) -> None:
        with self._changed:
            self._error = error.with_traceback(None)  # otherwise the traceback would keep the shared memory
            self._changed.notify_all()

    def _keep_capturing(self) -> None:
        """Run one capture process after another until the source ends, is closed or cannot continue."""
        failures = 0
        while not self._stop.is_set():
            self._numbering.restart()
            began_s = time.monotonic()
            problem = self._run_process()
            if self._stop.is_set() or self._ended:
                return
            self._take_down(problem)
            failures = 0 if time.monotonic() - began_s >= _RECOVERED_S else failures
            self._stop.wait(_PAUSES_S[min(failures, len(_PAUSES_S) - 1)])
            failures += 1

    def _take_down(self, problem: Failure | str) -> None:
        """Report the problem; raise it before the first frame, or if the source is lossless."""
        first = self._opened is None
        if first or self._start.lossless:
            if isinstance(problem, Failure):
                raise problem.error()
            raise SourceError(f"{self._name}: the capture process {problem}{' while opening' if first else ''}")
        with self._changed:
            self._stale = True
            self._record.restart()
            if isinstance(problem, Failure):
                notice = f"Capturing failed: {problem.sentence.rstrip('.')}. The capture process"
            else:
                notice = f"The capture process {problem} and"
            self._notice, self._notice_until_s = f"{notice} is being restarted.", math.inf

    def _run_process(self) -> Failure | str:
        """Run one process to its end and return why it ended."""
        process = CaptureProcess(self._start)
        hanging = ""
        failure: Failure | None = None
        with self._changed:
            self._process = process
        try:
            hanging, failure = self._serve(process)
        finally:
            with self._changed:
                self._process = self._serving = None
            status = process.end(politely=not hanging)
        return failure or hanging or ending_in_words(status)

    def _serve(self, process: CaptureProcess) -> tuple[str, Failure | None]:
        """Process messages until the process ends or hangs; return the cause."""
        patience = Patience()
        ring: Ring | None = None
        while not self._stop.is_set():
            began_s = time.monotonic()
            try:
                message = process.receive(_POLL_S)
            except (EOFError, OSError):
                break
            if message is None:
                patience.silent(time.monotonic() - began_s)
                if not process.running:
                    break
            else:
                patience.heard(message)
            if patience.problem:
                return patience.problem, None
            if isinstance(message, Failure):
                return "", message
            if isinstance(message, Opened):
                ring = process.map_ring(SLOTS, message.slot_bytes)
                self._use(process, message)
            elif isinstance(message, FrameReady) and ring is not None:
                self._take(process, ring, message)
            elif message is not None:
                self._note(message)
        return "", None

    def _use(self, process: CaptureProcess, opened: Opened) -> None:
        """Continue with a process that has opened the source; check that the rig is the same."""
        with self._changed:
            before, options = self._opened, dict(self._options)
        if before is not None:
            _check_same_rig(before.name, before.rig, opened.rig)
            for (camera, name), value in options.items():
                with suppress(OSError):  # it has ended again, which `_serve` detects
                    process.send(Call(next(self._numbers), "set_option", (camera, name, value)))
            with self._changed:
                self._notice = self._notice.replace("is being restarted.", "has been restarted.")
                self._notice_until_s = time.monotonic() + _NOTICE_S
        with self._changed:
            self._record.heard(opened)
            self._opened = before or opened
            self._serving = process
            self._changed.notify_all()

    def _take(self, process: CaptureProcess, ring: Ring, ready: FrameReady) -> None:
        """Queue a frame; drop the oldest one if the queue is full."""
        oldest = None
        with self._changed:
            self._record.heard(ready)
            self._waiting.append((process, ring, self._numbering.apply(ready)))
            if not self._start.lossless and len(self._waiting) > _MAX_WAITING:
                oldest = self._waiting.popleft()
                self._record.dropped_here += 1
            self._stale = False
            self._changed.notify_all()
        if oldest is not None:
            self._give_back(oldest[0], oldest[2].slot)

    def _note(self, message: Opening | Heartbeat | Reply | Ended) -> None:
        with self._changed:
            if isinstance(message, Opening):
                self._opening = message
            elif isinstance(message, Heartbeat):
                if self._serving is not None:
                    self._record.heard(message)
            elif isinstance(message, Ended):
                self._ended = True
            elif message.number in self._replies:
                self._replies[message.number] = message
            elif message.failure is not None:  # an option that the restarted source refuses
                self._notice = f"{self._notice} {message.failure.sentence}"
            self._changed.notify_all()

    def _give_back(self, process: CaptureProcess, slot: int) -> None:
        with suppress(OSError):  # the process has ended, and its slots no longer exist
            process.send(GiveBack(slot))


class Patience:
    """Decides when a process hangs.

    Silence is counted in waits without a message, not by the clock: while this process itself was stopped, the
    heartbeats of the other one were queued. Waits that lasted far too long are not counted: the machine was busy.
    """

    def __init__(self) -> None:
        self._silent = 0
        self._busy_s = 0.0
        self._silent_limit_s = _SILENT_OPENING_S
        self._busy_limit_s = _BUSY_OPENING_S

    def heard(self, message: object) -> None:
        """Note a message from the process."""
        self._silent = 0
        if isinstance(message, Opened | FrameReady):
            self._busy_s = 0.0  # the call took long, but it returned
        if isinstance(message, Opened):
            self._silent_limit_s, self._busy_limit_s = _SILENT_S, _BUSY_FIRST_FRAME_S
        elif isinstance(message, FrameReady):
            self._busy_limit_s = min(self._busy_limit_s, _BUSY_S)
        elif isinstance(message, Heartbeat):
            self._busy_s = message.busy_s
            if message.health.cameras:  # so the source is open
                well = all(camera.state == "streaming" for camera in message.health.cameras)
                self._silent_limit_s = _SILENT_S if well else _SILENT_TROUBLE_S

    def silent(self, waited_s: float) -> None:
        """Count a wait of `_POLL_S` without a message; the argument is its real duration."""
        if waited_s < _LATE_S:
            self._silent += 1

    @property
    def problem(self) -> str:
        """Why the process counts as hung; empty while it does not."""
        silent_s = self._silent * _POLL_S
        if silent_s >= self._silent_limit_s:
            return f"has given no sign of life for {silent_s:.0f} s"
        if self._busy_s >= self._busy_limit_s:
            return f"has waited {self._busy_s:.1f} s for its source"
        return ""


@dataclass
class Numbering:
    """Keeps sequence numbers and times increasing across restarts."""

    _sequence_shift: int = 0
    _time_shift_s: float = 0.0
    _last_sequence: int | None = None
    _last_time_s: float = 0.0
    _last_clock_s: float = 0.0
    _restarted: bool = False

    def restart(self) -> None:
        """The next frame comes from another process."""
        self._restarted = self._last_sequence is not None

    def apply(self, ready: FrameReady) -> FrameReady:
        """Return the frame with its final sequence number and times."""
        clock_s = time.monotonic()
        if self._restarted and self._last_sequence is not None:
            self._restarted = False
            self._sequence_shift = self._last_sequence + 1 - ready.sequence
            going_on_s = self._last_time_s + clock_s - self._last_clock_s
            starts_over = ready.proximity_time_s <= self._last_time_s
            self._time_shift_s = going_on_s - ready.proximity_time_s if starts_over else 0.0
        shifted = replace(
            ready,
            sequence=ready.sequence + self._sequence_shift,
            proximity_time_s=ready.proximity_time_s + self._time_shift_s,
            tactile_time_s=ready.tactile_time_s + self._time_shift_s,
        )
        self._last_sequence, self._last_time_s, self._last_clock_s = (
            shifted.sequence,
            shifted.proximity_time_s,
            clock_s,
        )
        return shifted


@dataclass
class HealthRecord:
    """The source's health across restarts."""

    _now: Health = field(default_factory=Health)
    _lost: int = 0
    _no_slot: int = 0
    _unmatched: int = 0
    dropped_here: int = 0

    def heard(self, message: object) -> None:
        """Note the health in a message."""
        if isinstance(message, Opened | Heartbeat):
            self._now = message.health
        elif isinstance(message, FrameReady):
            self._no_slot = message.dropped

    def restart(self) -> None:
        """Keep the counts and mark the cameras as stalled."""
        now = self._now
        self._lost += now.dropped + self._no_slot
        self._unmatched += now.unmatched
        self._no_slot = 0
        cameras = tuple(replace(camera, state="stalled", message=_RESTARTING) for camera in now.cameras)
        self._now = Health(cameras=cameras)

    def health(self, notice: str, *, stale: bool) -> Health:
        """Return the health with a notice before its message; ``stale``: no frame since a restart."""
        now = self._now
        return replace(
            now,
            ok=now.ok and not stale,
            message=" ".join(filter(None, (notice, now.message))),
            dropped=self._lost + self._no_slot + self.dropped_here + now.dropped,
            stale=now.stale or stale,
            unmatched=self._unmatched + now.unmatched,
        )


def _check_same_rig(name: str, before: Rig, now: Rig) -> None:
    """Raise `SourceError` if the rig after a restart is another one than before."""
    for role, old, new in (
        ("proximity", before.proximity, now.proximity),
        ("tactile", before.tactile, now.tactile),
    ):
        if old.intrinsics.shape != new.intrinsics.shape:
            raise SourceError(
                f"{name}: after a restart the {role} camera gives {_size(new)} pixels instead of {_size(old)}; "
                "open the source again"
            )
        if old.serial != new.serial or old.depth_unit_m != new.depth_unit_m:
            raise SourceError(
                f"{name}: after a restart the {role} camera is {_name(new)} instead of {_name(old)}; "
                "open the source again"
            )
    if before.proximity_color_shape != now.proximity_color_shape:
        (old_v, old_u), (new_v, new_u) = before.proximity_color_shape, now.proximity_color_shape
        raise SourceError(
            f"{name}: after a restart the proximity colour image is {new_u} x {new_v} pixels instead of "
            f"{old_u} x {old_v}; open the source again"
        )


def _size(camera: DepthCamera) -> str:
    return f"{camera.intrinsics.width} x {camera.intrinsics.height}"


def _name(camera: DepthCamera) -> str:
    return f"{camera.model} {camera.serial} with a depth unit of {camera.depth_unit_m:g} m"
