"""The protocol of the two processes: pickled messages over a pipe, images in shared memory.

The memory is cut into slots; each slot holds the images of one frame. Messages pass the ownership of a slot: the
capture process announces it after writing, and the parent sends its number after copying. No slot is therefore read
while it is being written. A `Health` is a message, too, and the sign of life.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.shared_memory import SharedMemory
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
