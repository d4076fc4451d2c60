"""The capture process: opens the source, sends its frames and heartbeats to the parent."""

from __future__ import annotations

import os
import select
import signal
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Condition, Event, Lock, Thread
from typing import Any, Final

from ...errors import FrameError, TactuneError
from ...model.frames import SensorFrame
from ..base import FrameSource, Health
from .protocol import (
    HEARTBEAT_S,
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
    arrays_of,
    reserve_memory,
    slot_bytes,
)

#: Longest wait for a frame between two rounds of answering calls, seconds.
_ROUND_S: Final = 0.2
#: Time to close the source after the parent has gone; then the process ends anyway, seconds.
_GRACE_S: Final = 2.0
#: The kernel ends an orphaned process whose interpreter is blocked after this time, seconds.
_ALARM_S: Final = 60
#: Unfit frames in a row after which the source is opened again.
_MAX_UNFIT: Final = 30
#: Time that a skipped frame stays in the health message, seconds.
_TOLD_S: Final = 5.0


class _StoppedError(TactuneError):
    """Raised to cancel the opening of a source that is no longer needed."""


def main(control: int, memory: int) -> None:
    """Run the capture process on two inherited descriptors: the socket and the shared memory."""
    _Capture(Connection(control), memory).run()


class _Capture:
    """The main thread uses the source; a second thread talks to the parent and never waits for it."""

    def __init__(self, connection: Connection, memory: int) -> None:
        self._connection = connection
        self._memory = memory
        self._parent = os.getppid()
        self._sending = Lock()
        self._writable = select.poll()
        self._writable.register(connection.fileno(), select.POLLOUT)
        self._stop = Event()
        self._calls: SimpleQueue[Call] = SimpleQueue()
        self._slots = Condition()
        self._free = deque(range(SLOTS))
        self._health = Health()
        self._round_s = time.monotonic()
        self._dropped = 0
        self._unfit = 0
        self._unfit_in_a_row = 0
        self._unfit_message = ""
        self._unfit_told_until_s = 0.0

    def run(self) -> None:
        """Open the source and capture until the parent ends or the source does."""
        try:
            start: Start = self._connection.recv()
        except (EOFError, OSError):
            return
        except Exception as error:  # an import may raise anything
            self._send(Failure.of(error, "the source cannot be imported in the capture process; define it in a module"))
            return
        Thread(target=self._converse, daemon=True).start()
        try:
            with start.opener(self._progress) as source:
                self._serve(source, start.lossless)
        except _StoppedError:
            return
        except Exception as error:  # a driver or a source may raise anything
            self._send(Failure.of(error, "the capture failed unexpectedly"))

    # The main thread

    def _progress(self, fraction: float, text: str) -> None:
        if self._stop.is_set():
            raise _StoppedError("the capture process is no longer needed")
        self._round_s = time.monotonic()
        self._send(Opening(fraction, text))

    def _serve(self, source: FrameSource, lossless: bool) -> None:
        rig = source.rig
        size = slot_bytes(rig)
        reserve_memory(self._memory, SLOTS * size)
        ring = Ring(self._memory, SLOTS, size)
        self._health = source.health()
        self._round_s = time.monotonic()  # a long opening is over
        self._send(Opened(source.name, rig, source.frame_rate_hz, self._health, size))
        while not self._stop.is_set():
            self._round_s = time.monotonic()
            self._answer(source)
            self._health = self._health_of(source)
            if lossless and not self._slot_comes_free():
                continue
            if not source.wait(_ROUND_S):
                continue
            frame = source.next_frame()
            self._round_s = time.monotonic()  # the steps below do not wait for the source
            if frame is None:
                self._send(Ended())
                return
            try:
                frame.check_against(rig)
                self._hand_over(ring, frame)
                self._unfit_in_a_row = 0
            except FrameError as error:
                self._leave_out(error, lossless)

    def _answer(self, source: FrameSource) -> None:
        """Execute the calls that have arrived; only this thread uses the source."""
        while True:
            try:
                call = self._calls.get_nowait()
            except Empty:
                return
            try:
                reply = Reply(call.number, getattr(source, call.method)(*call.arguments))
            except Exception as error:
                reply = Reply(call.number, failure=Failure.of(error, f"{source.name}: {call.method} failed"))
            self._send(reply)

    def _health_of(self, source: FrameSource) -> Health:
        health = source.health()
        return replace(
            health,
            ok=health.ok and not self._unfit_in_a_row,
            message=health.message or (self._unfit_message if self._round_s < self._unfit_told_until_s else ""),
            dropped=health.dropped + self._unfit,
            stale=health.stale or self._unfit_in_a_row > 0,
        )

    def _hand_over(self, ring: Ring, frame: SensorFrame) -> None:
        with self._slots:
            slot = self._free.popleft() if self._free else None
        if slot is None:
            self._dropped += 1
            return
        try:
            places = ring.write(slot, arrays_of(frame))
        except FrameError:
            self._give_back(slot)
            raise
        stamps = float(frame.proximity_time_s), float(frame.tactile_time_s)
        self._send(FrameReady(slot, places, int(frame.sequence), *stamps, self._dropped))

    def _leave_out(self, error: FrameError, lossless: bool) -> None:
        """Skip a frame that does not fit the rig and report it; raise after too many of them in a row."""
        self._unfit += 1
        self._unfit_in_a_row += 1
        self._unfit_message = f"A frame was ignored: {error}."
        self._unfit_told_until_s = self._round_s + _TOLD_S
        if lossless or self._unfit_in_a_row >= _MAX_UNFIT:
            raise error

    def _slot_comes_free(self) -> bool:
        with self._slots:
            return self._slots.wait_for(lambda: bool(self._free), _ROUND_S)

    # The other thread

    def _converse(self) -> None:
        """Receive messages and send heartbeats until the parent has gone; then end the process."""
        with suppress(EOFError, OSError):
            due_s = time.monotonic()
            while os.getppid() == self._parent:
                # Restarted in every round: the alarm fires only if this thread cannot run any more.
                signal.alarm(_ALARM_S)
                if self._connection.poll(max(0.0, due_s - time.monotonic())):
                    self._obey(self._connection.recv())
                late_s = time.monotonic() - due_s
                if late_s >= 0:
                    if late_s > HEARTBEAT_S:  # the machine was busy, so this time is not counted for the source
                        self._round_s += late_s
                    due_s = time.monotonic() + HEARTBEAT_S
                    self._beat()
        self._stop.set()
        time.sleep(_GRACE_S)
        os._exit(0)

    def _beat(self) -> None:
        """Send a heartbeat, unless something else is being sent or the parent does not read."""
        if not self._sending.acquire(blocking=False):
            return
        try:
            if self._writable.poll(0):
                self._connection.send(Heartbeat(self._health, time.monotonic() - self._round_s))
        finally:
            self._sending.release()

    def _obey(self, message: GiveBack | Call) -> None:
        if isinstance(message, GiveBack):
            self._give_back(message.slot)
        else:
            self._calls.put(message)

    def _give_back(self, slot: int) -> None:
        with self._slots:
            self._free.append(slot)
            self._slots.notify()

    def _send(self, message: Any) -> None:
        """Send a message; a parent that has gone is noticed by the other thread."""
        with self._sending, suppress(BrokenPipeError, ConnectionResetError):
            self._connection.send(message)
