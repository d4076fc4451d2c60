"""The capture process: opens the source, and sends its frames and its health to the parent."""

from __future__ import annotations

import os
import pickle
import signal
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any, Final

from ...errors import TactuneError
from ..base import FrameSource, Health
from .protocol import SLOTS, Call, Ended, Opened, Opening, Reply, as_tactune_error, create_memory, write_frame

#: Longest wait for a frame between two rounds of answering calls and telling the health, seconds.
_ROUND_S: Final = 0.2
#: Time to close the source after the parent has gone; then the process ends anyway, seconds.
_GRACE_S: Final = 2.0


class _StoppedError(TactuneError):
    """Raised to cancel the opening of a source that is no longer needed."""


def main(connection: Connection, opener: bytes) -> None:
    """Run the capture process; ``opener`` is a pickled `protocol.Opener`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # only the parent handles Ctrl+C; it then closes its source
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a driver prints must not mix with a command's output
    _Capture(connection).run(opener)
    os._exit(0)  # the source is closed; taking down its libraries takes seconds


class _Capture:
    """The main thread uses the source and sends; a second thread listens to the parent."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._stop = Event()
        self._calls: SimpleQueue[Call] = SimpleQueue()
        self._free: SimpleQueue[int] = SimpleQueue()
        self._dropped = 0
        for slot in range(SLOTS):
            self._free.put(slot)

    def run(self, order: bytes) -> None:
        """Open the source and capture until the parent ends or the source does."""
        Thread(target=self._listen, daemon=True).start()
        what = "the source cannot be imported in the capture process; define it in a module"
        try:
            opener = pickle.loads(order)  # noqa: S301  # our own parent wrote it
            what = "the capture failed unexpectedly"
            with opener(self._progress) as source:
                self._capture(source)
        except _StoppedError:
            return
        except Exception as error:  # a driver, a source or an import may raise anything
            self._send(Ended(as_tactune_error(error, what)))

    def _progress(self, fraction: float, text: str) -> None:
        if self._stop.is_set():
            raise _StoppedError("the capture process is no longer needed")
        self._send(Opening(fraction, text))

    def _capture(self, source: FrameSource) -> None:
        memory = create_memory(source.rig)
        self._send(Opened(source.name, source.rig, source.frame_rate_hz, source.health(), memory.name))
        told_s = time.monotonic()
        while not self._stop.is_set():
            self._answer(source)
            if time.monotonic() - told_s > _ROUND_S:
                told_s = time.monotonic()
                self._send(self._health_of(source))
            if not source.wait(_ROUND_S):
                continue
            frame = source.next_frame()
            if frame is None:
                self._send(self._health_of(source))  # with the last counts
                self._send(Ended())
                return
            frame.check_against(source.rig)
            try:
                self._send(write_frame(memory, self._free.get_nowait(), frame))
            except Empty:
                self._dropped += 1

    def _answer(self, source: FrameSource) -> None:
        """Execute the calls that have arrived; only this thread uses the source."""
        while not self._calls.empty():
            call = self._calls.get()
            try:
                reply = Reply(call.number, getattr(source, call.method)(*call.arguments))
            except Exception as error:
                reply = Reply(call.number, error=as_tactune_error(error, f"{source.name}: {call.method} failed"))
            self._send(reply)

    def _health_of(self, source: FrameSource) -> Health:
        health = source.health()
        return replace(health, dropped=health.dropped + self._dropped)

    def _send(self, message: Any) -> None:
        """Send a message; a parent that has gone is noticed by the other thread."""
        with suppress(BrokenPipeError, ConnectionResetError):
            self._connection.send(message)

    def _listen(self) -> None:
        """Receive calls and free slots until the parent has gone; then end the process."""
        with suppress(EOFError, OSError):
            while True:
                message = self._connection.recv()
                if isinstance(message, int):
                    self._free.put(message)
                else:
                    self._calls.put(message)
        self._stop.set()
        time.sleep(_GRACE_S)
        os._exit(0)
