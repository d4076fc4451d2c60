"""The capture process: opens the source, sends its frames and heartbeats to the parent."""

from __future__ import annotations

import os
import pickle
import signal
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from queue import Empty, SimpleQueue
from threading import Condition, Event, Lock, Thread
from typing import Any, Final

from ...errors import FrameError, TactuneError
from ..base import FrameSource, Health
from .protocol import (
    HEARTBEAT_S,
    SLOTS,
    Call,
    Ended,
    GiveBack,
    Heartbeat,
    Opened,
    Opening,
    Reply,
    Start,
    as_tactune_error,
    create_memory,
    write_frame,
)

#: Longest wait for a frame between two rounds of answering calls, seconds.
_ROUND_S: Final = 0.2
#: Time to close the source after the parent has gone; then the process ends anyway, seconds.
_GRACE_S: Final = 2.0
#: Unfit frames in a row after which the source is opened again.
_MAX_UNFIT: Final = 30
#: Time that a skipped frame stays in the health message, seconds.
_TOLD_S: Final = 5.0


class _StoppedError(TactuneError):
    """Raised to cancel the opening of a source that is no longer needed."""


def main(connection: Connection, order: bytes, folder: str) -> None:
    """Run the capture process in the parent's working folder; ``order`` is a pickled `Start`."""
    os.chdir(folder)  # multiprocessing goes to the one in which the parent began
    for name in ("SIGINT", "SIGHUP"):  # only the parent handles Ctrl+C; it then closes its source
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a driver prints must not mix with a command's output
    _Capture(connection).run(order)
    os._exit(0)  # the source is closed; taking down its libraries takes seconds


class _Capture:
    """The main thread uses the source; a second thread talks to the parent."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._sending = Lock()
        self._stop = Event()
        self._calls: SimpleQueue[Call] = SimpleQueue()
        self._slots = Condition()
        self._free = deque(range(SLOTS))
        self._health = Health()
        self._round_s = time.monotonic()
        self._dropped = 0
        self._unfit_in_a_row = 0
        self._unfit_message = ""
        self._unfit_told_until_s = 0.0

    def run(self, order: bytes) -> None:
        """Open the source and capture until the parent ends or the source does."""
        signal.signal(signal.SIGTERM, lambda *_: self._stop.set())
        Thread(target=self._converse, daemon=True).start()
        try:
            start: Start = pickle.loads(order)  # noqa: S301  # our own parent wrote it
        except Exception as error:  # an import may raise anything
            what = "the source cannot be imported in the capture process; define it in a module"
            self._send(Ended(as_tactune_error(error, what)))
            return
        try:
            with start.opener(self._progress) as source:
                self._serve(source, start.lossless)
        except _StoppedError:
            return
        except Exception as error:  # a driver or a source may raise anything
            self._send(Ended(as_tactune_error(error, "the capture failed unexpectedly")))

    # The main thread

    def _progress(self, fraction: float, text: str) -> None:
        if self._stop.is_set():
            raise _StoppedError("the capture process is no longer needed")
        self._send(Opening(fraction, text))

    def _serve(self, source: FrameSource, lossless: bool) -> None:
        self._health = source.health()
        memory = create_memory(source.rig)
        try:
            self._capture(source, memory, lossless)
        finally:
            if self._stop.is_set():
                with suppress(FileNotFoundError):  # usually the parent has done so
                    memory.unlink()

    def _capture(self, source: FrameSource, memory: SharedMemory, lossless: bool) -> None:
        self._send(Opened(source.name, source.rig, source.frame_rate_hz, self._health, memory.name))
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
                self._send(Heartbeat(self._health_of(source), 0.0))  # with the last counts
                self._send(Ended())
                return
            with self._slots:
                slot = self._free.popleft() if self._free else None
            try:
                frame.check_against(source.rig)
                if slot is None:
                    self._dropped += 1
                else:
                    self._send(write_frame(memory, slot, frame))
                self._unfit_in_a_row = 0
            except FrameError as error:
                if slot is not None:
                    self._give_back(slot)
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
                reply = Reply(call.number, error=as_tactune_error(error, f"{source.name}: {call.method} failed"))
            self._send(reply)

    def _health_of(self, source: FrameSource) -> Health:
        health = source.health()
        return replace(
            health,
            ok=health.ok and not self._unfit_in_a_row,
            message=health.message or (self._unfit_message if self._round_s < self._unfit_told_until_s else ""),
            dropped=health.dropped + self._dropped,
            stale=health.stale or self._unfit_in_a_row > 0,
        )

    def _leave_out(self, error: FrameError, lossless: bool) -> None:
        """Skip a frame that does not fit the rig and report it; raise after too many of them in a row."""
        self._dropped += 1
        self._unfit_in_a_row += 1
        self._unfit_message = f"A frame was ignored: {error}."
        self._unfit_told_until_s = self._round_s + _TOLD_S
        if lossless or self._unfit_in_a_row >= _MAX_UNFIT:
            raise error

    def _slot_comes_free(self) -> bool:
        with self._slots:
            return self._slots.wait_for(lambda: bool(self._free), _ROUND_S)

    def _send(self, message: Any) -> None:
        """Send a message; a parent that has gone is noticed by the other thread."""
        with self._sending, suppress(BrokenPipeError, ConnectionResetError):
            self._connection.send(message)
            self._round_s = time.monotonic()  # a parent that is stopped itself does not read

    # The other thread

    def _converse(self) -> None:
        """Receive messages and send heartbeats until the parent has gone; then end the process."""
        parent = os.getppid()
        with suppress(EOFError, OSError):
            due_s = time.monotonic()
            while os.getppid() == parent:  # a fork of the parent keeps the pipe open
                if self._connection.poll(max(0.0, due_s - time.monotonic())):
                    message = self._connection.recv()
                    if isinstance(message, GiveBack):
                        self._give_back(message.slot)
                    else:
                        self._calls.put(message)
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
        """Send a heartbeat, unless something else is being sent."""
        if self._sending.acquire(blocking=False):
            try:
                self._connection.send(Heartbeat(self._health, time.monotonic() - self._round_s))
            finally:
                self._sending.release()

    def _give_back(self, slot: int) -> None:
        with self._slots:
            self._free.append(slot)
            self._slots.notify()
