"""The capture process: opens the source, and sends its frames and its health to the parent.

Messages are pickled and pass a pipe, images pass shared memory, which is cut into slots for one frame each. Messages
pass the ownership of a slot: the capture process announces it after writing, and the parent sends its number after
copying. No slot is therefore read while it is being written. A `Health` is a message, too, and the sign of life.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any, Final

from ...errors import FrameError, SourceError, TactuneError
from ...model.frames import Rig, SensorFrame
from ..base import FrameSource, Health, Progress

#: Opens a source in the capture process; a function of a module, or `functools.partial` of one.
Opener = Callable[[Progress], FrameSource]

#: Number of slots: the queued frames, one that is being written and one that is being copied.
SLOTS: Final = 8
_ALIGNMENT: Final = 64
#: Slots are whole pages: an attached memory is rounded up to pages on some systems, which must not move the slots.
_PAGE: Final = 4096


@dataclass(frozen=True)
class Call:
    """To the capture process: call this method of the source and reply."""

    number: int
    method: str
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Opening:
    """From the capture process: progress of opening, 0 to 1."""

    fraction: float
    text: str


@dataclass(frozen=True)
class Opened:
    """From the capture process: the source is open, and the shared memory has this name."""

    name: str
    rig: Rig
    frame_rate_hz: float
    health: Health
    memory: str


@dataclass(frozen=True)
class FrameReady:
    """From the capture process: a slot holds the arrays, of these sizes in bytes, of a pickled frame."""

    slot: int
    frame: bytes
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Reply:
    """From the capture process: what a call returned, or the error that it raised."""

    number: int
    value: Any = None
    error: TactuneError | None = None


@dataclass(frozen=True)
class Ended:
    """From the capture process, last: the source has no more frames, or it failed."""

    error: TactuneError | None = None


def as_tactune_error(error: Exception, what: str) -> TactuneError:
    """Return an error that can be sent; ``what`` introduces one that is no `TactuneError`."""
    if isinstance(error, TactuneError):  # classes of other modules may not survive the pipe
        return error if type(error).__module__ == TactuneError.__module__ else SourceError(str(error))
    return SourceError(f"{what} ({type(error).__name__}: {error})")


def create_memory(rig: Rig) -> SharedMemory:
    """Allocate the slots for the frames of a rig: for every array of a frame, its truth included."""
    proximity, tactile = math.prod(rig.proximity.intrinsics.shape), math.prod(rig.tactile.intrinsics.shape)
    color = math.prod(rig.proximity_color_shape)
    sizes = 2 * proximity, 2 * tactile, 3 * color, 3 * tactile, proximity, 4 * proximity, 4 * proximity
    return SharedMemory(create=True, size=SLOTS * (-(-sum(map(_aligned, sizes)) // _PAGE) * _PAGE))


def write_frame(memory: SharedMemory, slot: int, frame: SensorFrame) -> FrameReady:
    """Copy a frame's arrays into a slot."""
    buffers: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(frame, protocol=5, buffer_callback=buffers.append)
    arrays = [buffer.raw() for buffer in buffers]
    offset = slot * (memory.size // SLOTS)
    if sum(_aligned(array.nbytes) for array in arrays) > memory.size // SLOTS:
        raise FrameError(f"frame {frame.sequence} has arrays that are too large for its rig; leave them out")
    assert memory.buf is not None
    for array in arrays:
        memory.buf[offset : offset + array.nbytes] = array
        offset += _aligned(array.nbytes)
    return FrameReady(slot, pickled, tuple(array.nbytes for array in arrays))


def read_frame(memory: SharedMemory, ready: FrameReady) -> SensorFrame:
    """Copy a frame out of its slot; its arrays cannot be written to."""
    assert memory.buf is not None
    start = ready.slot * (memory.size // SLOTS)
    copied = memoryview(bytes(memory.buf[start : start + sum(map(_aligned, ready.sizes))]))
    arrays, offset = [], 0
    for size in ready.sizes:
        arrays.append(copied[offset : offset + size])
        offset += _aligned(size)
    frame: SensorFrame = pickle.loads(ready.frame, buffers=arrays)  # noqa: S301  # our own process wrote it
    return frame


def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT


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
        self._send(Opening(0.0, ""))  # alive, before imports that take long on a busy computer
        what = "the source cannot be imported in the capture process; define it in a module"
        try:
            opener = pickle.loads(order)  # noqa: S301  # our own parent wrote it
            what = "the capture failed unexpectedly"
            self._send(Opening(0.0, ""))
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
