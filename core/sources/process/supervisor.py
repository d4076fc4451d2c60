"""Looks after the capture process: takes its frames, notices when it dies or hangs, starts it again."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from contextlib import suppress
from threading import Condition, Event, Thread, current_thread
from typing import Any, Final

from ...errors import SourceError, TactuneError
from ...model.frames import SensorFrame
from ..base import CameraRole, Health, Progress
from .launch import CaptureProcess, ending_in_words
from .messages import (
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
    Start,
    frame_of,
)
from .ring import Ring
from .watch import POLL_S, HealthRecord, Numbering, Patience, Pauses, check_same_rig

#: A live source keeps so many frames for a caller that is late; then the oldest is dropped.
_MOST_WAITING: Final = SLOTS - 2
#: What has happened is told so long, seconds.
_NOTICE_S: Final = 10.0
_CALL_S: Final = 3.0


class Supervisor:
    """One thread that looks after one capture process at a time; all state is behind one condition.

    Parameters
    ----------
    start : Start
        What each process is told first. A lossless one is not started again: frames would be missing.
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
        """Return what was opened; pass on its progress, whose exception ends the waiting.

        Raises
        ------
        TactuneError
            The source cannot be opened; as the source itself has raised it.
        """
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

    def wait(self, timeout_s: float) -> bool:
        """Wait until `next_frame` does not block."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._waiting) or self._finished, timeout_s)

    def next_frame(self) -> SensorFrame | None:
        """Return the oldest frame that waits; block until there is one; None at the end."""
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
        """Report how the source is doing and what has happened to the process."""
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
            As the source raised it, or the process does not answer.
        """
        number = next(self._numbers)
        with self._changed:
            process = self._serving
            self._replies[number] = None
        try:
            if process is None:
                raise SourceError(f"{self._name}: the capture process is not running at present; try again")
            with suppress(OSError):  # it has just gone, and so does not answer
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
        """Number of the present process, None while there is none."""
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
        except Exception as error:  # whoever waits for a frame must learn of it
            self._fail(SourceError(f"{self._name}: capturing failed ({type(error).__name__}: {error})"))
        finally:
            with self._changed:
                if self._stop.is_set():
                    self._waiting.clear()
                    self._error = SourceError(f"{self._name}: the source is closed; open it again")
                self._changed.notify_all()

    def _fail(self, error: TactuneError) -> None:
        with self._changed:
            self._error = error.with_traceback(None)  # which would keep the shared memory
            self._changed.notify_all()

    def _keep_capturing(self) -> None:
        """Run one process after the other until the source ends, is closed or cannot go on."""
        pauses = Pauses()
        while not self._stop.is_set():
            self._numbering.restart()
            began_s = time.monotonic()
            problem = self._run_process()
            if self._stop.is_set() or self._ended:
                return
            self._take_down(problem)
            self._stop.wait(pauses.next_s(time.monotonic() - began_s))

    def _take_down(self, problem: Failure | str) -> None:
        """Say what happened, or give up: before the first frame, and where none may be missing."""
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
        """Run one process to its end and say in words how that came about."""
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
        """Take messages until there are no more; return why the process hangs, or its last words."""
        patience = Patience()
        ring: Ring | None = None
        while not self._stop.is_set():
            began_s = time.monotonic()
            try:
                message = process.receive(POLL_S)
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
        """Go on with a process that has opened the source; check that it is the same one."""
        with self._changed:
            before, options = self._opened, dict(self._options)
        if before is not None:
            check_same_rig(before.name, before.rig, opened.rig)
            for (camera, name), value in options.items():
                with suppress(OSError):  # it has gone again, which `_serve` notices
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
        """Have a frame wait to be fetched; where too many wait, the oldest goes."""
        oldest = None
        with self._changed:
            self._record.heard(ready)
            self._waiting.append((process, ring, self._numbering.apply(ready)))
            if not self._start.lossless and len(self._waiting) > _MOST_WAITING:
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
            elif message.failure is not None:  # an option that the restarted source does not take any more
                self._notice = f"{self._notice} {message.failure.sentence}"
            self._changed.notify_all()

    def _give_back(self, process: CaptureProcess, slot: int) -> None:
        with suppress(OSError):  # the process has gone, and its slots with it
            process.send(GiveBack(slot))
